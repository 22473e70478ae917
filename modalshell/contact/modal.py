"""Contact of modal models: a small complementarity problem in modal coordinates, with the residual compliance.

Of the vertices the nearest to the colliders are candidates in each frame. Modes alone leave the problem singular where
more vertices touch than there are modes: what the shell gives way beyond its modes, quasi-statically, under a force at
a vertex makes it regular. It is the residual compliance ``K^-1 - Phi Lambda^-1 Phi^T``, turned with the vertices
(theory 13, eq. 7 and 8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np

from modalshell.contact import modal_kernels as kernels
from modalshell.contact import warp_kernels
from modalshell.contact.contact import Contact
from modalshell.contact.friction import Friction
from modalshell.contact.gap_kernels import common_normal, frame_of, gaps_of
from modalshell.contact.local_shapes import LocalShapes
from modalshell.contact.modal_rows import FAR, SETTLED, SMALL, Near, RowFrames, Turning
from modalshell.contact.pressed import Pressed
from modalshell.contact.touching import EXACT_GAP, Touching, touched_frame
from modalshell.core.cost import count_read
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array, Index
from modalshell.kernels.rotations import rotate
from modalshell.modes import Basis
from modalshell.modes.modal_rotation import largest_at_vertices

CANDIDATES = 50
"""Vertices of a frame, the nearest, that may touch it; all that are inside may, as far as their shapes are kept."""
_NEAR = 0.02
"""Gap, as a share of the shell's size, up to which a vertex is a candidate at most."""
_RENEWED = 12
"""Times that vertices are taken in which a frame's end would leave inside."""

Rows = Callable[[Array, Index], Array]
"""Derivatives (k, 3, m) of some vertices' positions by the coordinates (m,)."""
Shape = tuple[Array, Array, Array]
"""Positions at rest (n, 3), modes and modal rotations (3n, m), none where these do not turn the modes."""


@final
class ModalContacts:
    """Contacts of a modal model.

    Parameters
    ----------
    contacts : sequence of Contact
        Those of the model, whose modes are the ``basis``.
    positions, rows : callable
        Positions (n, 3) [m] at coordinates (m,), and their derivatives at some vertices.
    near : callable, optional
        Both at some vertices; by default made of those two.
    turns : bool or callable
        Whether vertices turn with the modal rotations, or their rotation vectors (n, 3) [rad] at coordinates (m,).
    shape, tiles : tuple, optional
        Of warps in closed form, whose frames are compiled: positions at rest, modes, and rotations; and what
        :func:`~modalshell.contact.warp_kernels.warp_ended` reads of the shape.

    Attributes
    ----------
    touching : Touching
        The contacts at the time that is looked at.
    moving, rubs : bool
        Whether a collider moves, and whether a contact has friction.
    positions, moves : callable
        Positions without what is beyond the modes, and their derivatives, as given.
    shapes : LocalShapes
        What the shell gives way beyond its modes.
    spins : Turning
        How its vertices turn.
    reach : ndarray, shape (m,)
        How far [m] each coordinate may move a vertex, by a unit.
    by_rows : RowFrames
        Frames that are not compiled as a whole.
    """

    def __init__(
        self,
        contacts: Sequence[Contact],
        basis: Basis,
        positions: Callable[[Array], Array],
        rows: Rows,
        *,
        near: Near | None = None,
        turns: bool | Callable[[Array], Array] = True,
        shape: Shape | None = None,
        tiles: tuple[Array, Array, Array] | None = None,
    ) -> None:
        self.touching = Touching(contacts, basis.shell)
        self._basis, self.positions, self.moves, self.spins = basis, positions, rows, Turning(turns, basis.rotations)
        self._shape, self._tiles = shape, tiles
        self.shapes = LocalShapes(basis, CANDIDATES)
        self.moving = any(contact.motion is not None for contact in self.touching.contacts)
        self._see()
        self.rubs = any(contact.friction for contact in self.touching.contacts)
        self.reach, self._largest_turns = (largest_at_vertices(each) for each in (basis.modes, basis.rotations))
        self._kept: Any = None
        self.by_rows = RowFrames(self, near)

    def hold(self, patches: Sequence[Index]) -> None:
        """Leave the means of led patches where they are in what the shell gives way beyond its modes."""
        self.shapes = LocalShapes(self._basis, CANDIDATES, patches)

    @property
    def asks(self) -> bool:
        """Whether frames ask for derivatives, so that these may be kept."""
        return self._shape is None or self._tiles is None or self.bodies is None

    @property
    def no_pushes(self) -> Array:
        """Forces (r,) [N] along the normals where nothing touches."""
        return np.zeros(self.touching.vertices.size)

    def at(self, time: float) -> None:
        """Look at the colliders as they are at ``time`` [s]."""
        if (self.moving or self.bodies is None) and time != self.touching.time:
            self.touching = self.touching.at(time)
            self._see()

    def _see(self) -> None:
        """Take the colliders as they are, and the directions (d, 3) that their normals are made of."""
        self.bodies = self.touching.packed()
        normal = None if self.bodies is None else common_normal(self.bodies)
        self.directions = np.eye(3) if normal is None else normal[None]

    def friction(self, pushes: Array, x: Array, when: tuple[float, float, float]) -> Friction | None:
        """Friction of a step by ``pushes`` (r,) [N]; None without any.

        ``when`` it ends, how long it is, and one that is not divided [s].

        ``x`` (n, 3) [m] are the positions at its beginning.
        """
        time, dt, whole = when
        return Friction(self.touching.at(time - dt), pushes, x, dt, whole) if self.rubs and pushes.any() else None

    @property
    def rests(self) -> bool:
        """Whether all colliders rest, and are of known forms."""
        return not self.moving and self.bodies is not None

    def moved(self, before: Array, after: Array) -> float:
        """How far [m] a vertex may go between coordinates (m,)."""
        return float(kernels.reach_of(before, after, self.reach))

    def reach_within(self, local: Array) -> Array:
        """How far [m] each coordinate (m,) may move a vertex, by a unit, with what turns with it of (n, 3) [m]."""
        return self.reach + float(np.linalg.norm(local, axis=1).max(initial=0.0)) * self._largest_turns

    def along(self, q: Array, rows: Index) -> Array:
        """Derivatives (k, m) of the gaps of some rows."""
        moves = self.moves(q, self.touching.vertices[rows])
        normals = self.touching.normals(self.positions(q), rows)
        return np.asarray((normals[:, None, :] @ moves)[:, 0])

    def turning(self, q: Array, x: Array, pushes: Array) -> Array:
        """Stiffness (m, m) that ``pushes`` (r,) [N] at positions x (n, 3) take away as they turn with the surfaces."""
        rows = np.flatnonzero(pushes)
        moves, curvatures = self.moves(q, self.touching.vertices[rows]), self.touching.gaps(x, rows)[2]
        return np.einsum("kim,kij,kjl->ml", moves, pushes[rows, None, None] * curvatures, moves, optimize=True)

    def pull(self, q: Array, forces: Array) -> Array:
        """Generalised force (m,) of contact forces (n, 3) [N]."""
        vertices = np.flatnonzero(forces.any(axis=1))
        return np.einsum("ki,kim->m", forces[vertices], self.moves(q, vertices))

    def gaps(self, x: Array) -> Array:
        """Gaps (r,) [m] of all rows at positions x (n, 3)."""
        if self.bodies is None:
            return self.touching.distances(x)
        touching, gaps = self.touching, np.empty(self.touching.vertices.size)
        gaps_of(self.bodies, touching.vertices, touching.contact_of, np.ascontiguousarray(x), gaps)
        return gaps

    def frame(self, x: Array, pushes: Array) -> TouchedFrame:
        """What touches at positions x (n, 3) [m], with forces (r,) [N] along the normals."""
        if self.bodies is None:
            return touched_frame(self.touching, x, pushes)
        rows = self.touching.vertices, self.touching.contact_of
        least = frame_of(self.bodies, rows, pushes, x, forces := np.empty(x.shape), touches := np.empty(len(x), bool))
        return TouchedFrame(forces, touches, max(0.0, -least))

    def candidates(self, gaps: Array, pushes: Array, reach: float = np.inf) -> Index:
        """Rows (k,) of the vertices nearer than ``reach`` [m], and of those that are inside or pushed."""
        near, kept = min(reach, _NEAR * self.touching.size), self.shapes.most
        most = CANDIDATES if reach < np.inf else kept
        return np.asarray(kernels.candidates(gaps, pushes, near, most, kept))

    def touched(self, gaps: Array) -> bool:
        """Whether a row of some gaps (r,) touches, or is inside."""
        return bool((gaps <= EXACT_GAP * self.touching.size).any())

    def press(
        self,
        free: Array,
        compliance: Array,
        begin: tuple[Array, Array, Array],
        gaps: Array,
        before: tuple[Array, Array, Array | None],
    ) -> Pressed:
        """The coordinates nearest to ``free`` (m,), in the norm of the stiffness, that leave every vertex outside.

        ``q = free + G J^T f`` with ``0 <= f _|_ gap(x(q) + local shapes of f) >= 0``, linearised about a guess (m,)
        and again where that leads. ``compliance`` is G, (m,), or (m, m) of motions that constraints leave.

        Parameters
        ----------
        begin : tuple
            The guess (m,), the coordinates (m,) before, and the positions (n, 3) [m] there without what is beyond the
            modes.
        gaps : ndarray, shape (r,)
            Gaps [m] of all rows before, which choose the candidates.
        before : tuple
            Displacements (n, 3) [m] beyond the modes, and forces (r,) [N], before; and where derivatives were taken.
        """
        (local, pushes, at), start = before, begin[0]
        reach = self.moved(begin[1], start)
        if self.asks or compliance.ndim == 2:
            return self.by_rows.press(free, compliance, begin, gaps, (local, pushes, reach, at))
        size, most = self.touching.size, self.shapes.most
        limits = min(reach, _NEAR * size), CANDIDATES, most, SETTLED * size, FAR * size, SMALL * size
        step = free, compliance, start
        for _ in range(_RENEWED):
            kept = self._gathered(None)
            while True:
                found = warp_kernels.press(kept, self.bodies, step, (gaps, pushes, local), limits)
                if found[1].size:
                    break
                kept = self._gathered(found[0])
            _, q, pushes, forces, energy, solved = found
            base, shape, after, least = self.ended(q, kept[2], forces)
            if not solved or least >= -limits[3]:
                break
            gaps, local = np.minimum(gaps, after), shape  # what entered is taken in, too
        return Pressed(q, shape, pushes, bool(solved and least >= -limits[3]), base, energy, None, after)

    def _gathered(self, rows: Index | None) -> Any:
        """The same of candidates (k,), or of those of the last frame."""
        if rows is None:
            if self._kept is not None and self._kept[0] == self.shapes.begun:
                return self._kept[1]
            rows = np.empty(0, np.int64)
        found = self.gathered(rows)
        self._kept = self.shapes.begun, found
        return found

    def gathered(self, rows: Index) -> Any:
        """What compiled frames read of candidates (k,); see :func:`gather`."""
        vertices = self.touching.vertices
        slots = self.shapes.slots(vertices[rows])
        rows_of = vertices, self.touching.contact_of
        linear = self._shape is not None and not self._shape[2].size and self.rests and len(self.directions) == 1
        return warp_kernels.gather(self._shape, rows_of, rows, slots, self.shapes.blocks, linear)

    def ended(self, q: Array, slots: Index, forces: Array) -> tuple[Array, Array, Array, float]:
        """Positions (n, 3) [m] at q, displacements (n, 3) [m] beyond them, gaps (r,) [m], and the least of these.

        ``forces`` (k, 3) [N] are in the axes at rest.
        """
        touching, pushed = self.touching, (self.shapes.store, slots, forces)
        rows, gaps = (touching.vertices, touching.contact_of), np.empty(touching.vertices.size)
        local = np.empty_like(self._basis.shell.rest_positions)
        if not self.asks:  # such as are in closed form, on colliders of known forms
            tiles, store, rows = self.surface()
            out = np.empty_like(local), local, gaps
            return *out, warp_kernels.warp_ended(tiles, q, (store, slots, forces), rows, self.bodies, out)
        base, turns, spin = self.positions(q), self.spins.unspun(q), self.spins.spin
        if self.bodies is not None:
            least = kernels.ended(pushed, spin, q, turns, base, rows, self.bodies, local, gaps)
            return base, local, gaps, least
        kernels.local_shape(*pushed, self.spins.vectors(q), local)
        gaps = touching.distances(base + local)
        return base, local, gaps, float(gaps.min(initial=np.inf))

    def surface(self) -> Any:
        """What compiled frames read of the surface: its tiles, stored shapes, vertices and contacts of all rows."""
        assert self._tiles is not None
        count_read(self._tiles[0].nbytes + self._tiles[2].nbytes)
        return self._tiles, self.shapes.store, (self.touching.vertices, self.touching.contact_of)

    def pressed_on(self, free: Array, compliance: Array, begin: Pressed) -> Pressed:
        """The same to first order about a :meth:`state`; solved if its end meets the gaps.

        ``compliance`` is G, (m,) or (m, m).
        """
        assert begin.positions is not None
        rows = self.candidates(self.gaps(begin.positions + begin.local), begin.pushes)
        return self.by_rows.newton(free, compliance, begin, rows, 1, begin.q)[0]

    def state(self, q: Array, pushes: Array, local: Array | float) -> Pressed:
        """What forces (r,) [N] press in at q (m,), along the normals where ``local`` (n, 3) [m] was pressed in."""
        base = self.positions(q)
        return Pressed(q, self._local(q, pushes, base + local), pushes, False, base)

    def _local(self, q: Array, pushes: Array, base: Array) -> Array:
        """Displacements (n, 3) [m] beyond the modes, under forces along the normals at positions (n, 3)."""
        rows = np.flatnonzero(pushes)
        vertices, turns = self.touching.vertices[rows], self.spins.vectors(q)
        normals = self.touching.normals(base, rows)
        own = normals.copy()
        if turns.size:
            rotate(turns[vertices], normals, -1.0, own)
        return self._shape_under(vertices, pushes[rows, None] * own, turns)

    def _shape_under(self, vertices: Index, forces: Array, turns: Array) -> Array:
        """Displacements (n, 3) [m] beyond the modes under forces (k, 3) [N] in the axes at rest, turned."""
        local, slots = np.empty_like(self._basis.shell.rest_positions), self.shapes.slots(vertices)
        kernels.local_shape(self.shapes.store, slots, forces, turns, local)
        return local
