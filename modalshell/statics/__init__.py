"""Static solvers: Newton methods, trust region, boundary continuation."""
