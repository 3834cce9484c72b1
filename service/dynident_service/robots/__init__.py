"""Robots, known arms and collision meshes."""
