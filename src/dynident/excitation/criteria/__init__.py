"""Criteria of how exciting a motion is, and the expected uncertainty of each parameter."""
