"""Kernels of crowds and flocks, for the processor and for devices."""
