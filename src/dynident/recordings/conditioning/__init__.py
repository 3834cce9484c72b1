"""Conditioning: what is repaired in a recording before anything else looks at it."""

from dynident.recordings.conditioning.conditioning_steps import STEPS, Conditioning

__all__ = ["STEPS", "Conditioning"]
