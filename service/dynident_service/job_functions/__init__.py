"""The functions that jobs run, in child processes: read stored inputs, call the library, return results.

The queue stores these functions as "module:name". A function or module that is renamed must stay importable by its old
name while a database may hold jobs with it.
"""

from dynident_service.job_functions import (
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
]
