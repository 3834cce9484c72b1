"""Algorithms of the estimators that need more than one least-squares solution, a module for each."""
