"""Contacts on one shell: which vertices may touch which collider, their gaps, and the unknowns that move them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.gap_kernels import Packed, forms_of, packed
from modalshell.contact.self_contact import SelfContact
from modalshell.core.checks import checked_kind, shown
from modalshell.core.errors import OptionError
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array, Index, Mask
from modalshell.shell import Shell
from modalshell.supports import SupportPath, VertexUnknowns

INSIDE = 1e-6
"""Depth, as a share of the shell's size, up to which a start counts as touching."""
EXACT_GAP = 1e-10
"""Depth, as a share of the shell's size, that is none."""
_FREE = 1e-6
"""Square of the part of a unit normal in a vertex's free unknowns below which supports alone decide its gap."""
_PASSABLE = 0.5
"""Way into a collider, in its smallest radius, that an iteration may take a vertex."""
_PASSED = 0.1
"""Depth, in a collider's smallest radius, at which a straight way leads through it: vertices slide along curves."""
_LOOKS = 256
"""Places at most at which a straight way is looked at: far from a collider few serve."""
_ALIGNED = 0.9
"""Cosine between normals of one vertex above which its deeper row alone is taken in."""
_SWEEPS = 20
"""Moves onto curved or several surfaces at most."""
_ON = 1e-14
"""Gap, as a share of the shell's size, at which a vertex is on its surface."""


def listed_contacts(contacts: Sequence[Contact | SelfContact]) -> tuple[Contact | SelfContact, ...]:
    """The contacts as a tuple; OptionError for what is no list of contacts."""
    if isinstance(contacts, Contact | SelfContact):
        kind = type(contacts).__name__
        raise OptionError(f"contacts must be a list of contacts (got one {kind}: write contacts=[contact])")
    try:
        given = tuple(contacts)
    except TypeError as error:
        raise OptionError(f"contacts must be a list of contacts (got {shown(contacts)})") from error
    for contact in given:
        if not isinstance(contact, SelfContact):
            checked_kind("each of contacts", contact, Contact)
    return given


def checked_contacts(contacts: Sequence[Contact] | None, frame: SupportPath | None = None) -> tuple[Contact, ...]:
    """The contacts as a tuple, as they are seen from a ``frame`` that moves; OptionError for self-contact."""
    seen = []
    for contact in () if contacts is None else listed_contacts(contacts):
        if isinstance(contact, SelfContact):
            raise OptionError(
                "self-contact is for DS with implicit steps alone (got SelfContact): take DS, or leave it out"
            )
        seen.append(contact.seen_from(frame))
    return tuple(seen)


def refuse_friction(contacts: Sequence[Contact], name: str) -> None:
    """OptionError for a contact with friction, which ``name`` does not take."""
    for index, contact in enumerate(contacts):
        if contact.friction:
            raise OptionError(
                f"{name} take contacts without friction (contact {index} has {contact.friction:g}): set it to 0, "
                "or take DS"
            )


@final
class Touching:
    """Contacts on a shell, as rows: one for each pair of a contact and a vertex that may touch its collider.

    The shell is about ``origin`` (3,) [m] in the world.

    Attributes
    ----------
    time : float
        Time at which the colliders stand [s].
    vertices, contact_of : ndarray, shape (r,)
        Vertex and contact of each row.
    friction, restitution : ndarray, shape (r,)
        Coefficients of each row.
    size : float
        The shell's size [m], the same for one that is turned.
    bounds : ndarray or None, shape (r,)
        Gaps [m], at most 0, that count as none: of vertices that are being pushed out.
    """

    def __init__(self, contacts: Sequence[Contact], shell: Shell, origin: Array | None = None) -> None:
        self.contacts, self.shell, self.time = tuple(contacts), shell, 0.0
        self._origin = origin if origin is not None and origin.any() else None
        self.size = shell.mesh.moment_length  # not of the box: thresholds would hang on axes that are turned
        self.bounds: Array | None = None
        self._forms = forms_of(self.contacts)
        self._first, self._count, self._basis = _unknowns_of(shell)
        chosen = [np.flatnonzero(contact.vertices(shell.mesh) & (self._count > 0)) for contact in self.contacts]
        self.vertices: Index = np.concatenate([np.empty(0, np.int64), *chosen]).astype(np.int64)
        self._ends = np.cumsum([0, *(part.size for part in chosen)])
        self.contact_of: Index = np.repeat(np.arange(len(chosen)), np.diff(self._ends))
        self.friction = np.array([contact.friction for contact in self.contacts])[self.contact_of]
        self.restitution = np.array([contact.restitution for contact in self.contacts])[self.contact_of]
        tied = np.flatnonzero(self._count[self.vertices] < 0)
        if tied.size:
            raise OptionError(
                f"contacts do not act on vertices that are tied to others (got vertex {self.vertices[tied[0]]}): leave "
                "them out of sel"
            )

    def at(self, time: float, shell: Shell | None = None) -> Touching:
        """The same contacts at another time, on the shell as its supports then are."""
        other = object.__new__(Touching)
        other.__dict__.update(self.__dict__)
        other.time = time
        if shell is not None:
            other.shell = shell
        return other

    def behind(self, ahead: Array) -> Touching:
        """The same contacts, of a shell that is at positions less what those are ``ahead`` by (n, 3) [m]."""
        other = self.at(self.time)
        other._origin = (0.0 if self._origin is None else self._origin) - ahead
        return other

    def with_bounds(self, bounds: Array | None) -> Touching:
        """The same contacts, with other gaps that count as none."""
        other = self.at(self.time)
        other.bounds = bounds
        return other

    def gaps(self, x: Array, rows: Index | None = None) -> tuple[Array, Array, Array]:
        """Gaps (r,) [m], normals (r, 3) and curvatures (r, 3, 3) of rows, all by default, at positions x (n, 3)."""
        chosen = np.arange(self.vertices.size) if rows is None else rows
        gap, normal = np.empty(chosen.size), np.empty((chosen.size, 3))
        curvature = np.empty((chosen.size, 3, 3))
        for contact, here in self._parts(chosen):
            points = self._in_world(x, self.vertices[chosen[here]])
            gap[here], normal[here], curvature[here] = contact.gap(points, self.time)
        if self.bounds is not None:
            gap -= self.bounds[chosen]
        return gap, normal, curvature

    def normals(self, x: Array, rows: Index) -> Array:
        """Normals (k, 3) of the colliders at the rows' vertices."""
        normal = np.empty((rows.size, 3))
        for contact, here in self._parts(rows):
            normal[here] = contact.normal(self._in_world(x, self.vertices[rows[here]]), self.time)
        return normal

    def velocities(self, x: Array, rows: Index) -> Array:
        """Velocities (k, 3) [m/s] of the colliders at the rows' vertices."""
        velocity = np.empty((rows.size, 3))
        for contact, here in self._parts(rows):
            velocity[here] = contact.velocity(self._in_world(x, self.vertices[rows[here]]), self.time)
        return velocity

    def ways(self, x: Array, rows: Index, dt: float) -> Array:
        """Ways (k, 3) [m] of the colliders' material at the rows' vertices in the next ``dt`` [s]."""
        way = np.empty((rows.size, 3))
        for contact, here in self._parts(rows):
            way[here] = contact.way(self._in_world(x, self.vertices[rows[here]]), self.time, dt)
        return way

    def distances(self, x: Array) -> Array:
        """Gaps (r,) [m] of all rows alone."""
        gap = np.empty(self.vertices.size)
        for contact, begin, end in zip(self.contacts, self._ends[:-1], self._ends[1:], strict=True):
            gap[begin:end] = contact.distance(self._in_world(x, self.vertices[begin:end]), self.time)
        return gap if self.bounds is None else gap - self.bounds

    def packed(self) -> Packed | None:
        """The colliders as they are now, for compiled gaps; None where one, or what is ahead, has no compiled form."""
        shifted = self._origin is not None and self._origin.ndim > 1
        return None if shifted else packed(self.contacts, self._forms, self.time, self._origin)

    def deepest_by_contact(self, x: Array) -> Array:
        """For each row the gap (r,) [m] of its contact's deepest vertex, at most 0."""
        gap, deepest = self.distances(x), np.zeros(self.vertices.size)
        for index in range(len(self.contacts)):
            own = self.of_contact(index)
            deepest[own] = min(0.0, float(gap[own].min(initial=0.0)))
        return deepest

    def of_contact(self, index: int) -> slice:
        """Rows of one contact."""
        return slice(int(self._ends[index]), int(self._ends[index + 1]))

    def _in_world(self, x: Array, vertices: Index) -> Array:
        """Some vertices (k,) at positions x (n, 3) [m] as the colliders know them."""
        points, origin = x[vertices], self._origin
        return points if origin is None else points + (origin if origin.ndim == 1 else origin[vertices])

    def _parts(self, rows: Index) -> list[tuple[Contact, Any]]:
        ends = zip(self.contacts, self._ends[:-1], self._ends[1:], strict=True)
        parts = [(contact, np.flatnonzero((rows >= begin) & (rows < end))) for contact, begin, end in ends]
        return [(contact, here) for contact, here in parts if here.size]

    def starts(self, rows: Index) -> tuple[Index, Index]:
        """First unknown of each row's vertex, and how many it has."""
        vertices = self.vertices[rows]
        return self._first[vertices], self._count[vertices]

    def along(self, rows: Index, normals: Array) -> Array:
        """Normals (k, 3) by the free unknowns of the rows' vertices, zero where a vertex has fewer than three."""
        return np.einsum("kij,ki->kj", self._basis[self.vertices[rows]], normals)

    def across(self, rows: Index, curvatures: Array) -> Array:
        """Curvatures (k, 3, 3) by the free unknowns of the rows' vertices."""
        basis = self._basis[self.vertices[rows]]
        return np.einsum("kia,kij,kjb->kab", basis, curvatures, basis)

    def safe_part(self, x: Array, moved: Array) -> float:
        """Part of a move from x (n, 3) on which no vertex can pass through a collider to its other side."""
        part = 1.0
        for index, contact in enumerate(self.contacts):
            own = self.of_contact(index)
            radius = contact.collider.smallest_radius
            vertices = self.vertices[own]
            if np.isfinite(radius) and vertices.size:
                way = np.linalg.norm(moved[vertices] - x[vertices], axis=1)
                if way.max() > _PASSABLE * radius:
                    points = self._in_world(x, vertices)
                    allowed = np.maximum(contact.distance(points, self.time), 0.0) + _PASSABLE * radius
                    part = min(part, float((allowed / np.maximum(way, 1e-300)).min()))
        return part

    def crossed(self, x: Array, moved: Array) -> bool:
        """Whether the straight way from x to ``moved``, both (n, 3), leads a vertex through a collider.

        Each vertex is looked at again after a way as long as its distance from the collider, and of at least half the
        collider's smallest radius.
        """
        most = np.sqrt(3.0) * float(np.abs(moved - x).max(initial=0.0))  # no way is longer
        for index, contact in enumerate(self.contacts):
            radius = contact.collider.smallest_radius
            if not _PASSABLE * radius < most < np.inf:
                continue
            vertices = self.vertices[self.of_contact(index)]
            begin, way = self._in_world(x, vertices), moved[vertices] - x[vertices]
            length = np.linalg.norm(way, axis=1)
            gone = np.where(length > _PASSABLE * radius, 0.0, length)  # shorter ways lead through nothing
            for look in range(_LOOKS):
                left = np.flatnonzero(gone < length)
                if not left.size:
                    break
                points = begin[left] + (gone[left] / length[left])[:, None] * way[left]
                gap = contact.distance(points, self.time)
                if look and gap.min() < -_PASSED * radius:
                    return True
                gone[left] += np.maximum(gap, _PASSABLE * radius)
        return False

    def passed(self, x: Array, moved: Array) -> bool:
        """As :meth:`crossed`, of a step in time: vertices that colliders have come to, inside at x, do not count."""
        if not self.crossed(x, moved):  # most steps are too short for more than a look at their length
            return False
        come_to = self.vertices[self.distances(x) < -INSIDE * self.size]
        moved = moved.copy()
        moved[come_to] = x[come_to]
        return come_to.size == 0 or self.crossed(x, moved)

    def inside(self, x: Array, vertices: Index) -> list[int]:
        """Contacts in whose colliders some vertices (k,) lie at positions x (n, 3), whatever holds them."""
        points = self._in_world(x, vertices)
        chosen = (contact.vertices(self.shell.mesh)[vertices] for contact in self.contacts)
        gaps = [contact.distance(points[own], self.time) for contact, own in zip(self.contacts, chosen, strict=True)]
        return [index for index, gap in enumerate(gaps) if gap.min(initial=0.0) < -INSIDE * self.size]

    def movable(self, x: Array, rows: Index) -> Index:
        """Those of some rows (k,) whose vertices supports leave a motion along the normals at positions x (n, 3)."""
        return rows[np.sum(self.along(rows, self.normals(x, rows)) ** 2, axis=1) > _FREE]

    def put_on(self, x: Array, rows: Index, left: Array) -> None:
        """Move the vertices of rows along their normals, in place, until their gaps are what is ``left`` (k,) [m]."""
        for _ in range(_SWEEPS):
            gap, normal, _ = self.gaps(x, rows)
            off = gap - left
            if not (np.abs(off) > _ON * self.size).any():
                break
            free = np.maximum(np.sum(self.along(rows, normal) ** 2, axis=1), _FREE)
            self.slide(x, rows, -(off / free)[:, None] * normal)

    def slide(self, x: Array, rows: Index, ways: Array) -> None:
        """Move the vertex of each row (k,) by its way (k, 3) [m], in place, as far as its supports let it."""
        vertices = self.vertices[rows]
        np.add.at(x, vertices, np.einsum("kij,kj->ki", self._basis[vertices], self.along(rows, ways)))

    def binding(self, x: Array, rows: Index) -> Index:
        """Those of some rows (k,) inside at x (n, 3) that bind: of almost parallel surfaces of a vertex the deepest.

        A table's top low above a floor, or a ball that is tangent to it, need not be kept together with the floor.
        """
        order = np.argsort(self.vertices[rows], kind="stable")
        same = np.flatnonzero(np.diff(self.vertices[rows][order]) == 0)
        if not same.size:
            return rows
        gaps, normals, _ = self.gaps(x, rows)
        left = np.ones(rows.size, dtype=bool)
        for vertex in np.unique(self.vertices[rows][order[same]]):
            own = np.flatnonzero(self.vertices[rows] == vertex)
            for row in own[np.argsort(gaps[own], kind="stable")]:
                if left[row]:
                    left[own] &= (normals[own] @ normals[row] < _ALIGNED) | (own == row) | (gaps[own] < gaps[row])
        return rows[left]

    def forces(self, x: Array, pushes: Array) -> Array:
        """Forces (n, 3) [N] on the vertices, of ``pushes`` (r,) [N] along the normals."""
        rows = np.flatnonzero(pushes)
        forces = np.zeros_like(x)
        np.add.at(forces, self.vertices[rows], pushes[rows, None] * self.normals(x, rows))
        return forces

    def dip(self, x: Array, active: Mask) -> float:
        """Depth [m] to which edges between touching vertices dip into convex colliders, ``l^2 / (8 r)``."""
        rows = np.flatnonzero(active)
        if not rows.size:
            return 0.0
        ends, longest = self.shell.mesh.edges, np.zeros(len(x))
        length = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
        for side in range(2):
            np.maximum.at(longest, ends[:, side], length)
        curvature = np.linalg.eigvalsh(self.gaps(x, rows)[2])[:, -1]
        return float((curvature * longest[self.vertices[rows]] ** 2).max()) / 8.0

    def refuse_inside(self, x: Array) -> None:
        """Raise OptionError where a vertex of a contact that does not push out lies inside at positions x (n, 3)."""
        gap = self.with_bounds(None).distances(x)
        for index, contact in enumerate(self.contacts):
            rows = self.of_contact(index)
            own = gap[rows]
            if own.size and not own.min() >= -INSIDE * self.size and not contact.push_out:
                worst = int(np.argmin(own))
                kind = type(contact.collider).__name__
                raise OptionError(
                    f"vertex {self.vertices[rows][worst]} begins {-own[worst]:.3g} m inside contact {index} ({kind}): "
                    "move the shell or the collider, or let it be pushed out (its push_out, in m/s)"
                )


def put_out(touching: Touching, x: Array, chosen: Mask) -> Array:
    """Positions (n, 3) [m] with what may move and lies inside put onto the colliders of ``chosen`` contacts (c,)."""
    x = x.copy()
    rows = np.flatnonzero((touching.distances(x) < 0.0) & chosen[touching.contact_of])
    rows = touching.binding(x, touching.movable(x, rows))
    touching.put_on(x, rows, np.zeros(rows.size))
    return x


def parted(
    contacts: Sequence[Contact | SelfContact] | None, frame: SupportPath | None = None
) -> tuple[tuple[Contact, ...], SelfContact | None]:
    """The contacts with colliders, seen from a ``frame``, and the self-contact; OptionError for two of these."""
    given = () if contacts is None else listed_contacts(contacts)
    own = [contact for contact in given if isinstance(contact, SelfContact)]
    if len(own) > 1:
        raise OptionError(f"contacts must have one SelfContact at most (got {len(own)})")
    others = [contact for contact in given if not isinstance(contact, SelfContact)]
    return checked_contacts(others, frame), own[0] if own else None


def touched_frame(touching: Touching, x: Array, pushes: Array, given: Array | None = None) -> TouchedFrame:
    """What touches at positions x (n, 3), of forces (r,) [N] along the normals, or else ``given`` ones (n, 3) [N]."""
    bare = touching.with_bounds(None)
    forces = bare.forces(x, pushes) if given is None else given
    touches: Mask = np.asarray(forces.any(axis=1))
    touches[bare.vertices[pushes > 0.0]] = True
    return TouchedFrame(forces, touches, max(0.0, -float(bare.distances(x).min(initial=0.0))))


def _unknowns_of(shell: Shell) -> tuple[Index, Index, Array]:
    """First unknown (n,) of each vertex, their number (n,), -1 where others share them, and what they do (n, 3, 3)."""
    count = len(shell.rest_positions)
    first, number, basis = np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros((count, 3, 3))
    unknowns = shell.unknowns
    if isinstance(unknowns, VertexUnknowns):
        free = ~unknowns.held
        first[free], number[free], basis[free] = 3 * np.arange(int(free.sum())), 3, np.eye(3)
        return first, number, basis
    matrix = unknowns.matrix
    assert matrix is not None
    entries = matrix.tocoo()
    vertex, column = entries.coords[0] // 3, entries.coords[1].astype(np.int64)
    pairs = np.unique(np.stack([vertex, column]), axis=1)
    number = np.bincount(pairs[0], minlength=count).astype(np.int64)
    first[:] = matrix.shape[1]
    np.minimum.at(first, pairs[0], pairs[1])
    shared = np.bincount(pairs[1], minlength=matrix.shape[1]) > 1
    tied = np.unique(pairs[0][shared[pairs[1]]])
    own = ~np.isin(vertex, tied)
    basis[vertex[own], entries.coords[0][own] % 3, column[own] - first[vertex[own]]] = entries.data[own]
    number[tied] = -1
    return first, number, basis
