"""Moves from rest to rest, paths around obstacles, and home postures."""
