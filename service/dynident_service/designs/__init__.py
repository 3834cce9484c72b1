"""Designed experiments, and simulated measurements of a virtual robot."""
