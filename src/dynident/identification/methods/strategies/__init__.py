"""Strategies: which data and which parameters are solved for at a time. Each file here is one."""
