"""What jobs do: read the inputs, call the science, give the results. Imported ahead by the child processes."""

from dynident_service.work import comparisons, diagnoses, identifications

__all__ = ["comparisons", "diagnoses", "identifications"]
