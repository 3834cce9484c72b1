"""Conformance checks for effects and estimators of other authors; our own pass the same checks."""

from dynident.testing.effects import check_effect
from dynident.testing.estimators import check_estimator
from dynident.testing.trial_arm import ConformanceError

__all__ = ["ConformanceError", "check_effect", "check_estimator"]
