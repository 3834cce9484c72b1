"""Monitor a robot over many days: each parameter day by day, and the day from which something differs."""

from dynident.diagnosis.series.days import Day, Measure, free_name, measured, what_may_change
from dynident.diagnosis.series.result import Course, Series, SeriesChange
from dynident.diagnosis.series.series import series
from dynident.diagnosis.series.storage import days_from_bytes, days_to_bytes, resumed

__all__ = [
    "Course",
    "Day",
    "Measure",
    "Series",
    "SeriesChange",
    "days_from_bytes",
    "days_to_bytes",
    "free_name",
    "measured",
    "resumed",
    "series",
    "what_may_change",
]
