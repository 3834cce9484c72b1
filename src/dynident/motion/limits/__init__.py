"""Limits that a motion must keep: which they are, what fits into them, and how near a motion comes to each."""
