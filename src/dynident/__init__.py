"""The dynamic model of a robot, identified from measurements."""
