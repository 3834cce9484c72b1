"""What is believed of a model's parameters before any data."""
