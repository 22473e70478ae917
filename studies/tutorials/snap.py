"""When does it snap? A folded strip under its growing weight: its path of equilibria, and what linear theory says."""

# %% [markdown]
# # A folded strip of stiff paper
#
# Clamped at one end, it bends down under its weight. Its section opens, which softens it, until it gives way at once.

# %%
import numpy as np

import modalshell as ms

mesh = ms.v_beam(cells=(20, 4))
material = ms.Material(stretch=2000.0, shear=2000.0, flexure=0.05, density=0.2)
shell = ms.Shell(mesh, material, supports=[ms.Clamp("x < 0.076")])
weight = (0.0, 0.0, -70.0)

# %% [markdown]
# # Follow the equilibria
#
# `ms.equilibrium_path` follows all equilibria while the load grows from 0 to `until` times `gravity`, around limit
# points too, and names events: "limit" where the load cannot grow, "bifurcation" where another path begins.

# %%
path = ms.equilibrium_path(ms.DiscreteShell(shell), gravity=weight, until=1.0)
print(path.outcome, len(path.factors), "points,", int(np.sum(path.stable)), "of them stable")
for kind, index, factor in path.events:
    print(f"{kind} at {factor:.3f} of the load, displacement {path.displacements[index]:.3f} m")

# %% [markdown]
# # What a solver says that does not follow the path
#
# An equilibrium under more than the first limit load lies beyond the snap; the answer tells what ended the stable
# branch.

# %%
answer = ms.DiscreteShell(shell).equilibrium(gravity=weight)
print(answer.status, "stable" if answer.stable else "not stable", answer.message)

# %% [markdown]
# # Linear buckling, for comparison
#
# Factors of the problem linearised about rest: quick, and wrong where the shell bends much before it gives way.

# %%
print("linear buckling at", ms.buckling_factors(shell, gravity=weight).factors, "of the load")
