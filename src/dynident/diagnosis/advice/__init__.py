"""The experiment that would decide what the data could not."""
