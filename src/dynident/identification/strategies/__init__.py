"""Strategies decide which data and which parameters are solved for at a time: one module a strategy."""
