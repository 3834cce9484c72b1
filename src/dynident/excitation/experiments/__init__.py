"""Kinds of experiments, one module each: from the request to a motion from home to home that keeps every limit."""
