"""Analyses that solve a model many times: equilibrium paths, parameters fitted to measurements, nearby minima."""
