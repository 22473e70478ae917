"""Numba kernels: the generated energies (``generated``) and the hand-written rotations."""
