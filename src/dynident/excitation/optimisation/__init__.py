"""Optimisation of periodic trajectories: the smooth problem, and its solver."""
