"""What counts as good, doubtful and hopeless: the same here, in every warning and verdict, and in the README."""

from __future__ import annotations

USUAL = (0.05, 0.10)
"""Relative held-out error of arms with Coulomb and viscous friction alone."""

USUAL_IN_FULL = (0.02, 0.07)
"""The same once the missing effects are in."""

LARGEST_ERROR = 0.15
"""Held-out error up to which a model is fit for feed-forward or simulation: real arms reach 4 to 15 %."""

LARGEST_TO_DETECT = 0.10
"""The same to detect collisions or to weigh a payload, where what the model leaves is taken for something else."""

LARGEST_OF_JOINT = 0.5
"""Of one joint where it moves: above it, little of what the model says of that joint is so."""

LARGEST_OF_JOINT_TO_DETECT = 0.3

STOP = 0.5
"""Held-out error above which something else is wrong than a missing effect: the model is not to be used."""

OVERFIT = 1.5
"""Times the error of the fit from which on a held-out error says that the motion was too poor."""

FIRST_CONDITION_NUMBER = 100.0
"""Of W with the parameters as they are, below which a first model is good; a larger one is no harm by itself."""

LARGEST_CONDITION_NUMBER = 200.0
"""Of W with columns of the same size. Real arms on exciting motions: 12 to 24; where the motion was too poor: above
1,000."""

EQUATIONS_PER_PARAMETER = 500.0
"""As §12.7 asks for."""

DETERMINED = 0.1
"""Relative standard deviation of a determined parameter, at most: its first digit is sure, its 95 % interval within
about a fifth of the value."""
