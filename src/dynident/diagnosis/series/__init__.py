"""A robot over many days: each parameter's course, and the day from which something differs."""

from dynident.diagnosis.series.days import Day, Measure, measured, what_may_change
from dynident.diagnosis.series.result import Course, Series, SeriesChange
from dynident.diagnosis.series.series import series

__all__ = ["Course", "Day", "Measure", "Series", "SeriesChange", "measured", "series", "what_may_change"]
