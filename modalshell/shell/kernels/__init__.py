"""Kernels of the shell's energies: generated ones (``generated``), and those over elements and split folds."""
