"""Which data and which parameters are solved for at a time: one module a strategy, and all of them by their names."""
