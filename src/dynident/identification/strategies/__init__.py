"""Algorithms of the strategies: which data and parameters are solved for at a time."""
