"""Motions over time: what a motion is, and families of periodic ones."""
