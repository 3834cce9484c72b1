"""The demonstration: a virtual robot with a hidden effect, which is found by name from its recordings alone."""
