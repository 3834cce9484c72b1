"""The page of a report as PDF."""

from __future__ import annotations

from datetime import datetime
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.reports.printing.elements import parsed
from dynident.reports.printing.typesetting import typeset

if TYPE_CHECKING:
    from typst import Fonts


def pdf_of(page: str, created: datetime | None = None) -> bytes:
    """Set a report that `html_report` wrote on numbered A4 pages, as PDF.

    What the page folds is not on paper. The fonts are those that come with matplotlib, so that the pages are the same
    on every machine.

    Parameters
    ----------
    page : str
        The HTML.
    created : datetime, optional
        The moment that the file says it was made; now by default.

    Returns
    -------
    bytes
        The file.
    """
    # Loaded by those alone who print: it takes longer than the rest of a report's modules.
    import typst

    source = f"{_preamble()}\n#{typeset(parsed(page))}\n"
    moment = None if created is None else int(created.timestamp())
    return typst.compile(source.encode(), font_paths=_fonts(), format="pdf", timestamp=moment)


@lru_cache(maxsize=1)
def _preamble() -> str:
    return files("dynident.reports").joinpath("templates", "report.typ").read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _fonts() -> Fonts:
    import matplotlib
    from typst import Fonts

    return Fonts(include_system_fonts=False, font_paths=[Path(matplotlib.get_data_path()) / "fonts" / "ttf"])
