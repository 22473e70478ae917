"""Analyses that solve a model many times: equilibrium paths, fitted constants, minima next to known ones."""
