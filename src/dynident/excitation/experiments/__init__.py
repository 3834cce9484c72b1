"""Kinds of experiments: each turns a request into a motion from home to home that keeps all limits."""
