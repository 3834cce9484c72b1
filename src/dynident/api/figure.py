"""Figures that notebooks show and that are saved as SVG, PNG or PDF."""

from __future__ import annotations

import operator
import pickle
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.api.argument_checks import CheckedResult, require
from dynident.errors import DynidentError
from dynident.file_output import check_ending, write_atomically
from dynident.optional_dependencies import format_install_hint
from dynident.text_encoding import encode_text, replace_control_characters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MatplotlibFigure
    from matplotlib.transforms import Transform

_BOX = re.compile(r'viewBox="0 0 ([\d.]+) ([\d.]+)"')
_GAP, _HEADING = 10.0, 16.0


_ENDINGS = (".svg", ".png", ".pdf")


@dataclass(frozen=True, eq=False)
class Figure(CheckedResult):
    """One drawing, which a notebook shows and `save` writes to a file.

    Parameters
    ----------
    svg : str
        Source of the drawing, one <svg> element.
    title : str
        What the drawing shows.
    drawn_from : tuple of matplotlib.figure.Figure
        The figures of its parts, from top to bottom.

    Examples
    --------
    >>> model.plot().save("ladder.png", dpi=300)  # doctest: +SKIP
    >>> axes = model.plot().axes  # doctest: +SKIP
    >>> axes[0].set_title("before"); axes[0].figure.savefig("mine.png")  # doctest: +SKIP
    """

    svg: str
    title: str
    drawn_from: tuple[MatplotlibFigure, ...] = ()

    @property
    def axes(self) -> list[Axes]:
        """The matplotlib axes of all panels, to be changed; `axes[0].figure.savefig(…)` writes what was changed.

        Changes do not show in `svg` and `save`.
        """
        return [axes for figure in self.drawn_from for axes in figure.axes]

    def draw(self, axes: Axes, panel: int = 0) -> Axes:
        """Draw one panel on matplotlib axes of one's own, with its title, labels, limits and colours.

        Parameters
        ----------
        axes : matplotlib.axes.Axes
            Where to draw; what is there stays.
        panel : int
            Number of the panel, in the order of `axes`.

        Returns
        -------
        matplotlib.axes.Axes
            The same axes; `axes.legend()` shows what the lines are.

        Raises
        ------
        DynidentError
            For what are no axes, or a panel that there is not.

        Examples
        --------
        >>> figure, axes = plt.subplots()  # doctest: +SKIP
        >>> dy.compare(model, runs).plot("elbow").draw(axes, panel=1)  # the residual  # doctest: +SKIP
        """
        require(hasattr(axes, "transData"), axes, "axes", "give matplotlib's: figure, axes = plt.subplots()")
        titles = [item.get_title(loc="left") for item in self.axes]
        if not isinstance(panel, Integral) or panel not in range(len(titles)):
            listed = "; ".join(f"{number}: {title}" for number, title in enumerate(titles))
            raise DynidentError(f"there is no panel {panel!r}; the panels are {listed or 'none'}", pointer="panel")
        figure, place = [(figure, k) for figure in self.drawn_from for k in range(len(figure.axes))][panel]
        # A copy, whose artists can be taken out of it: an artist belongs to one figure alone.
        _move_artists(pickle.loads(pickle.dumps(figure)).axes[place], axes)
        return axes

    def save(self, path: str | Path, *, dpi: float = 200.0) -> None:
        """Write the drawing to a file.

        Parameters
        ----------
        path : path
            The file to write; its ending has to be .svg, .png or .pdf.
        dpi : float
            Pixels per inch of a PNG.

        Raises
        ------
        DynidentError
            For another ending, a folder that does not exist, or where the package that renders PNG and PDF (typst) is
            not installed.
        """
        path = check_ending(path, _ENDINGS)
        ending = path.suffix.lower()
        if ending == ".svg":
            write_atomically(path, encode_text(self.svg))
            return
        if not (isinstance(dpi, (int, float)) and 10 <= dpi <= 2400):
            raise DynidentError(f"dpi is {dpi!r:.60}; give pixels per inch from 10 to 2400", pointer="dpi")
        try:
            from dynident.reports.pdf_report import render_drawing
        except ModuleNotFoundError as missing:
            raise DynidentError(
                f"writing {ending} needs the package {missing.name}, which is not installed; "
                f"{format_install_hint(missing.name or '')}. SVG needs nothing more: save('{path.stem}.svg')",
                pointer=str(path),
                title="Not installed",
            ) from missing
        write_atomically(path, render_drawing(self.svg, "png" if ending == ".png" else "pdf", dpi))

    def __repr__(self) -> str:
        return f"Figure({self.title}; save(…) writes it as SVG, PNG or PDF)"

    def _repr_html_(self) -> str:
        # The ground is white whatever the notebook's theme, since the colours are chosen for paper.
        return f'<div style="background:#fff;max-width:1060px">{self.svg}</div>'


def _move_artists(source: Axes, target: Axes) -> None:
    """Move all that is drawn on some axes to others, and describe these alike."""
    from matplotlib.artist import Artist
    from matplotlib.collections import Collection

    # What is placed by the data, by the panel, or by one of them in each direction stays so in the other panel.
    ways: list[Callable[[Axes], Transform]] = [operator.attrgetter("transData"), operator.attrgetter("transAxes")]
    ways += [operator.methodcaller(f"get_{axis}axis_transform", which="grid") for axis in "xy"]
    places = [(way(source), way(target)) for way in ways]
    for artist in [*source.lines, *source.patches, *source.collections, *source.images, *source.texts]:
        of_data = Artist.get_transform(artist)
        offset = artist.get_offset_transform() if isinstance(artist, Collection) else None
        artist.remove()
        for before, after in places:
            if of_data == before:
                artist.set_transform(after)
            if isinstance(artist, Collection) and offset == before:
                artist.set_offset_transform(after)
        artist.set_clip_path(None)
        target.add_artist(artist)
    target.set_title(source.get_title(loc="left"), loc="left")
    for axis in "xy":
        for name in ("scale", "label", "lim"):
            getattr(target, f"set_{axis}{name}")(getattr(source, f"get_{axis}{name}")())
        labels = [text.get_text() for text in getattr(source, f"get_{axis}ticklabels")()]
        if any(re.search("[A-Za-z]", text.replace("mathdefault", "")) for text in labels):
            getattr(target, f"set_{axis}ticks")(getattr(source, f"get_{axis}ticks")(), labels)


def join_figures(parts: Sequence[str | Figure], title: str, headings: Sequence[str] = ()) -> Figure:
    """Join drawings, one below the other.

    Parameters
    ----------
    parts : sequence of str or Figure
        <svg> elements or drawings.
    title : str
        What the drawing shows.
    headings : sequence of str, optional
        One above each part.

    Returns
    -------
    Figure
        One drawing as wide as the widest part.

    Raises
    ------
    DynidentError
        Where there is no part.
    """
    if not parts:
        raise DynidentError("nothing to draw: there are no items")
    # Figures arrive as markupsafe.Markup, whose string methods escape their arguments; plain strings do not.
    svgs = [str(part.svg if isinstance(part, Figure) else part) for part in parts]
    drawn_from = tuple(figure for part in parts for figure in _list_figures(part))
    if len(svgs) == 1:
        return Figure(svgs[0], title, drawn_from)
    sizes = [_read_size(svg) for svg in svgs]
    width = max(wide for wide, _ in sizes)
    elements, top = [], 0.0
    for k, (svg, (wide, high)) in enumerate(zip(svgs, sizes, strict=True)):
        if headings:
            top += _HEADING
            elements.append(
                f'<text x="4" y="{top - 4:g}" font-family="DejaVu Sans, sans-serif" font-size="9" font-weight="bold" '
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
    return Figure(replace_control_characters(svg_text), title, drawn_from)


def _list_figures(part: str | Figure) -> tuple[MatplotlibFigure, ...]:
    if isinstance(part, Figure):
        return part.drawn_from
    figure = getattr(part, "figure", None)
    return () if figure is None else (figure,)


def _read_size(svg: str) -> tuple[float, float]:
    # All figures of this library state their size in a viewBox that begins at 0 0.
    match = _BOX.search(svg)
    if match is None:
        raise ValueError("a figure without a viewBox")
    return float(match[1]), float(match[2])
