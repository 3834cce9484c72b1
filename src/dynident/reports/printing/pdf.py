"""Reports as PDF files."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import matplotlib
import typst

from dynident.encoding import encode_text
from dynident.reports.printing.elements import parse_page
from dynident.reports.printing.typesetting import typeset_page


def render_pdf(page: str) -> bytes:
    """Typeset a report that `html_report` wrote on numbered A4 pages, as PDF.

    Folded parts of the page are left out. The fonts are those that come with matplotlib, and the date stands in the
    page itself, so the same page gives the same file on every machine.

    Parameters
    ----------
    page : str
        The HTML.

    Returns
    -------
    bytes
        The file.
    """
    source = f"{_read_preamble()}\n{typeset_page(parse_page(page))}\n"
    return typst.compile(encode_text(source), font_paths=_load_fonts(), format="pdf")


@lru_cache(maxsize=1)
def _read_preamble() -> str:
    return files("dynident.reports").joinpath("templates", "report.typ").read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _load_fonts() -> typst.Fonts:
    return typst.Fonts(include_system_fonts=False, font_paths=[Path(matplotlib.get_data_path()) / "fonts" / "ttf"])
