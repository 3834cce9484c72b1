"""The demonstration: a virtual robot with a hidden effect, which is named from its recordings alone."""
