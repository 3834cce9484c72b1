"""Equations that an identification is solved from, reduced from recordings, and their checks."""
