"""Identification of drive gains, and of models in units of the motor current."""
