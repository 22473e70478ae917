"""Kernels of springs: grids, blocks of particles, and devices."""
