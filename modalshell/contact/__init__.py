"""Contact: colliders, and the exact complementarity of gaps and forces between them and a shell."""

from modalshell.contact.base import COLLIDERS, Collider
from modalshell.contact.bodies import Box, Capsule, Cylinder, Plane, Sphere
from modalshell.contact.contact import Contact
from modalshell.contact.height_field import HeightField
from modalshell.contact.mesh_collider import MeshCollider
from modalshell.contact.self_contact import SelfContact

__all__ = [
    "COLLIDERS",
    "Box",
    "Capsule",
    "Collider",
    "Contact",
    "Cylinder",
    "HeightField",
    "MeshCollider",
    "Plane",
    "SelfContact",
    "Sphere",
]
