"""The version, in the one place that every part reads it from."""

__version__ = "0.1.0"
