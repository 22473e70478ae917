"""What are the stresses of a plate? Shell theory, supports, a pressure, fields and a check against Navier's series."""

# %% [markdown]
# # A square plate on four simple supports
#
# 200 mm by 200 mm of steel, 2 mm thick, pushed by 5 kPa. `Pin` holds the edge and leaves its slope free.

# %%
import numpy as np

import modalshell as ms

side, thickness, young, poisson, pressure = 0.2, 2e-3, 210e9, 0.3, 5e3
mesh = ms.sheet(length=side, width=side, cells=(24, 24), family="union-jack")
steel = ms.Isotropic(young=young, poisson=poisson, thickness=thickness, density=7850.0)
shell = ms.Shell(mesh, steel, supports=[ms.Pin("boundary")])

# %% [markdown]
# # Deflection
#
# The discrete shell solves for all vertices, geometry nonlinear. At 5 kPa the plate moves by less than a fifth of its
# thickness, so that Navier's series for small deflections holds within a few per cent: w = 0.00406 p a⁴ / D.

# %%
answer = ms.DiscreteShell(shell).equilibrium(loads=[ms.Pressure(pressure)])
stiffness = young * thickness**3 / (12.0 * (1.0 - poisson**2))
deflection = float(np.abs(answer.positions[:, 2]).max())
navier = 0.00406 * pressure * side**4 / stiffness
print(f"{answer.status}: deflection {1e3 * deflection:.4f} mm, Navier {1e3 * navier:.4f} mm")

# %% [markdown]
# # Stress
#
# `shell.fields` holds strains, forces, curvatures and moments of every triangle, and the von Mises stress. Navier: at
# the middle both moments are 0.0479 p a², so the stress of the face is 6 M / h².

# %%
fields = shell.fields(answer.positions)
stress = np.asarray(fields.von_mises)
expected = 6.0 * 0.0479 * pressure * side**2 / thickness**2
middle = np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1)[:, :2] - mesh.vertices[:, :2].mean(axis=0), axis=1)
at_middle = float(stress[middle < 0.05 * side].mean())
print(f"stress at the middle {at_middle / 1e6:.2f} MPa, Navier {expected / 1e6:.2f} MPa")

# %% [markdown]
# # Who carries it?
#
# Reactions at the supports, zero elsewhere; their sum is the load.

# %%
reactions = shell.reactions(answer.positions, loads=[ms.Pressure(pressure)])
print(f"reactions {reactions[:, 2].sum():.3f} N, load {pressure * side**2:.3f} N")
answer.plot(size=(640, 400)).save("plate.png")
