"""Monitor a robot over many days: each parameter day by day, and the day from which something differs."""

from dynident.diagnosis.monitoring.days import Day, Measure, build_measure, find_free_name, reduce_day
from dynident.diagnosis.monitoring.monitor import monitor_days
from dynident.diagnosis.monitoring.result import ParameterTrack, Series, SeriesChange
from dynident.diagnosis.monitoring.storage import days_from_bytes, days_to_bytes, load_days

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
