"""Monitoring of a robot over many days: each parameter day by day, and the day from which something differs."""

from dynident.diagnosis.monitoring.changes_over_days import monitor_days
from dynident.diagnosis.monitoring.parameter_tracks import ParameterTrack, Series, SeriesChange
from dynident.diagnosis.monitoring.reduced_days import (
    Day,
    Measure,
    build_measure,
    days_from_bytes,
    days_to_bytes,
    find_free_name,
    load_days,
    reduce_day,
)

__all__ = [
    "Day",
    "Measure",
    "ParameterTrack",
    "Series",
    "SeriesChange",
    "build_measure",
    "days_from_bytes",
    "days_to_bytes",
    "find_free_name",
    "load_days",
    "monitor_days",
    "reduce_day",
]
