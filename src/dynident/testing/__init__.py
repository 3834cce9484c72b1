"""Conformance checks for effects and estimators of other authors; our own pass the same checks."""

from dynident.testing.effect_conformance import check_effect
from dynident.testing.estimator_conformance import check_estimator
from dynident.testing.trial_arm import ConformanceError

__all__ = ["ConformanceError", "check_effect", "check_estimator"]
