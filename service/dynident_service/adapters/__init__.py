"""Adapters between the HTTP contract and the library: bodies become request dataclasses, results become views."""
