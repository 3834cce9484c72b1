"""Readers of the files that robots and their loggers write, one module a format: named columns in blocks of rows."""

from dynident.recordings.formats.open_any_format import FORMATS, format_of, open_source

__all__ = ["FORMATS", "format_of", "open_source"]
