"""Strategies: which data and which parameters are solved for at a time. Each class in a file here is one."""
