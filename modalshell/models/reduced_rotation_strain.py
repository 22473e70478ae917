"""Reduced RSW: the rotation-strain warp on a few sampled triangles, trained in advance (theory 9, eq. 9)."""

from __future__ import annotations

from functools import cached_property, partial
from typing import NamedTuple, Self, final

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from modalshell.core.checks import LARGEST, checked_count, checked_kind, checked_number, checked_vectors, vector_count
from modalshell.core.cost import count_read
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.integrators.modal.base import DeadForce
from modalshell.kernels.frame import TILE
from modalshell.loads.surface_kernels import APART
from modalshell.models.base.rotation_strain_base import LoadAdjoint, TurnedTriangles
from modalshell.models.reduction import rotation_strain_kernels as kernel
from modalshell.models.reduction.load_points import LoadPoints
from modalshell.models.reduction.load_quadrature import ModalPush
from modalshell.models.rotation_strain import RotationStrain, tiled
from modalshell.modes import Basis
from modalshell.modes.modal_rotation import largest_at_vertices

_CANDIDATES = 2000
"""Largest number of candidate triangles; a sample by area of more."""
_FEATURES = 96
"""Principal components of the candidates' F - I that the sampled triangles must determine."""
_RESOLVED = 1e-7
"""Size of a principal component, relative to the first, below which it is rounding."""
_FALLING, _UNBENT = 0.5, 1e-6
"""Turn [rad] to train on where loads bend no part without supports, and the largest one that counts as none."""
_MIXED = 1.5
"""Largest factor of a coordinate in a mixture of training."""
_AXES: Array = np.repeat([1.0, 0, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1], TILE)[None]
"""Shape of a tile whose columns of F are wanted in the triangles' own frames."""


class ReducedWarp(NamedTuple):
    """The rotation-strain warp in reduced form: ``u = Phi q + U M (F(q) - I - L q)``, F of T sampled triangles.

    F = exp([w]) (I + S) of a triangle has six numbers, in its own frame; L q is the part that is linear in q.
    """

    shapes: Array
    """U [m]; shape (3n, r)."""
    amounts: Array
    """Transposed M: the six numbers of all triangles one after another. Shape (6 T, r)."""
    turns: Array
    """Turn w and strain S (aa, bb, ab) of the triangles in every mode; shape (6 T, m)."""


@final
class ReducedRotationStrain(TurnedTriangles):
    """RSW for frames: ``u = Phi q + U z``, z linear in the nonlinear part of F on 128 triangles.

    U holds the principal components of ``u(q) - Phi q`` of the full model over training coordinates, in the norm of
    the mass. The triangles, and the linear map from their ``F - I`` without its linear part to z, are found by
    empirical interpolation with pivoted QR [drmac2016] among candidates drawn by area. For small q the model is exact;
    elsewhere it is as good as its training is near: coordinates far outside are extrapolated, which ``training_error``
    does not show. The force is the exact gradient of the load's work on the reduced displacements. Parts without
    supports fly in frames of their own, and are trained on their shapes in these.

    Parameters
    ----------
    model : RotationStrain
        The full model.
    coordinates : array_like, shape (s, m)
        Modal coordinates to train on, s of at least ``rank``; those of rigid modes do not count.
    rank : int
        Columns of U. Positions cost a product with a (3n, m + rank) matrix.
    samples : int
        Triangles that are sampled at most, up to 128.

    Attributes
    ----------
    triangles : ndarray of int
        The sampled triangles.
    training_error : float
        Largest relative displacement error against the full model over the training coordinates, in the norm of the
        mass.

    Raises
    ------
    OptionError
        If supports leave a part rigid modes, or ``coordinates`` or ``rank`` are not as above.
    """

    name = "reduced RSW"
    _found: tuple[bytes, Array] | None = None

    def __init__(self, model: RotationStrain, coordinates: ArrayLike, *, rank: int = 32, samples: int = TILE) -> None:
        checked_kind("model", model, RotationStrain)
        basis, shell = model.basis, model.shell
        rank = checked_count("rank", rank)
        most = checked_count("samples", samples, at_most=TILE)
        given = checked_vectors("coordinates", coordinates, (vector_count(coordinates), basis.count), OptionError)
        _check_frames(model)
        given = np.where(basis.eigenvalues > 0.0, given, 0.0)
        if len(given) < rank:
            raise OptionError(f"training needs at least rank = {rank} coordinates (got {len(given)})")
        if np.abs(given).max() < 1.0 / LARGEST:
            raise OptionError(
                f"training needs coordinates that move the shell (got at most {np.abs(given).max():g} in size)"
            )
        root_mass = np.sqrt(np.repeat(shell.mass, 3))
        full = np.array([model.raw_displacement(q).ravel() for q in given])
        wanted, shapes = principal((full - given @ basis.modes.T) * root_mass, rank)
        shapes = shapes / root_mass

        chosen = candidates(shell.mesh.face_areas)
        modal = tiled(model.turns_and_strains(chosen))
        bent = np.array([deformations(modal, q) for q in given])
        bent = (bent - given @ linear_part(modal).T)[:, places(len(chosen)).ravel()]
        amounts, features = principal(bent, _FEATURES)
        picked = interpolation_triangles(features, most)
        self.triangles: Index = chosen[picked]
        rows = (6 * picked[:, None] + np.arange(6)).ravel()
        # Features from the sampled triangles, then the wanted coordinates from the features; their columns have the
        # lengths of the principal components.
        regression = (wanted.T @ (amounts / np.sum(amounts**2, axis=0))) @ np.linalg.pinv(features[:, rows].T)

        modal = tiled(model.turns_and_strains(self.triangles))
        super().__init__(basis, modal.reshape(1, basis.count, 6 * TILE), model.integrator)
        self._map = np.zeros((len(shapes), 6 * TILE))
        self._map[:, places(len(picked)).ravel()] = regression
        linear = basis.modes - shapes.T @ (self._map @ linear_part(modal))
        self._expansion = np.ascontiguousarray(np.hstack([linear, shapes.T]))
        reduced = np.array([self.raw_displacement(q).ravel() for q in given])
        errors, lengths = (np.linalg.norm(moved * root_mass, axis=1) for moved in (reduced - full, full))
        self.training_error = float((errors[lengths > 0.0] / lengths[lengths > 0.0]).max())

    def on_basis(self, basis: Basis) -> Self:
        """OptionError: its training is that of one basis."""
        raise OptionError(f"{self.name} is trained on one material: take RSW for derivatives by its constants")

    @classmethod
    def trained(
        cls,
        model: RotationStrain,
        gravities: ArrayLike | None = None,
        *,
        loads: ArrayLike | None = None,
        mixtures: int = 4,
        aside: float = 0.0,
        rank: int = 32,
        samples: int = TILE,
        seed: int = 0,
    ) -> ReducedRotationStrain:
        """Train on static solutions under loads, and on perturbed copies of them.

        Parameters
        ----------
        model : RotationStrain
            The full model.
        gravities : array_like, shape (k, 3), optional
            Accelerations [m/s^2] whose static solutions are trained on: the expected range of loads. Where none bends
            the shell, as it falls, training is on random coordinates that turn parts of it by half a radian.
        loads : array_like, shape (k, n, 3), optional
            The same as forces on the vertices [N]; one of both must be there.
        mixtures : int
            For every static answer, how many copies with each coordinate times a random number in [-1.5, 1.5]: in
            motion the modes swing apart.
        aside : float
            Size of random coordinates added to the copies, as a share of the answer's energy norm: without them forces
            are wrong in modes that the loads leave alone.
        rank, samples : int
            Columns of U, and triangles that are sampled at most.
        seed : int
            Of the random numbers.

        Raises
        ------
        OptionError
            If neither or both of ``gravities`` and ``loads`` are given, or a number is out of range.
        """
        _check_frames(checked_kind("model", model, RotationStrain))
        if (gravities is None) == (loads is None):
            raise OptionError("training takes either gravities or loads, and not both")
        rng = np.random.default_rng(checked_count("seed", seed, at_least=0))
        shell = model.shell
        if gravities is not None:
            vectors = checked_vectors("gravities", gravities, (vector_count(gravities), 3), OptionError)
            forces = [shell.gravity_force(vector) for vector in vectors]
        else:
            shape = (vector_count(loads), *shell.rest_positions.shape)
            forces = list(checked_vectors("loads", loads, shape, OptionError))
        if not forces:
            given = "gravities" if loads is None else "loads"
            raise OptionError(f"training needs at least one of {given} (got none: an array of shape (0, ...))")
        answers = np.array([model.equilibrium(force=force).coordinates for force in forces])
        factors = rng.uniform(-_MIXED, _MIXED, (checked_count("mixtures", mixtures), *answers.shape))
        mixed = factors * answers
        aside = checked_number("aside", aside, at_least=0.0)
        rigid = model.basis.rigid_modes
        if rigid and max(map(model.largest_turn, answers)) < _UNBENT:  # uniform gravity bends no shell that falls
            mixed[:, :, rigid:] = _turning(model) * rng.standard_normal(mixed[:, :, rigid:].shape)
        elif aside > 0.0:
            root = np.sqrt(model.basis.eigenvalues[rigid:])
            sizes = np.linalg.norm(answers[:, rigid:] * root, axis=1)[:, None] / root
            mixed[:, :, rigid:] += aside * sizes * rng.standard_normal(mixed[:, :, rigid:].shape)
        return cls(model, np.vstack([answers, mixed.reshape(-1, answers.shape[1])]), rank=rank, samples=samples)

    def on_page(self) -> ReducedWarp:
        """The model as arrays, from which a web page moves by it."""
        count, modes = len(self.triangles), self.basis.count
        return ReducedWarp(
            self._expansion[:, modes:],
            self._map[:, places(count)].transpose(2, 1, 0).reshape(6 * count, -1),
            self._modal[0].reshape(modes, 6, TILE)[:, :, :count].reshape(modes, -1).T,
        )

    def warped(self, q: Array) -> Array:
        """Displacements (n, 3) [m] of the reduced surface."""
        count_read(self._expansion.nbytes)
        return np.asarray(self._expansion @ self._amounts(q)).reshape(-1, 3)

    def _amounts(self, q: Array) -> Array:
        """Amounts (m + rank,) of the columns of the expansion; the last ones are kept."""
        known, key = self._found, q.tobytes()  # read once: another thread may ask for others meanwhile
        if known is not None and known[0] == key:
            return known[1]
        count_read(self._modal.nbytes + self._map.nbytes)
        sampled = np.empty((1, 6 * TILE))
        kernel.deformations(self._modal, q, np.empty(kernel.WORK), sampled)
        amounts = np.concatenate([q, self._map @ sampled[0]])
        self._found = key, amounts
        return amounts

    def farthest(self, q: Array) -> float:
        """See :meth:`ModalShape.farthest`; by the columns of the expansion."""
        return float(np.abs(self._amounts(q)) @ self._column_reach)

    @cached_property
    def _column_reach(self) -> Array:
        """How far [m] each column of the expansion moves a vertex at most, by a unit; shape (m + rank,)."""
        return largest_at_vertices(self._expansion)

    def contact_frame(self, q: Array, vertices: Index, directions: Array | None) -> tuple[Array, Array | None]:
        """Positions (k, 3) [m] of some vertices, and their derivatives; see :meth:`ModalMotion.contact_frame`."""
        expansion = self._patch_rows(self._expansion, vertices)
        points = self.shell.rest_positions[vertices] + expansion @ self._amounts(q)
        if directions is None:
            return points, None
        columns, regression = self._by_triangle
        slopes, along = np.empty(columns.shape), directions @ expansion
        kernel.deformation_rows(self._modal, _AXES, columns, q, slopes)
        by_shapes = regression @ slopes.reshape(-1, q.size)
        return points, along[:, :, : q.size] + along[:, :, q.size :] @ by_shapes

    def contact_rows(self, q: Array, vertices: Index) -> Array:
        """Derivatives (k, 3, m) of some vertices' positions by the coordinates."""
        rows = self.contact_frame(q, vertices, np.eye(3))[1]
        assert rows is not None
        return rows

    @cached_property
    def _by_triangle(self) -> tuple[Array, Array]:
        """Turns and strains (T, 6, m) of the sampled triangles, and the amounts (r, 6 T) of shapes by their numbers."""
        warp, count = self.on_page(), len(self.triangles)
        columns, amounts = (part.reshape(6, count, -1).swapaxes(0, 1) for part in (warp.turns, warp.amounts))
        return np.ascontiguousarray(columns), np.ascontiguousarray(amounts.reshape(6 * count, -1).T)

    def dead_force(self, load: Array) -> DeadForce:
        """See :meth:`ModalShape.dead_force`; the sampled triangles tell the work as well."""
        return super().dead_force(load)._replace(work=partial(self._own_work, self._face(load)))

    def _own_work(self, adjoint: LoadAdjoint, q: Array) -> float:
        return self._work_of(adjoint, q)[0]

    def _adjoint(self, load: Array) -> LoadAdjoint:
        return self._of_amounts(load.copy(), load.ravel() @ self._expansion)

    def _of_amounts(self, load: Array, pushed: Array) -> LoadAdjoint:
        """Adjoint of a load that pushes on the columns of the expansion by ``pushed`` (m + rank,)."""
        count = self.basis.count
        return LoadAdjoint(load, (pushed[count:] @ self._map)[None], pushed[:count])

    def _modal_push(self, points: LoadPoints) -> ModalPush:
        """By the reduced displacements of the points."""
        expansion = points.mean(self._expansion).reshape(-1, self._expansion.shape[1])
        none = np.empty((0, 3))

        def at_points(q: Array, forces: Array) -> Array:
            return self._work_of(self._of_amounts(none, forces.ravel() @ expansion), q)[1]

        return ModalPush(APART, at_points, self._kept_force)


def principal(snapshots: Array, count: int) -> tuple[Array, Array]:
    """Coordinates (s, k) and orthonormal components (k, N) of snapshots (s, N): ``count`` of them, if there are."""
    # Not by the squares of the snapshots, in which the last components drown in rounding.
    weights, lengths, _ = scipy.linalg.svd(snapshots, full_matrices=False)
    kept = int(np.count_nonzero(lengths[:count] > _RESOLVED * max(lengths[0], np.finfo(float).tiny)))
    weights, lengths = weights[:, :kept], lengths[:kept]
    return weights * lengths, (weights / lengths).T @ snapshots  # zero where all snapshots are


def candidates(areas: Array) -> Index:
    """Triangles to sample from: all of a small mesh, else some drawn by area, the same ones every time."""
    if len(areas) <= _CANDIDATES:
        return np.arange(len(areas))
    rng = np.random.default_rng(0)
    return np.sort(rng.choice(len(areas), _CANDIDATES, replace=False, p=areas / areas.sum()))


def interpolation_triangles(features: Array, count: int = TILE) -> Index:
    """Triangles, ``count`` at most, whose six numbers determine features (p, 6 k) best: pivots of QR."""
    _, _, pivots = scipy.linalg.qr(features, pivoting=True, mode="economic")
    triangles, first = np.unique(pivots // 6, return_index=True)
    return np.sort(triangles[np.argsort(first)][:count])


def places(count: int) -> Index:
    """Where the six numbers of ``count`` triangles (count, 6) are in flattened tiles."""
    triangle = np.arange(count)[:, None]
    return triangle // TILE * 6 * TILE + np.arange(6) * TILE + triangle % TILE


def linear_part(modal: Array) -> Array:
    """Derivatives (tiles * 6 * 128, m) in q of ``F - I`` at rest, from modal data (tiles, m, 6, 128)."""
    wa, wb, wn, aa, bb, ab = np.moveaxis(modal, 2, 0)
    columns = np.stack([aa, ab + wn, -wb, ab - wn, bb, wa], axis=1)  # tiles, 6, m, 128
    return np.ascontiguousarray(np.moveaxis(columns, 2, 3)).reshape(-1, modal.shape[1])


def deformations(modal: Array, q: Array) -> Array:
    """Columns of ``F - I`` (tiles * 6 * 128,) of triangles with modal data (tiles, m, 6, 128)."""
    out = np.empty((len(modal), 6 * TILE))
    kernel.deformations(modal.reshape(len(modal), q.size, 6 * TILE), q, np.empty(kernel.WORK), out)
    return out.ravel()


def _check_frames(model: RotationStrain) -> None:
    """OptionError where supports leave a part rigid motions: it has no frame, and training knows no large turns."""
    rigid, frames = model.basis.rigid_modes, model.frames
    own = 0 if frames is None else 6 * len(frames.parts)
    if rigid != own:
        raise OptionError(
            f"reduced RSW needs parts that their supports hold, or that have none and all six rigid modes (got {rigid} "
            f"rigid modes, {own} of them of such parts): hold more vertices, or take RSW"
        )


def _turning(model: RotationStrain) -> Array:
    """Sizes (e,) of the elastic coordinates that together turn a triangle by about :data:`_FALLING`."""
    units = np.eye(model.basis.count)[model.basis.rigid_modes :]
    return _FALLING / np.sqrt(len(units)) / np.array([model.largest_turn(unit) for unit in units])


def trained_on_loads(
    basis: Basis, loads: Array, *, integrator: str = "exponential", rank: int = 32, mixtures: int = 16
) -> ReducedRotationStrain:
    """Reduced RSW trained on the loads (k, n, 3) [N] of a scene, and on random coordinates about their answers."""
    full = RotationStrain(basis, integrator=integrator)
    return ReducedRotationStrain.trained(full, loads=loads, mixtures=mixtures, aside=0.1, rank=rank)
