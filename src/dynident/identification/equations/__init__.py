"""Equations that an identification solves, reduced from recordings, and their checks."""
