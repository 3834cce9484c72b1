"""Read a pasted text table of Denavit-Hartenberg parameters, classical or modified.

The first line says the convention and the columns; the others are a joint each::

    classical                          modified                         khalil
    a       alpha   d       theta      alpha  a     d      theta        alpha  d  theta  r
    0       pi/2    0.1273  q1         0      0     0.333  q1           …
    -0.612  0       0       q2         -pi/2  0     0      q2
    -0.5723 0       0       q3 - pi/2  pi/2   0     0.316  q3

Columns stand in any order and are separated by spaces, tabs, commas, semicolons or bars; lines that start with # or %
are comments, and may say the convention too. The joint variable (q2, θ2, *) in theta or d tells revolute from
prismatic; what stands beside it is constant. A column without one is a constant; theta is the variable where there
is none. Angles are in radians, or in degrees where the column says so (`alpha[deg]`) or a number has °; lengths are in
metres, or in the unit that the column states (`a[mm]`).

classical (standard, distal): T = Rot(z, θ) Trans(z, d) Trans(x, a) Rot(x, α), of Denavit and Hartenberg (1955).
modified (Craig, proximal): T = Rot(x, α) Trans(x, a) Rot(z, θ) Trans(z, d), with α and a of index j - 1 in row j.
khalil: the same, with d for a and r for d (Khalil and Kleinfinger, 1986).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NotRequired, TypedDict

from dynident.errors import DynidentError
from dynident.robot.json_fields import expect_number
from dynident.robot.limits_and_drives import Drive, Limits
from dynident.robot.modified_dh import robot_from_modified_dh
from dynident.robot.robot_model import Robot

TITLE = "Unusable Denavit-Hartenberg table"

Convention = Literal["classical", "modified", "khalil"]
_CONVENTIONS: dict[str, Convention] = {
    "classical": "classical",
    "classic": "classical",
    "standard": "classical",
    "distal": "classical",
    "modified": "modified",
    "craig": "modified",
    "proximal": "modified",
    "khalil": "khalil",
    "kleinfinger": "khalil",
}
_COLUMNS = {"a": "a", "alpha": "alpha", "α": "alpha", "d": "d", "theta": "theta", "θ": "theta", "r": "r", "q": "theta"}
# Heads of columns that name or count the rows: no names of joints.
_LABELS = {"joint", "link", "i", "j", "name", "axis", "row", "no", "nr"}
# The joint variable as papers write it, with its sign: q2, θ_2, q_{2}, d3, or a star.
_VARIABLE = re.compile(r"(?:[+-]\s*)?(?:q|θ|theta|d|r|t)_?\{?(?:\d+|i|j)\}?\*?|(?:[+-]\s*)?[*]")
_COMMENT = ("#", "%", "//")
_TO_SI = {"deg": math.pi / 180.0, "°": math.pi / 180.0, "mm": 1e-3, "cm": 1e-2}
_UNIT = re.compile(r"deg|°|(?<![a-zα])[mc]m(?![a-z])")
_UNIT_APART = re.compile(r" (?=[\[(](?:rad|deg|°|m|mm|cm)\w*[\])])")


class PastedRow(TypedDict):
    """A joint's row for `robot_from_modified_dh`: rad, m, and `sigma` = 1 for a prismatic joint."""

    name: NotRequired[str]
    alpha: float
    d: float
    theta: float
    r: float
    sigma: int


class PastedTable(TypedDict):
    """A table for `robot_from_modified_dh`."""

    joints: list[PastedRow]


@dataclass(frozen=True)
class _Line:
    """A line of the text with its number, from 1, and its cells."""

    number: int
    cells: tuple[str, ...]


def robot_from_dh_text(
    name: str,
    text: str,
    *,
    limits: Mapping[str, Limits] | None = None,
    drives: Mapping[str, Drive] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    pointer: str = "",
) -> Robot:
    """Return the robot of a table pasted as text.

    The robot's description becomes the modified table of the same machine as JSON. Such a table has no masses and no
    limits.

    Parameters
    ----------
    name : str
        Name of the robot.
    text : str
        The table; the module's docstring shows its form.
    limits : mapping of str to Limits, optional
        By joint; they win over the description's, field by field.
    drives : mapping of str to Drive, optional
        Drive chains [12.17], by joint.
    locked_joints : mapping of str to float, optional
        Positions (rad, m) of joints that no longer move; their links become part of the link before.
    gravity : sequence of float, optional
        Acceleration of gravity in the base frame (m/s²); (0, 0, -9.81) by default.
    pointer : str
        JSON pointer to the text in the caller's request.

    Returns
    -------
    Robot
        One joint for every row.

    Raises
    ------
    DynidentError
        With the number of a line that cannot be read, or if the text does not name its convention.
    """
    return robot_from_modified_dh(
        name,
        json.dumps(parse_dh_table(text, pointer)),
        limits=limits,
        drives=drives,
        locked_joints=locked_joints,
        gravity=gravity,
        pointer=pointer,
    )


def parse_dh_table(text: str, pointer: str = "") -> PastedTable:
    """Return the modified table, as `robot_from_modified_dh` takes it, of a pasted one.

    Parameters
    ----------
    text : str
        The table; the module's docstring shows its form.
    pointer : str
        JSON pointer to the text in the caller's request.

    Returns
    -------
    PastedTable
        Rows in rad and m.

    Raises
    ------
    DynidentError
        As `robot_from_dh_text`.
    """
    convention, lines = _split_lines(text, pointer)
    head = next((line for line in lines if _is_header(line)), None)
    if head is None:
        raise _make_error("the table has no line with column names, such as: a alpha d theta.", None, pointer)
    places, factors, implied = _find_columns(head, pointer)
    convention = convention or implied
    if convention is None:
        raise _make_error(
            'is the table classical or modified? Write "classical" or "modified" above it: classical has Rot(z, θ) '
            "Trans(z, d) Trans(x, a) Rot(x, α), modified (Craig) Rot(x, α) Trans(x, a) Rot(z, θ) Trans(z, d).",
            head.number,
            pointer,
        )
    length, offset = ("d", "r") if convention == "khalil" else ("a", "d")
    for required_column in ("alpha", length, "theta", offset):
        if required_column not in places:
            raise _make_error(f"there is no column {required_column}.", head.number, pointer)
    rows = [line for line in lines if line.number > head.number]
    if not rows:
        raise _make_error("the table has no rows.", head.number, pointer)
    read = [_read_row(line, places, factors, length, offset, pointer) for line in rows]
    if convention == "classical":
        # The classical transform ends with Trans(x, a) Rot(x, α), the modified one begins with them: moving a and α one
        # row down turns one into the other. The last row's move the tool alone and no joint, so they are dropped.
        before = [(0.0, 0.0), *((row["alpha"], row["d"]) for row in read)]
        read = [row | {"alpha": alpha, "d": a} for row, (alpha, a) in zip(read, before, strict=False)]
    return {"joints": read}


def _split_lines(text: str, pointer: str) -> tuple[Convention | None, list[_Line]]:
    convention: Convention | None = None
    lines = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        words = re.findall(r"[a-zA-Z]+", line.casefold())
        line_convention = next((_CONVENTIONS[word] for word in words if word in _CONVENTIONS), None)
        # The first convention that is named holds for the whole table.
        convention = convention or line_convention
        if (
            not line
            or line.startswith(_COMMENT)
            or (line_convention is not None and not re.search(r"\d|alpha|α", line))
        ):
            continue
        if set(line) <= set("|-:+= \t"):
            continue  # the rule below a head
        lines.append(_Line(number, _split_cells(line)))
    if not lines:
        raise _make_error("it contains no table.", None, pointer)
    return convention, lines


def _split_cells(line: str) -> tuple[str, ...]:
    for separator in ("|", ";", "\t", ","):
        if separator in line.strip("|"):
            return tuple(cell.strip() for cell in line.strip().strip("|").split(separator))
    # Signs between spaces belong to the cell, and so do units in brackets: q2 - pi/2, a [mm].
    joined = _UNIT_APART.sub("", re.sub(r" ?([+*/-]) ", r"\1", " ".join(line.split())))
    return tuple(joined.split())


def _is_header(line: _Line) -> bool:
    # Three names of columns make a head. A row of numbers has none, and titles hardly ever have so many.
    return sum(_parse_column_name(cell)[0] is not None for cell in line.cells) >= 3


def _parse_column_name(cell: str) -> tuple[str | None, float, bool]:
    """Return the column that a cell of the head names, the factor to rad or m, and whether its index is j - 1."""
    plain = cell.casefold().strip(" $\\")
    unit = _UNIT.search(plain)
    factor = 1.0 if unit is None else _TO_SI[unit[0]]
    before = bool(re.search(r"[ij]\s*[-−]\s*1", plain))
    word = re.match(r"[a-zαθ]+", re.sub(r"\\", "", plain))
    return (_COLUMNS.get(word[0]) if word else None), factor, before


def _find_columns(head: _Line, pointer: str) -> tuple[dict[str, int], dict[str, float], Convention | None]:
    places: dict[str, int] = {}
    factors: dict[str, float] = {}
    implied: Convention | None = None
    for place, cell in enumerate(head.cells):
        column, factor, before = _parse_column_name(cell)
        if column is None:
            continue
        if column in places:
            raise _make_error(f"the column {column} occurs twice.", head.number, pointer)
        places[column], factors[column] = place, factor
        # Only the modified convention writes a and α with the index j - 1, only Khalil's has r and no a.
        if before and column in ("a", "alpha"):
            implied = "modified"
    if "r" in places and "a" not in places:
        implied = "khalil"
    return places, factors, implied


def _read_row(
    line: _Line, places: Mapping[str, int], factors: Mapping[str, float], length: str, offset: str, pointer: str
) -> PastedRow:
    """Return a row in the notation of Khalil and Kleinfinger, with α and d of its own line."""
    if len(line.cells) <= max(places.values()):
        raise _make_error(
            f"the row has {len(line.cells)} cells, but the columns need {max(places.values()) + 1}.",
            line.number,
            pointer,
        )

    def read(column: str, *, angle: bool) -> tuple[float, bool]:
        return _read_cell(line, line.cells[places[column]], column, pointer, factor=factors[column], angle=angle)

    alpha, _ = read("alpha", angle=True)
    a, _ = read(length, angle=False)
    theta, turns = read("theta", angle=True)
    r, slides = read(offset, angle=False)
    if turns and slides:
        raise _make_error(
            "theta and the offset along z are both variable; make only one of them the joint variable.",
            line.number,
            pointer,
        )
    row: PastedRow = {"alpha": alpha, "d": a, "theta": theta, "r": r, "sigma": int(slides)}
    named = next((cell for cell in line.cells if re.fullmatch(r"[A-Za-z]\w{2,}", cell) and cell not in _LABELS), None)
    return row if named is None or places.get("theta") == line.cells.index(named) else {"name": named, **row}


def _read_cell(line: _Line, cell: str, column: str, pointer: str, *, factor: float, angle: bool) -> tuple[float, bool]:
    """Return the constant of a cell in rad or m, and whether the cell has the joint variable in it."""
    # Cells that were pasted from a PDF or LaTeX have typographic minus signs, dollars and backslashes.
    text = cell.strip().strip("$").replace("−", "-").replace("\\", "").casefold()
    variable = _VARIABLE.search(text) if column in ("theta", "d", "r") else None
    if variable is not None:
        if variable[0].lstrip().startswith("-"):
            raise _make_error(
                f"{column} has -{variable[0].strip(' -')}: the joint variable must be positive; reverse the axis.",
                line.number,
                pointer,
            )
        text = (text[: variable.start()] + text[variable.end() :]).strip()
    if angle and ("°" in text or text.endswith("deg")):
        factor = _TO_SI["deg"]
    text = re.sub(r"\s+|°|deg$", "", text).lstrip("+") or "0"
    # The reader of numbers expects a sign between a factor and π: 2pi becomes 2*pi.
    text = re.sub(r"^(-?)(\d+(?:\.\d*)?)(pi|π)", r"\1\2*\3", text)
    try:
        value = expect_number(text, pointer, TITLE)
    except DynidentError as error:
        raise _make_error(
            f"{column} is '{cell}'; expected a number, pi/2, 90°, or q2 + pi/2.", line.number, pointer
        ) from error
    # No table has constants beyond a full turn: 90 without a unit means degrees, and guessing would hide the mistake.
    if factor == 1.0 and column in ("alpha", "theta") and abs(value) > 2.0 * math.pi + 1e-6:
        raise _make_error(
            f"{column} is {value:g}, more than one turn in rad: if it is in degrees, name the column {column}[deg].",
            line.number,
            pointer,
        )
    return factor * value, variable is not None


def _make_error(detail: str, line: int | None, pointer: str) -> DynidentError:
    place = f"line {line}: " if line else ""
    return DynidentError(f"{place}{detail[0].upper()}{detail[1:]}", pointer=pointer, title=TITLE)
