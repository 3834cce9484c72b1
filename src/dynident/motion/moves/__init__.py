"""Moves from rest to rest, ways around what is in between, and home."""
