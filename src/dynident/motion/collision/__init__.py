"""Collision checks of motions with the surroundings and the robot itself."""
