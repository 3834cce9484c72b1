"""Priors: what is known from the robot's description beside the data. Each class in a file here is one."""
