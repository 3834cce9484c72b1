"""Compare measured with predicted torque: where they differ, and how much of that is noise."""
