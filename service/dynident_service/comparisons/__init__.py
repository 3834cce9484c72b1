"""Comparisons of a model's torque with a measured one."""
