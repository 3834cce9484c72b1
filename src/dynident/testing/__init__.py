"""Do an effect and an estimator of one's own keep to what all others rely on? Ours are tried by the same checks."""

from dynident.testing.effects import check_effect
from dynident.testing.estimators import check_estimator
from dynident.testing.failing import ConformanceError

__all__ = ["ConformanceError", "check_effect", "check_estimator"]
