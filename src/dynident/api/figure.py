"""Drawings that notebooks show and files hold."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from dynident.encoding import encode_text, replace_control_characters
from dynident.errors import DynidentError

_BOX = re.compile(r'viewBox="0 0 ([\d.]+) ([\d.]+)"')
_GAP, _HEADING = 10.0, 16.0


@dataclass(frozen=True, eq=False)
class Figure:
    """One drawing, which a notebook shows and `save` writes to a file.

    Parameters
    ----------
    svg : str
        Source of the drawing, one <svg> element.
    title : str
        What the drawing shows.
    """

    svg: str
    title: str

    def save(self, path: str | Path) -> None:
        """Write the drawing to an .svg file.

        Parameters
        ----------
        path : path
            The file to write; its ending has to be .svg.

        Raises
        ------
        DynidentError
            For another ending, or a folder that does not exist.
        """
        path = Path(path)
        if path.suffix != ".svg":
            raise DynidentError(f"cannot write {path.name}; the file name must end in .svg", pointer=str(path))
        check_folder_exists(path)
        path.write_bytes(encode_text(self.svg))

    def __repr__(self) -> str:
        return f"Figure({self.title}; save(…) writes it as SVG)"

    def _repr_html_(self) -> str:
        # The ground is white whatever the notebook's theme, since the colours are chosen for paper.
        return f'<div style="background:#fff;max-width:1060px">{self.svg}</div>'


def join_figures(parts: Sequence[str], title: str, headings: Sequence[str] = ()) -> Figure:
    """Join drawings, one below the other.

    Parameters
    ----------
    parts : sequence of str
        <svg> elements, at least one.
    title : str
        What the drawing shows.
    headings : sequence of str, optional
        One above each part.

    Returns
    -------
    Figure
        One drawing as wide as the widest part.
    """
    # Figures arrive as markupsafe.Markup, whose string methods escape their arguments; plain strings do not.
    svgs = [str(part) for part in parts]
    if len(svgs) == 1:
        return Figure(svgs[0], title)
    sizes = [_read_size(svg) for svg in svgs]
    width = max(wide for wide, _ in sizes)
    elements, top = [], 0.0
    for k, (svg, (wide, high)) in enumerate(zip(svgs, sizes, strict=True)):
        if headings:
            top += _HEADING
            elements.append(
                f'<text x="4" y="{top - 4:g}" font-family="sans-serif" font-size="9" font-weight="bold" '
                f'fill="#333333">{escape(headings[k])}</text>'
            )
        # A nested <svg> needs a place and a size of its own; its viewBox still scales what is inside.
        elements.append(svg.replace("<svg", f'<svg x="0" y="{top:g}" width="{wide:g}" height="{high:g}"', 1))
        top += high + _GAP
    box = f"0 0 {width:g} {top - _GAP:g}"
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="{box}" role="img" aria-label="{escape(title, quote=True)}">'
    )
    svg_text = f'{head}<rect width="100%" height="100%" fill="#ffffff"/>{"".join(elements)}</svg>'
    # Names come from users' files, and one control character makes the whole document invalid XML.
    return Figure(replace_control_characters(svg_text), title)


def check_folder_exists(path: Path) -> None:
    """Check that the folder of a file exists.

    Parameters
    ----------
    path : Path
        Of the file to write.

    Raises
    ------
    DynidentError
        Where it does not.
    """
    if not path.parent.is_dir():
        raise DynidentError(f"there is no folder {path.parent}", pointer=str(path), title="No such folder")


def _read_size(svg: str) -> tuple[float, float]:
    # All figures of this library state their size in a viewBox that begins at 0 0.
    match = _BOX.search(svg)
    if match is None:
        raise ValueError("a figure without a viewBox")
    return float(match[1]), float(match[2])
