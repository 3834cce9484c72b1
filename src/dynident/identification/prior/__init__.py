"""Prior knowledge of a model's parameters, from the robot's description."""
