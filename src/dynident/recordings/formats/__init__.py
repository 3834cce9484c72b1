"""Readers of log files, a module for each format; all give named columns in blocks of rows."""

from dynident.recordings.formats.open_any_format import FORMATS, format_of, open_source

__all__ = ["FORMATS", "format_of", "open_source"]
