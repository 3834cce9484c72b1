"""The ways to identify: models, strategies, estimators and priors.

A class says what its kind is called and what it is for, and loads what it computes with when it computes: the command
line and the contract read all of them.
"""
