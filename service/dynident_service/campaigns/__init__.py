"""Campaigns: runs of a robot, one after the other, until its torque is predicted as well as asked for."""
