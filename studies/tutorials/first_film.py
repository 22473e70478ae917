"""How does a mesh of mine move? From a file to modes, an equilibrium, a film's frames and a page."""

# %% [markdown]
# # A mesh of my own
#
# `ms.load_mesh` reads OBJ, PLY, STL, OFF and glTF and says what is wrong with a mesh that is no shell; `ms.repair`
# mends it. Here a leaf stands for a mesh of your own: it is written to a file and read back.

# %%
from pathlib import Path

import modalshell as ms

ms.save_mesh(ms.leaf(length=0.2, width=0.08), "my_mesh.obj")
mesh = ms.load_mesh("my_mesh.obj")
mesh.plot(size=(640, 400)).save("mesh.png")
print(mesh)

# %% [markdown]
# # A material and supports
#
# `ms.Isotropic` takes the numbers of a data sheet: Young's modulus [Pa], Poisson's ratio, thickness [m], density
# [kg/m³]. The stalk is clamped, by a condition on the coordinates.

# %%
paper = ms.Isotropic(young=2e7, poisson=0.3, thickness=4e-4, density=800.0)
shell = ms.Shell(mesh, paper, supports=[ms.Clamp("x < 0.01")])
print(shell)

# %% [markdown]
# # Modes, once
#
# The basis holds the lowest vibration modes and their rotations. It is computed once; everything after it is cheap.

# %%
basis = ms.solve_modes(shell, 8)
basis.plot(size=(960, 540)).save("modes.png")
print(basis.frequencies)

# %% [markdown]
# # Where does it hang?
#
# Modal warping (MWTS) turns each vertex by the rotation of its modes, so that large bending keeps its shape. The answer
# says whether it converged; `measure` says by how much the area is off.

# %%
model = ms.ModalWarping(basis)
hanging = model.equilibrium(gravity=(0.0, 0.0, -9.81))
hanging.plot(size=(640, 400)).save("hanging.png")
print(hanging.status, f"area {ms.measure.area_change(hanging.positions, mesh):+.2%}")

# %% [markdown]
# # How does it move?
#
# `simulate` returns every frame. The trajectory writes itself for other programs: `.usdc`, `.glb`, `.pc2`, `.clip`, ...

# %%
run = ms.simulate(model, duration=1.0, dt=1 / 30, gravity=(0.0, 0.0, -9.81), damping=(1.0, 0.002))
run.save("leaf.clip")
run.plot(size=(960, 300)).save("motion.png")
print(run.status, len(run.times), "frames,", Path("leaf.clip").stat().st_size, "bytes")

# %% [markdown]
# # Send it
#
# One file, no server: in a notebook `basis.page()` shows the page itself, live.

# %%
page = basis.page("leaf.html", title="My leaf", gravity=(0.0, 0.0, -9.81))
print(len(page.text) // 1000, "kB")
