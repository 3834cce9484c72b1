"""Conditioning: what is repaired in a recording before anything else looks at it."""

from dynident.recordings.conditioning.pipeline import STEPS, Conditioning

__all__ = ["STEPS", "Conditioning"]
