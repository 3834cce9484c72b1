"""What jobs do: read the inputs, call the science, give the results. Imported ahead by the child processes."""

from dynident_service.work import (
    comparisons,
    current_models,
    designs,
    diagnoses,
    drive_gains,
    identifications,
    reports,
    series,
    simulations,
    validations,
    verdicts,
)

__all__ = [
    "comparisons",
    "current_models",
    "designs",
    "diagnoses",
    "drive_gains",
    "identifications",
    "reports",
    "series",
    "simulations",
    "validations",
    "verdicts",
]
