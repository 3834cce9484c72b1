"""The choices of method: classes of equation types, strategies, estimators and priors, with names and options.

A class says what its kind is called and what it is for, and loads what it computes with when it computes: the command
line and the contract read all of them.
"""
