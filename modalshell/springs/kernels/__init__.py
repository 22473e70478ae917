"""Kernels of springs: grids, blocks of particles, ranks and devices."""
