"""Repairs of a recording's rows before any check: corrupted and missing samples, wrapped angles, idle drives."""

from dynident.recordings.conditioning.conditioning_steps import STEPS, Conditioning

__all__ = ["STEPS", "Conditioning"]
