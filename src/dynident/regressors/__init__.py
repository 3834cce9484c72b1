"""Rows of the observation matrix W from recordings and effects, accumulated in triangular factors; base parameters."""
