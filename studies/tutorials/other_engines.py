"""How does another engine move my shell? A basis as arrays, read back and moved by NumPy alone and in Newton."""

# %% [markdown]
# # A basis as arrays
#
# An engine that has no thin shells can still move one: it integrates a few modal coordinates and adds modes. What it
# needs is written as an NPZ file with a JSON file that names each array and its unit; `modalshell export strip.npz --to
# body` does the same for a saved basis.

# %%
import contextlib
import importlib.util
import io

import numpy as np

import modalshell as ms
from modalshell.export import save_modal_body

mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(30, 6))
material = ms.Material(stretch=20.0, shear=20.0, flexure=0.05, density=0.2)
basis = ms.solve_modes(ms.Shell(mesh, material, supports=[ms.Clamp("x < 0.034")]), 6)
for file in save_modal_body(basis, "strip.npz"):
    print(file.name, file.stat().st_size // 1000, "kB")

# %% [markdown]
# # Read back
#
# Each elastic mode is an oscillator of unit mass: q'' + λ q = φ · f. Here the force f is the weight of the vertices,
# and the strip is let go at rest.

# %%
body = dict(np.load("strip.npz"))
modes, turns, eigenvalues = body["modes"], body["rotations"], body["eigenvalues"]
gravity = np.array([0.0, 0.0, -4.0])
weight = body["masses"][:, None] * gravity
print({name: array.shape for name, array in body.items() if array.ndim})

# %% [markdown]
# # Linear modes by NumPy
#
# Under a constant force the answer is known: q = p / λ (1 - cos √λ t), with p = φ · f. LMA of this package steps the
# same oscillators, exactly under such a force.

# %%
duration, frames = 1.0, 30
times = np.linspace(0.0, duration, frames + 1)
push = np.einsum("mvi,vi->m", modes, weight)
q = push / eigenvalues * (1.0 - np.cos(np.sqrt(eigenvalues) * times[:, None]))
linear = body["vertices"] + np.einsum("tm,mvi->tvi", q, modes)
ours = ms.simulate(ms.LinearModal(basis), duration=duration, dt=duration / frames, gravity=gravity)
largest = np.abs(ours.positions - body["vertices"]).max()
apart_linear = np.abs(linear - ours.positions).max() / largest
print(f"NumPy and LMA differ by at most {apart_linear:.1e} of the largest displacement")

# %% [markdown]
# # The warp by NumPy
#
# Modal warping (MWTS) turns each vertex by the rotation w of its modes: the displacement is Rt(w) φ q, with Rt the mean
# of the rotations from 0 to w, and the force on the modes φ · R(w)ᵀ f. Steps that are exact for a force that stays as
# it is need only a millisecond to be near.

# %%
Vectors = np.ndarray


def rotated(w: Vectors, vectors: Vectors, mean: bool) -> Vectors:
    """The vectors (n, 3), turned by rotation vectors w, or by the mean of the rotations from 0 to w."""
    angle = np.maximum(np.linalg.norm(w, axis=1), 1e-12)[:, None]
    sine, cosine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    first, second = (cosine, (1.0 - sine) / angle**2) if mean else (sine, cosine)
    once = np.cross(w, vectors)
    return vectors + first * once + second * np.cross(w, once)


def warped(q: Vectors) -> Vectors:
    """Vertex positions at modal coordinates q."""
    return body["vertices"] + rotated(np.einsum("m,mvi->vi", q, turns), np.einsum("m,mvi->vi", q, modes), mean=True)


steps = 1000
omega, h = np.sqrt(eigenvalues), duration / steps
q, v = np.zeros((2, len(omega)))
for _ in range(steps):
    w = np.einsum("m,mvi->vi", q, turns)
    rest = np.einsum("mvi,vi->m", modes, rotated(-w, weight, mean=False)) / eigenvalues
    away = q - rest
    q = rest + np.cos(omega * h) * away + np.sin(omega * h) / omega * v
    v = np.cos(omega * h) * v - omega * np.sin(omega * h) * away
ours = ms.simulate(ms.ModalWarping(basis), duration=duration, dt=duration / steps, gravity=gravity)
apart_warped = np.abs(warped(q) - ours.positions[-1]).max() / np.abs(ours.positions[-1] - body["vertices"]).max()
print(f"after {duration} s NumPy and MWTS differ by {apart_warped:.1e} of the displacement")
ms.TriangleMesh(warped(q), mesh.faces).plot(size=(640, 400)).save("warped.png")

# %% [markdown]
# # In Newton
#
# Newton 1.8 has no modal bodies, but springs and particles, and an oscillator is one: a coordinate is a particle of
# unit mass on a spring of stiffness λ to a fixed one. Newton steps them; its single precision wants coordinates of
# order one, so each is measured by its static answer p / λ. The same shape then moves as above.


# %%
def moved_by_newton(steps: int) -> Vectors:
    """Modal coordinates after ``duration`` by Newton's semi-implicit solver."""
    import newton  # type: ignore[import-not-found]
    from newton.solvers import SolverSemiImplicit  # type: ignore[import-not-found]

    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    length = 10.0  # of a spring; a coordinate stays below
    for number, stiffness in enumerate(eigenvalues):
        fixed = builder.add_particle((0.0, 100.0 * number, 0.0), (0.0, 0.0, 0.0), 0.0)
        moving = builder.add_particle((length, 100.0 * number, 0.0), (0.0, 0.0, 0.0), 1.0)
        builder.add_spring(fixed, moving, float(stiffness), 0.0, 0)
    model = builder.finalize(device="cpu")
    solver, control, force = SolverSemiImplicit(model), model.control(), np.zeros((2 * len(eigenvalues), 3))
    force[1::2, 0] = eigenvalues  # the push, measured as the coordinates are
    now, then = model.state(), model.state()
    for _ in range(steps):
        now.clear_forces()
        now.particle_f.assign(force.astype(np.float32))
        solver.step(now, then, control, None, duration / steps)
        now, then = then, now
    return (now.particle_q.numpy()[1::2, 0] - length) * push / eigenvalues


if importlib.util.find_spec("newton"):
    with contextlib.redirect_stdout(io.StringIO()):  # it prints what it compiles
        q = moved_by_newton(4000)
    newton_ends = body["vertices"] + np.einsum("m,mvi->vi", q, modes)
    apart_newton = np.abs(newton_ends - linear[-1]).max() / largest
    print(f"Newton and LMA differ by {apart_newton:.1e} of the largest displacement")
else:
    print("to try it in Newton: pip install newton")
