"""Contact: colliders, and the exact complementarity of gaps and forces between them and a shell."""

from modalshell.contact.base import COLLIDERS, Collider
from modalshell.contact.box import Box
from modalshell.contact.capsule import Capsule
from modalshell.contact.contact import Contact
from modalshell.contact.cylinder import Cylinder
from modalshell.contact.height_field import HeightField
from modalshell.contact.mesh_collider import MeshCollider
from modalshell.contact.plane import Plane
from modalshell.contact.self_contact import SelfContact
from modalshell.contact.sphere import Sphere

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
