"""Static solvers: Newton methods, trust region, continuation, equilibrium paths."""
