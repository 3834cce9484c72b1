"""Criteria of how exciting a motion is, and the uncertainty of every parameter to be expected."""
