"""Identified parameters, and errors joint by joint, as tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

from dynident.desk.frames import Columns, Framed
from dynident.desk.texts import text_table
from dynident.estimation import Errors
from dynident.html import block, paragraph, table
from dynident.identification import Identification, IdentifiedParameter
from dynident.reports.numbers import estimate, number, percent
from dynident.reports.words import JUDGED

_SHOWN = 30
_LONGEST = 40


@dataclass(frozen=True, eq=False)
class Parameters(Sequence[IdentifiedParameter], Framed):
    """Base parameters in the order of the model; by number, by slice, or by name: `model.parameters["Fc2"]`.

    `to_frame` has a row each: name, joint, effect, value, unit, standard_deviation, relative_standard_deviation (a
    fraction), interval_low and interval_high (95 %), judgement, essential, grouping (its standard parameters).
    """

    items: tuple[IdentifiedParameter, ...]

    def _columns(self) -> Columns:
        items = self.items
        return Columns(
            {
                "name": [one.name for one in items],
                "joint": [one.link for one in items],
                "effect": [one.effect for one in items],
                "value": [one.value for one in items],
                "unit": [one.unit for one in items],
                "standard_deviation": [one.standard_deviation for one in items],
                "relative_standard_deviation": [one.relative_standard_deviation for one in items],
                "interval_low": [one.interval[0] for one in items],
                "interval_high": [one.interval[1] for one in items],
                "judgement": [one.judgement for one in items],
                "essential": [one.essential for one in items],
                "grouping": [one.grouping for one in items],
            }
        )

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[IdentifiedParameter]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int | str) -> IdentifiedParameter: ...
    @overload
    def __getitem__(self, index: slice) -> Parameters: ...
    def __getitem__(self, index: int | str | slice) -> IdentifiedParameter | Parameters:
        if isinstance(index, slice):
            return Parameters(self.items[index])
        if isinstance(index, str):
            found = next((one for one in self.items if one.name == index), None)
            if found is None:
                raise KeyError(
                    f"there is no parameter {index!r}; there are: {', '.join(one.name for one in self.items)}"
                )
            return found
        return self.items[index]

    def __contains__(self, item: object) -> bool:
        return any(item == (one.name if isinstance(item, str) else one) for one in self.items)

    def __repr__(self) -> str:
        title = f"Parameters({len(self.items)}; .to_frame() gives all)"
        return text_table(title, _COLUMNS, [_row(one) for one in self.items[:_SHOWN]], len(self.items), right_from=2)

    def _repr_html_(self) -> str:
        columns = (*_COLUMNS, "standard parameters")
        rows = [(*_row(one), _shortened(one.grouping)) for one in self.items]
        return block(paragraph(f"{len(self.items)} base parameters", strong=True), table(columns, rows, right_from=2))


@dataclass(frozen=True)
class JointError:
    """How well a model predicts one joint's filtered torque.

    `fit` and `held_out` are relative errors (fractions) on all rows of the data it was identified from, and of those
    that no parameter saw; `fit_moving` and `held_out_moving` the same where the joint moves; `fit_rms` and
    `held_out_rms` in `unit`, where it moves. None where there is no such data, or the joint never moves in it.
    """

    joint: str
    unit: str
    fit: float
    fit_moving: float | None
    fit_rms: float | None
    held_out: float | None
    held_out_moving: float | None
    held_out_rms: float | None


@dataclass(frozen=True, eq=False)
class ErrorTable(Sequence[JointError], Framed):
    """The errors of a model, one entry a joint in the robot's order.

    `to_frame` has a row a joint, with the fields of `JointError`.
    """

    items: tuple[JointError, ...]

    @classmethod
    def of(cls, identification: Identification) -> ErrorTable:
        """The errors of an identified model."""
        found = identification
        return cls(
            tuple(
                JointError(
                    joint.name,
                    joint.effort_unit,
                    float(found.fit.relative[j]),
                    *_moving(found.fit_moving, j),
                    None if found.held_out is None else float(found.held_out.relative[j]),
                    *_moving(found.held_out_moving, j),
                )
                for j, joint in enumerate(found.model.robot.joints)
            )
        )

    def _columns(self) -> Columns:
        names = tuple(JointError.__dataclass_fields__)
        return Columns({name: [getattr(one, name) for one in self.items] for name in names})

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[JointError]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int) -> JointError: ...
    @overload
    def __getitem__(self, index: slice) -> ErrorTable: ...
    def __getitem__(self, index: int | slice) -> JointError | ErrorTable:
        return ErrorTable(self.items[index]) if isinstance(index, slice) else self.items[index]

    def __repr__(self) -> str:
        rows = [_error_row(one) for one in self.items[:_SHOWN]]
        return text_table(f"ErrorTable({len(self.items)} joints)", _ERROR_COLUMNS, rows, len(self.items))

    def _repr_html_(self) -> str:
        return table(_ERROR_COLUMNS, [_error_row(one) for one in self.items])


_COLUMNS = ("parameter", "joint", "value", "deviation", "95 % interval", "unit", "determined")
_ERROR_COLUMNS = ("joint", "fit, moving", "rms", "all rows", "held out, moving", "rms", "all rows")


def _row(one: IdentifiedParameter) -> tuple[str, ...]:
    value, deviation = estimate(one.value, one.standard_deviation)
    interval = " to ".join(estimate(end, one.standard_deviation)[0] for end in one.interval)
    judged = JUDGED[one.judgement].words if one.essential else "not essential"
    return one.name, one.link, value, deviation, interval, one.unit, judged


def _error_row(one: JointError) -> tuple[str, ...]:
    def rms(value: float | None) -> str:
        return "–" if value is None else f"{number(value)} {one.unit}"

    return (
        one.joint,
        percent(one.fit_moving),
        rms(one.fit_rms),
        percent(one.fit),
        percent(one.held_out_moving),
        rms(one.held_out_rms),
        percent(one.held_out),
    )


def _moving(errors: Errors | None, joint: int) -> tuple[float | None, float | None]:
    """Relative error and rms of one joint where it moves."""
    if errors is None or not errors.counts[joint]:
        return None, None
    return float(errors.relative[joint]), float(errors.rms[joint])


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
