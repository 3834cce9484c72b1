"""Tables of a model: errors by joint and on a recording, parameters, shape constants, currents, drive gains."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import TYPE_CHECKING, Protocol

from dynident.effects import Effect, EffectChoice, get_effect
from dynident.estimation import Errors
from dynident.identification import Identification, IdentifiedParameter
from dynident.identification.identified_models.correlated_and_essential_parameters import EssentialPath
from dynident.identification.shape_constant_intervals import ShapeConstant
from dynident.number_format import NARROW_SPACE, format_estimate, format_number
from dynident.presentation.labels import (
    CONDITION_MEANING,
    PARAMETER_JUDGEMENTS,
    SHAPE_JUDGEMENTS,
    format_joints,
    format_shape_constants,
    format_shape_interval,
)
from dynident.presentation.tables import (
    Cell,
    ReportedTable,
    make_interval_cell,
    make_number_cell,
    make_percent_cell,
    make_text_cells,
)

if TYPE_CHECKING:
    # For type checkers alone: most commands compare nothing.
    from dynident.diagnosis import Comparison, Judgement, WorstInterval
    from dynident.identification import CurrentModel
    from dynident.robot import Robot


class ErrorNumbers(Protocol):
    """Errors as numbers: of each joint rms and relative error, None without rows, and the relative error of all."""

    @property
    def rms(self) -> Sequence[float | None]:
        """Root mean square of the residual of each joint, N m or N."""

    @property
    def relative(self) -> Sequence[float | None]:
        """Relative error of each joint, a fraction."""

    @property
    def relative_total(self) -> float | None:
        """Relative error of all joints together, a fraction."""


@dataclass(frozen=True)
class ErrorFigures:
    """`ErrorNumbers` of a model that is at hand; None for a joint without rows."""

    rms: tuple[float | None, ...]
    relative: tuple[float | None, ...]
    relative_total: float | None

    @classmethod
    def from_errors(cls, errors: Errors) -> ErrorFigures:
        """Return the figures of errors; a joint without rows has none, an error of zero would look perfect."""
        counts = errors.counts.tolist()
        rms, relative = (
            tuple(value if count else None for value, count in zip(values.tolist(), counts, strict=True))
            for values in (errors.rms, errors.relative)
        )
        return cls(rms, relative, errors.relative_total if any(counts) else None)


@dataclass(frozen=True)
class ErrorKind:
    """The errors on one set of data, with its name: "fit", "held out", or "" where there is only one."""

    name: str
    moving: ErrorNumbers
    all_rows: ErrorNumbers


def list_error_kinds(identification: Identification) -> list[ErrorKind]:
    """Return the errors of the fit and, where data were held out, those on them."""
    pairs = [("fit", identification.fit_moving, identification.fit)]
    if identification.held_out is not None and identification.held_out_moving is not None:
        pairs.append(("held out", identification.held_out_moving, identification.held_out))
    return [ErrorKind(name, *map(ErrorFigures.from_errors, both)) for name, *both in pairs]


RATIO = "held out over fit"
_ERROR_NOTES = (
    "Relative errors are ‖y − ŷ‖ / ‖y‖ of the filtered, decimated torque: where the joint moves, and on all rows. The "
    "rms is that of rows where it moves, without reversals and standstills. At standstill, only the distance to the "
    "range of static friction counts.",
    "The noise floor is an estimate of the residual that the noise of the torque alone causes: a ratio near 1, below "
    "or above, is noise alone.",
    "No held-out data was given: the errors of the fit are smaller than those on other data.",
)


def build_error_table(
    kinds: Sequence[ErrorKind], joints: Sequence[str], units: Sequence[str], floor: Sequence[float | None] | None = None
) -> ReportedTable:
    """Return the errors of a model by joint, and of all joints together.

    Parameters
    ----------
    kinds : sequence of ErrorKind
        Errors on each set of data.
    joints, units : sequence of str
        Names of the joints; the unit of each one's torque or force.
    floor : sequence of float, optional
        Noise floor of each joint in its unit, where it is known.
    """
    columns = ["joint"]
    rows = [[Cell(joint)] for joint in (*joints, "all joints")]
    for kind in kinds:
        columns += [", ".join(filter(None, (kind.name, words))) for words in ("rms moving", "moving", "all rows")]
        for j, unit in enumerate(units):
            rows[j] += _build_error_cells(kind, j, unit)
        totals = (kind.moving.relative_total, kind.all_rows.relative_total)
        rows[-1] += [Cell(""), *(make_percent_cell(total) for total in totals)]
    if len(kinds) > 1:
        columns.append(RATIO)
        fit, held_out = kinds[0].moving.relative, kinds[1].moving.relative
        rows = [
            [*row, Cell(format_ratio(b, a), is_figures=True)]
            for row, a, b in zip(rows, (*fit, None), (*held_out, None), strict=True)
        ]
    if floor is not None:
        columns += ["noise floor", f"{kinds[0].name} over floor".strip()]
        rms = kinds[0].moving.rms
        for j, unit in enumerate(units):
            rows[j] += [make_number_cell(floor[j], unit=unit), Cell(format_ratio(rms[j], floor[j]), is_figures=True)]
        rows[-1] += make_text_cells("", "")
    notes = (_ERROR_NOTES[0], *(_ERROR_NOTES[1:2] if floor is not None else ()))
    return ReportedTable(
        "Error per joint: where it moves, and on all rows",
        tuple(columns),
        tuple(map(tuple, rows)),
        notes=(*notes, *(_ERROR_NOTES[2:] if len(kinds) == 1 and kinds[0].name else ())),
        name="errors",
    )


def _build_error_cells(kind: ErrorKind, joint: int, unit: str) -> list[Cell]:
    """Return the cells of rms and relative error where a joint moves, and of its relative error on all rows."""
    everywhere = make_percent_cell(kind.all_rows.relative[joint])
    # A joint without torque has no error, and one that never moves has none while moving.
    if kind.moving.rms[joint] is None:
        return [Cell("no torque" if everywhere.value is None else "never"), Cell("–"), everywhere]
    return [
        make_number_cell(kind.moving.rms[joint], unit=unit),
        make_percent_cell(kind.moving.relative[joint]),
        everywhere,
    ]


def format_ratio(value: float | None, reference: float | None) -> str:
    """Return how many times a reference a value is; "–" where one of them is unknown or zero."""
    return "–" if value is None or not reference else f"{format_number(value / reference, 2)} ×"


def build_comparison_table(
    name: str,
    errors: ErrorKind,
    joints: Sequence[str],
    units: Sequence[str],
    floor: Sequence[float | None],
    effective_samples: Sequence[float | None],
    n_samples: int,
) -> ReportedTable:
    """Return the errors of a model on one recording, joint by joint, beside what noise alone would leave."""
    table = build_error_table([errors], joints, units, floor)
    samples = [*(Cell("–" if n is None else f"{n:.0f}", n) for n in effective_samples), Cell("")]
    return replace(
        table,
        title=f"Measured against predicted: {name}",
        columns=(*table.columns, f"independent samples, of {n_samples}"),
        rows=tuple((*row, cell) for row, cell in zip(table.rows, samples, strict=True)),
        name="comparison",
    )


def compare_by_joint(name: str, comparison: Comparison, judgement: Judgement) -> ReportedTable:
    """Return `build_comparison_table` of a recording that was compared with the prediction of a model.

    Parameters
    ----------
    name : str
        The recording.
    comparison : Comparison
        Measured and predicted torque.
    judgement : Judgement
        The residual against the noise.
    """
    moving, everywhere = map(ErrorFigures.from_errors, (comparison.moving_errors, comparison.errors))
    return build_comparison_table(
        name,
        ErrorKind("", moving, everywhere),
        comparison.joint_names,
        comparison.units,
        judgement.noise.values.tolist(),
        judgement.effective_samples.tolist(),
        len(comparison.t),
    )


def build_worst_table(intervals: Sequence[WorstInterval], joints: Sequence[str], units: Sequence[str]) -> ReportedTable:
    """Return the intervals of time in which the residual is largest, with the poses of the joints.

    Parameters
    ----------
    intervals : sequence of WorstInterval
        The worst first.
    joints, units : sequence of str
        Names of all joints; the unit of each one's torque or force.
    """
    rows = tuple(
        (
            *make_text_cells(interval.joint, _format_interval(interval)),
            make_number_cell(interval.rms, unit=units[joints.index(interval.joint)]),
            Cell(f"{format_number(interval.ratio, 2)} ×", interval.ratio),
            Cell(", ".join(format_number(value) for value in interval.pose), is_figures=True),
        )
        for interval in intervals
    )
    positions = " or ".join(dict.fromkeys("rad" if unit == "N m" else "m" for unit in units))
    columns = ("joint", "when", "rms", "relative to the joint's rms", f"pose ({positions})")
    return ReportedTable("Where it is worst", columns, rows, name="worst")


def describe_interval(interval: WorstInterval) -> str:
    """Return where the residual is large, and how large, in words."""
    ratio = format_number(interval.ratio, 2)
    return f"{interval.joint}, {_format_interval(interval)}: {ratio} times the rms of the joint"


def _format_interval(interval: WorstInterval) -> str:
    return f"{interval.start:.2f} to {interval.end:.2f} s"


def build_quality_table(
    fit: float | None,
    held_out: float | None,
    determined: Sequence[bool],
    condition_number: float | None,
    n_equations: int,
    equations_per_parameter: float,
) -> ReportedTable:
    """Return the main figures of a model, each with its meaning.

    Parameters
    ----------
    fit, held_out : float
        Relative errors by which models are judged; None without held-out data.
    determined : sequence of bool
        Whether the data determine each base parameter.
    condition_number : float
        Of W with columns of equal size.
    n_equations : int
        Number of equations.
    equations_per_parameter : float
        How many of them there are for each parameter.
    """
    moving = Cell("relative, where joints move")
    rows = (
        (Cell("held-out error"), make_percent_cell(held_out), Cell("no held-out data") if held_out is None else moving),
        (Cell("error of the fit"), make_percent_cell(fit), moving),
        (
            Cell("base parameters"),
            Cell(str(len(determined))),
            Cell(f"{sum(determined)} of them determined by the data"),
        ),
        (Cell("scaled condition number of W"), make_number_cell(condition_number), Cell(CONDITION_MEANING)),
        make_text_cells(
            "equations",
            f"{n_equations:,}".replace(",", NARROW_SPACE),
            f"{format_number(equations_per_parameter)} for each parameter",
        ),
    )
    return ReportedTable(
        "Quality of the model", ("figure", "value", "meaning"), tuple(map(tuple, rows)), 3, name="quality"
    )


GROUPING, TIMES_SMALLEST = "in standard parameters", "times smallest"


def build_parameter_table(title: str, parameters: Iterable[IdentifiedParameter]) -> ReportedTable:
    """Return a table of parameters, grouped by effect; parameters that are not essential are left out.

    Parameters
    ----------
    title : str
        Heading of the table.
    parameters : iterable of IdentifiedParameter
        Base parameters with their uncertainty.
    """
    essential = [parameter for parameter in parameters if parameter.essential]
    groups = {(parameter.effect, parameter.shape): "" for parameter in essential}
    for effect, shape in groups:
        constants = format_shape_constants(EffectChoice(effect, (), shape))
        # An effect may be in the model several times, with other shape constants each: both make its heading.
        groups[effect, shape] = ", ".join(filter(None, (get_effect(effect).title, constants)))
    # Groups are in the order of their first parameter, and so are the parameters within each.
    ordered = [parameter for group in groups for parameter in essential if (parameter.effect, parameter.shape) == group]
    return ReportedTable(
        title,
        (
            *("parameter", "joint", "value", "standard deviation", "95 % interval", "unit", "relative"),
            *(TIMES_SMALLEST, "determined", GROUPING),
        ),
        tuple(_build_parameter_row(parameter) for parameter in ordered),
        numbers_from=2,
        groups=tuple(groups[parameter.effect, parameter.shape] for parameter in ordered),
        name="parameters",
    )


def _build_parameter_row(parameter: IdentifiedParameter) -> tuple[Cell, ...]:
    value, deviation = format_estimate(parameter.value, parameter.standard_deviation)
    # A parameter that the data do not determine has an infinite interval, which is shown as "–".
    ends = [format_estimate(end, parameter.standard_deviation)[0] for end in parameter.interval if isfinite(end)]
    judgement = PARAMETER_JUDGEMENTS[parameter.judgement]
    return (
        *make_text_cells(parameter.name, parameter.link or "whole robot"),
        Cell(value, parameter.value),
        Cell(deviation, parameter.standard_deviation),
        Cell(" to ".join(ends) or "–", is_figures=True),
        Cell(parameter.unit),
        make_percent_cell(parameter.relative_standard_deviation, 2),
        Cell(format_number(parameter.times_smallest, 2), is_figures=True),
        Cell(judgement.words, mark=judgement.mark),
        Cell(parameter.grouping),
    )


def build_shape_table(constants: Sequence[ShapeConstant], joints: Sequence[str]) -> ReportedTable:
    """Return a table of shape constants.

    Parameters
    ----------
    constants : sequence of ShapeConstant
        Shape constants with their uncertainty.
    joints : sequence of str
        Names of all joints of the robot.
    """
    columns = ("effect", "joint", "constant", "value", "standard deviation", "95 % interval", "unit", "determined")
    rows = tuple(_build_constant_row(constant, joints) for constant in constants)
    title = "Shape constants: nonlinear constants of the effects, found by search"
    return ReportedTable(title, columns, rows, numbers_from=3, name="shapes")


def _build_constant_row(constant: ShapeConstant, joints: Sequence[str]) -> tuple[Cell, ...]:
    value, deviation = constant.word or format_number(constant.value, 4), "–"
    if constant.interval is not None:
        value, deviation = format_estimate(constant.value, constant.standard_deviation)
    judgement = SHAPE_JUDGEMENTS[constant.judgement]
    return (
        *make_text_cells(get_effect(constant.effect).title, format_joints(constant.joints, joints)),
        Cell(constant.name, note=constant.description),
        Cell(value, constant.value),
        Cell(deviation, constant.standard_deviation if constant.interval is not None else None),
        Cell(format_shape_interval(constant), is_figures=True),
        Cell("–" if constant.unit == "-" else constant.unit),
        Cell(judgement.words, mark=judgement.mark, note=constant.note),
    )


def build_essential_tables(path: EssentialPath) -> Iterator[ReportedTable]:
    """Yield the steps of a backward elimination and the remaining parameters as tables."""
    rows = tuple(
        (
            Cell(step.name),
            make_percent_cell(step.relative_deviation, 2),
            make_number_cell(step.p_value, 2),
            make_percent_cell(step.fit.relative_total),
            make_percent_cell(None if step.held_out is None else step.held_out.relative_total),
        )
        for step in path.steps
    )
    if rows:
        yield ReportedTable("Backward elimination", ("removed", "relative deviation", "p", "fit", "held out"), rows)
    yield build_parameter_table("Essential parameters", path.identification.parameters)


def build_catalogue_table(effects: Iterable[Effect]) -> ReportedTable:
    """Return the table of effects that a model can contain: what they are, their parameters, how they show."""
    heads = ("effect", "what it is", "parameters", "what it leaves in the residual")
    rows = []
    for effect in effects:
        parameters = (f"{item.name} ({item.unit})" if item.unit != "-" else item.name for item in effect.parameters)
        rows.append(tuple(make_text_cells(effect.id, effect.title, ", ".join(parameters), effect.signature)))
    return ReportedTable("", heads, tuple(rows), numbers_from=len(heads))


def build_current_tables(models: Sequence[CurrentModel]) -> Iterator[ReportedTable]:
    """Yield the errors of models of currents, one a joint, and the parameters of each."""
    rows = []
    for model in models:
        errors: list[Cell] = []
        for fit in (model.fit, model.held_out):
            errors.append(make_number_cell(None if fit is None else fit.rms_total, 3))
            errors.append(make_percent_cell(None if fit is None else fit.relative_total))
        rows.append((Cell(model.joint), Cell(str(len(model.parameters))), *errors))
    heads = ("joint", "parameters", "residual, A", "of the current", "held out, A", "of the current")
    yield ReportedTable("The current of every joint", heads, tuple(rows))
    for model in models:
        parameters = tuple(
            tuple(
                make_text_cells(
                    parameter.name,
                    *format_estimate(parameter.value, 0.5 * (parameter.interval[1] - parameter.interval[0])),
                    parameter.unit,
                    PARAMETER_JUDGEMENTS[parameter.judgement].words,
                )
            )
            for parameter in model.parameters
        )
        yield ReportedTable(model.joint, ("parameter", "value", "± 95 %", "unit", "judgement"), parameters)


Interval = tuple[float | None, float | None]
GainFigures = tuple[str, float, float, Interval, str, bool]
LoadFigures = tuple[str, float, Interval, float | None, bool]


def build_gain_tables(gains: Iterable[GainFigures], loads: Iterable[LoadFigures]) -> Iterator[ReportedTable]:
    """Yield the table of drive gains, and that of loads that were weighed with them.

    Of a gain: joint, stated gain, identified gain, its 95 % interval, unit, whether the data determine it. Of a load:
    recording, mass in kg, its interval, the part of its deviation that the gains cause, whether it differs from zero.
    """
    rows = tuple(
        (
            Cell(joint),
            make_number_cell(stated, 4),
            *_make_estimate_cells(value, interval),
            Cell("factor" if unit == "-" else unit),
            Cell("✓ yes", mark="ok") if identifiable else Cell("✕ no", mark="error"),
        )
        for joint, stated, value, interval, unit, identifiable in gains
    )
    yield ReportedTable("Drive gains", ("joint", "stated", "identified", "± 95 %", "unit", "identifiable"), rows)
    load_rows = tuple(
        (
            Cell(name),
            *_make_estimate_cells(mass, interval),
            make_interval_cell(interval),
            make_number_cell(from_gains, 2),
            Cell("yes" if identifiable else "no"),
        )
        for name, mass, interval, from_gains, identifiable in loads
    )
    if load_rows:
        columns = ("measurement", "mass", "± 95 %", "95 % interval", "σ from the gains", "not zero")
        yield ReportedTable("Loads weighed with these gains, kg", columns, load_rows)


def _make_estimate_cells(value: float, ends: Interval) -> tuple[Cell, Cell]:
    """Return the cells of a value and of half its interval; the interval decides the digits."""
    low, high = ends
    # An end that is null is infinite: then there is no half to show.
    half = None if low is None or high is None else (high - low) / 2.0
    texts = format_estimate(value, inf if half is None else half)
    return Cell(texts[0], value), Cell(texts[1], half)


def get_gain_unit(robot: Robot, index: int, from_commands: bool = False) -> str:
    """Return the unit of a joint's drive gain, or of its servo's, whose torque is made of commands; - for a factor."""
    # Without a stated gain the recorded torque is multiplied by a factor, which has no unit.
    if robot.drives[index].gain is None:
        return "-"
    if robot.joints[index].kind == "revolute":
        return "N m/rad" if from_commands else "N m/A"
    return "N/m" if from_commands else "N/A"
