"""Equation types: which rows W has. Each file here is one."""
