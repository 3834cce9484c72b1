"""Equation types: which rows W has. Each class in a file here is one."""
