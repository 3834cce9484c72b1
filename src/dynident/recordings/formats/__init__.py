"""Readers of log files, a module for each format; all give named columns in blocks of rows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.recordings.formats.open_any_format import FORMATS, format_of, open_source

__all__ = ["FORMATS", "format_of", "open_source"]

if not TYPE_CHECKING:
    # Readers import what stands beside this package, and that imports single readers: names are loaded when needed.
    __getattr__, __dir__ = make_lazy_exports(__name__)
