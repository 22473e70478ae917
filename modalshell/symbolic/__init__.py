"""Symbolic discrete-shell energies and the generator of the numba kernels (development time only).

``python -m modalshell.symbolic`` generates :mod:`modalshell.shell.kernels.generated`. Nothing outside this folder
imports it, so that ``import modalshell`` does not load SymPy.
"""
