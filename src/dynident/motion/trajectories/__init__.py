"""Motions over time: what a motion is, and the families of periodic ones."""
