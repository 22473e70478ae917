"""Reduced energies and maps: modal derivatives, cubature, the Poisson fit, the fused warp frame."""
