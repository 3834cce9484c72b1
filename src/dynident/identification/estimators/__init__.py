"""Algorithms of the estimators that need more than a least-squares solution: one module for each."""
