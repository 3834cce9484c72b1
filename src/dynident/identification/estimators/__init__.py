"""How χ is solved for: one module an estimator, and all of them by their names."""
