"""Priors: what is known from the robot's description beside the data. Each file here is one."""
