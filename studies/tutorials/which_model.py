"""Which model should I take? Error against cost of every rung on one shell, and the advice that follows."""

# %% [markdown]
# # A shell and a load
#
# A strip that is folded along its middle and clamped at one end. Under its weight it bends like a tape measure.

# %%
import modalshell as ms

mesh = ms.v_beam(cells=(20, 4))
material = ms.Material(stretch=20.0, shear=20.0, flexure=0.05, density=0.2)
shell = ms.Shell(mesh, material, supports=[ms.Clamp("x < 0.051")])
gravity = (0.0, 0.0, -4.0)

# %% [markdown]
# # Two models by hand
#
# Linear modes (LMA) are cheap and grow when the shell turns; modal warping (MWTS) turns with it. The discrete shell
# (DS) solves for every vertex: on this mesh it is the truth.

# %%
basis = ms.solve_modes(shell, 8)
truth = ms.DiscreteShell(shell).equilibrium(gravity=gravity)
for model in (ms.LinearModal(basis), ms.ModalWarping(basis)):
    answer = model.equilibrium(gravity=gravity)
    error = ms.measure.displacement_error(answer.positions, truth.positions, shell)
    print(f"{model.name}: {error:.2%} off, area {ms.measure.area_change(answer.positions, mesh):+.2%}")

# %% [markdown]
# # All of them, measured
#
# `ms.advise` runs every rung that the case allows at several mode counts and names the cheapest that is as accurate and
# as fast as asked. Where the shell snaps, models that cannot snap are refused.

# %%
advice = ms.advise(shell, gravity=gravity, error=0.02, fps=60.0, modes=(8,), loads=(0.5, 1.0))
print(advice.explanation)

# %% [markdown]
# # What was measured
#
# A row a rung, cheapest frame first; in bold what no cheaper one matches. In a notebook `advice` shows all of it.

# %%
advice.plot().save("tradeoff.png")
print(advice.measured.table())
