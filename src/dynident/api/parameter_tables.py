"""Tables and data frames of identified parameters, and of errors by joint; how many rows are shown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from textwrap import wrap

import numpy as np

from dynident.api.argument_checks import CheckedResult, require
from dynident.api.motion_arguments import check_level
from dynident.api.named_tables import Framed, FTest, Items, PlainText, Table, describe_missing
from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.identification import Identification, IdentifiedParameter
from dynident.identification.identified_models.correlated_and_essential_parameters import compute_test_of_values
from dynident.number_format import format_count, format_number, format_percent
from dynident.presentation.labels import describe_condition_number, describe_estimator
from dynident.presentation.model_tables import (
    GROUPING,
    RATIO,
    TIMES_SMALLEST,
    ErrorFigures,
    ErrorKind,
    build_error_table,
    build_parameter_table,
)
from dynident.presentation.tables import Cell, ReportedTable
from dynident.text_and_html_tables import join_html, render_paragraph

_SHOWN = 30
_TOO_WIDE = (GROUPING, TIMES_SMALLEST, "relative")
"""Columns of parameters that notebooks and frames have, and plain text has not."""
_LONGEST_JOINT, _WIDTH = 16, 100


@dataclass(frozen=True, eq=False)
class Parameters(Items[IdentifiedParameter], Framed):
    """Base parameters in the order of the model; by number, by slice, or by name: `model.parameters["Fc2"]`.

    `to_frame` has a row for each: name, joint, effect, value, unit, standard_deviation, relative_standard_deviation (a
    fraction), interval_low and interval_high (95 %), judgement, essential, grouping (its standard parameters).

    Parameters
    ----------
    items : tuple of IdentifiedParameter
        The parameters, in the order of the model.
    """

    items: tuple[IdentifiedParameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in their order."""
        return tuple(item.name for item in self.items)

    def _columns(self) -> Table:
        items = self.items
        return Table(
            {
                "name": [item.name for item in items],
                "joint": [item.link for item in items],
                "effect": [item.effect for item in items],
                "value": [item.value for item in items],
                "unit": [item.unit for item in items],
                "standard_deviation": [item.standard_deviation for item in items],
                "relative_standard_deviation": [item.relative_standard_deviation for item in items],
                "interval_low": [item.interval[0] for item in items],
                "interval_high": [item.interval[1] for item in items],
                "judgement": [item.judgement for item in items],
                "essential": [item.essential for item in items],
                "grouping": [item.grouping for item in items],
            }
        )

    def _describe_missing(self, name: str) -> str:
        groupings = {item.name: item.grouping for item in self.items}
        return describe_missing("parameter", name, groupings, groupings)

    def __contains__(self, item: object) -> bool:
        return any(item == (parameter.name if isinstance(item, str) else parameter) for parameter in self.items)

    def __repr__(self) -> str:
        title = f"Parameters({len(self.items)}; .to_frame() gives all)"
        return self._table().drop_columns(*_TOO_WIDE).to_text(title, most=_SHOWN)

    def _repr_html_(self) -> str:
        title = format_count(len(self.items), "base parameter")
        return join_html(render_paragraph(title, strong=True), self._table().to_html())

    def _table(self) -> ReportedTable:
        return build_parameter_table("Parameters", self.items)


@dataclass(frozen=True)
class JointError(CheckedResult):
    """The errors of a model on one joint's filtered torque.

    None stands where there is no such data, or the joint never moves in it.

    Parameters
    ----------
    joint : str
        Name of the joint.
    unit : str
        Unit of its torque: N m, or N where it slides.
    fit : float
        Relative error (fraction) on all rows of the data of the fit.
    fit_moving : float or None
        The same on rows where the joint moves.
    fit_moving_rms : float or None
        Root mean square error in `unit` on rows of the fit where the joint moves.
    held_out : float or None
        Relative error (fraction) on all rows of held-out data.
    held_out_moving : float or None
        The same on rows where the joint moves.
    held_out_moving_rms : float or None
        Root mean square error in `unit` on held-out rows where the joint moves.
    """

    joint: str
    unit: str
    fit: float
    fit_moving: float | None
    fit_moving_rms: float | None
    held_out: float | None
    held_out_moving: float | None
    held_out_moving_rms: float | None


@dataclass(frozen=True, eq=False)
class ErrorTable(Items[JointError], Framed):
    """The errors of a model, one entry for each joint in the robot's order.

    `to_frame` has a row for each joint, with the fields of `JointError`.

    Parameters
    ----------
    items : tuple of JointError
        One entry a joint, in the robot's order.
    """

    items: tuple[JointError, ...]

    @classmethod
    def from_identification(cls, identification: Identification) -> ErrorTable:
        """Return the errors of an identified model.

        Parameters
        ----------
        identification : Identification
            The identified model.

        Returns
        -------
        ErrorTable
            Its errors in the fit and on held-out data.
        """
        found = identification
        return cls(
            tuple(
                JointError(
                    joint.name,
                    joint.effort_unit,
                    float(found.fit.relative[j]),
                    *_get_moving_error(found.fit_moving, j),
                    None if found.held_out is None else float(found.held_out.relative[j]),
                    *_get_moving_error(found.held_out_moving, j),
                )
                for j, joint in enumerate(found.model.robot.joints)
            )
        )

    def _list_names(self) -> list[str]:
        return [item.joint for item in self.items]

    def _columns(self) -> Table:
        names = tuple(JointError.__dataclass_fields__)
        return Table({name: [getattr(joint_error, name) for joint_error in self.items] for name in names})

    def __repr__(self) -> str:
        return self._table().to_text(f"ErrorTable({len(self.items)} joints)", most=_SHOWN)

    def _repr_html_(self) -> str:
        return self._table().to_html()

    def _table(self) -> ReportedTable:
        items = self.items
        fit = [(item.fit_moving_rms, item.fit_moving, item.fit) for item in items]
        held_out = [(item.held_out_moving_rms, item.held_out_moving, item.held_out) for item in items]
        kinds = [_join_errors("fit", fit)]
        kinds += [] if all(errors[-1] is None for errors in held_out) else [_join_errors("held out", held_out)]
        table = build_error_table(kinds, [item.joint for item in items], [item.unit for item in items])
        # These may be some of the joints: their total is that of no model.
        return replace(table.drop_columns(RATIO), rows=table.drop_columns(RATIO).rows[:-1])


def _join_errors(name: str, joints: Sequence[tuple[float | None, float | None, float | None]]) -> ErrorKind:
    """Return the rms, the moving and the overall relative error of each joint as one kind of errors."""
    rms, moving, everywhere = zip(*joints, strict=True) if joints else ((), (), ())
    return ErrorKind(name, ErrorFigures(rms, moving, None), ErrorFigures((), everywhere, None))


def _get_moving_error(errors: Errors | None, joint: int) -> tuple[float | None, float | None]:
    """Return relative error and rms of one joint where it moves; None for both where it never does."""
    # Without rows the ratio would be 0 / 0, and an error of zero would look like a perfect joint.
    if errors is None or not errors.counts[joint]:
        return None, None
    return float(errors.relative[joint]), float(errors.rms[joint])


def format_summary(identification: Identification) -> str:
    """Return quality, errors joint by joint and parameters of a model as plain text.

    Parameters
    ----------
    identification : Identification
        The identified model.

    Returns
    -------
    str
        Lines of at most 100 characters.
    """
    data, choices, errors = identification.data, identification.choices, identification.held_out_judged
    parameters = identification.parameters
    n_determined = sum(parameter.well_identified for parameter in parameters)
    n_held = sum(parameter.judgement == "held" for parameter in parameters)
    held_out = "no held-out data" if errors is None else f"{format_percent(errors.relative_total)} held out"
    facts = [
        ("identified from", ", ".join(data.measurement_names)),
        ("held out", ", ".join(data.validation_names) or "nothing"),
        ("equation type, estimator", f"{choices.model}, {describe_estimator(identification)}"),
        (
            "error where joints move",
            f"{format_percent(identification.fit_judged.relative_total)} in the fit, {held_out}",
        ),
        (
            "determined parameters",
            f"{n_determined} of {format_count(len(parameters), 'base parameter')}"
            + (f", {n_held} held" if n_held else ""),
        ),
        ("condition number of W", f"{format_number(identification.condition_number)} (SI units, as that of a design)"),
        ("scaled condition number", describe_condition_number(identification)),
        ("equations per parameter", f"{identification.equations_per_parameter:.0f}"),
    ]
    width = max(len(name) for name, _ in facts)
    indent = " " * (width + 4)
    lines = [
        line
        for name, value in facts
        for line in wrap(value, _WIDTH, initial_indent=f"  {name:<{width}}  ", subsequent_indent=indent)
    ]
    errors_table = ErrorTable.from_identification(identification)._table()
    parameter_table = build_parameter_table("Parameters", parameters).drop_columns(*_TOO_WIDE)
    tables = (_shorten_column(errors_table, 0), _shorten_column(parameter_table, 1))
    return "\n".join(
        [
            f"Model of {identification.model.robot.name}",
            *lines,
            *(
                line
                for name, table in zip(("Errors", "Parameters"), tables, strict=True)
                for line in ("", table.to_text(name))
            ),
            *(["", "Warnings"] if identification.warnings else []),
            *(
                line
                for warning in identification.warnings
                for line in wrap(warning, _WIDTH, initial_indent="  - ", subsequent_indent="    ")
            ),
        ]
    )


def _shorten_column(table: ReportedTable, column: int) -> ReportedTable:
    """Return a table in which the names of joints are cut to what leaves room for the other columns."""
    rows = ((*row[:column], Cell(_shorten(row[column].text)), *row[column + 1 :]) for row in table.rows)
    return replace(table, rows=tuple(rows))


def _shorten(text: str) -> str:
    return text if len(text) <= _LONGEST_JOINT else f"{text[: _LONGEST_JOINT - 1]}…"


_SINGULAR = 1e-9
"""Eigenvalue of a correlation matrix that is rounding."""


@dataclass(frozen=True, eq=False)
class ParameterStatistics(CheckedResult):
    """Base parameters of an identified model with their uncertainty, by name.

    Parameters
    ----------
    identification : Identification
        The model as the library gives it.
    """

    identification: Identification

    @property
    def params(self) -> Table:
        """Values of the base parameters by name, in SI units; `parameters` has units and judgements beside them.

        As a series of pandas: `model.params.to_frame()["value"]`.

        Examples
        --------
        >>> model.params["Fc1"]  # doctest: +SKIP
        3.02
        """
        return self._label({"value": self.identification.values}, "Base parameters")

    @property
    def bse(self) -> Table:
        """Standard deviations of the base parameters by name: `model.bse["Fc1"]`."""
        deviations = self.identification.statistics.standard_deviations
        return self._label({"standard_deviation": deviations}, "Standard deviations of the base parameters")

    @property
    def covariance(self) -> Table:
        """Covariance of the base parameters by name: `model.covariance["Fc1", "Fv1"]`.

        It takes correlated residuals into account, as chosen (`IdentificationChoices.covariance`). By blocks of time
        (the default) it is estimated from how the parameters move as each block is left out, and its rank is below the
        number of blocks: of a short recording it is singular, and so is every such estimate with fewer blocks than
        parameters. Single deviations and intervals are right; do not invert it. `wald_test` tests several parameters
        together with the degrees of freedom that there are; `IdentificationChoices(covariance="by_joint")` gives a
        matrix of full rank.
        """
        matrix, names = self.identification.statistics.covariance, self._names
        columns = {name: matrix[:, k] for k, name in enumerate(names)}
        title = "Covariance of the base parameters, SI units"
        moving = matrix[np.ix_(*[np.diag(matrix) > 0] * 2)]
        deviations = np.sqrt(np.diag(moving))
        rank = int(np.linalg.matrix_rank(moving / np.outer(deviations, deviations), hermitian=True, tol=_SINGULAR))
        if rank < len(moving):
            title += f"; singular: of rank {rank} of {len(moving)}, from blocks of time"
        return Table(columns, labels=names, label_name="parameter", title=title, groupings=self._groupings)

    @property
    def correlation(self) -> Table:
        """Correlation of the base parameters by name, −1 to 1: `model.correlation["Fc1", "Fv1"]`."""
        names, matrix, scale = self._names, self.identification.statistics.covariance, self._deviations
        columns = {name: matrix[:, k] / (scale * scale[k]) for k, name in enumerate(names)}
        return Table(columns, labels=names, label_name="parameter", title="Correlation of the base parameters")

    @property
    def tvalues(self) -> Table:
        """Base parameters divided by their standard deviations, by name: `model.tvalues["Fc1"]`."""
        ratios, title = self.identification.values / self._deviations, "Parameters over their standard deviations"
        return Table({"t": ratios}, labels=self._names, label_name="parameter", title=title)

    def conf_int(self, level: float = 0.95) -> Table:
        """Return the intervals that hold the true values of the parameters, by Student's t.

        Parameters
        ----------
        level : float
            Probability of each interval.

        Returns
        -------
        Table
            Columns lower and upper, a row for each parameter.

        Examples
        --------
        >>> low, high = model.conf_int(0.99)["Fc1"]  # doctest: +SKIP
        """
        half = self.identification.statistics.half_widths(check_level(level, "level"))
        values = self.identification.values
        return self._label({"lower": values - half, "upper": values + half}, f"Intervals of {level:.4g} probability")

    @property
    def condition_number(self) -> float:
        """Condition number of W, [12.12], of the parameters in their SI units, as that of a design."""
        return self.identification.condition_number

    @property
    def scaled_condition_number(self) -> float:
        """Condition number of W with columns of equal size, which does not depend on units; a warning goes by it."""
        return self.identification.equilibrated_condition_number

    @property
    def summary(self) -> PlainText:
        """Quality and parameters of the model as a text of at most 100 columns: `model.summary()`.

        A console and a notebook show it as it is printed; it may be called or not.

        Examples
        --------
        >>> print(model.summary())  # doctest: +SKIP
        """
        return PlainText(format_summary(self.identification))

    def wald_test(self, values: Mapping[str, float | str]) -> FTest:
        """Test whether parameters have given values, or are equal to others, all at once.

        It takes the estimates and their covariance as they are. A covariance by blocks of time (the default) is itself
        estimated from as many samples as there are blocks: the test is then Hotelling's T², with as many degrees of
        freedom as blocks leave, and it needs more blocks than parameters that are tested. A single value is tested as
        its interval is (`conf_int`). The test holds for a model that lacks nothing: a missing effect moves estimates,
        too.

        Parameters
        ----------
        values : mapping of str to float or str
            By name of a base parameter, its value in SI units, or the name of another one that it is equal to.

        Returns
        -------
        FTest
            `f_value`, `p_value` and `df_diff`, and `df_resid`.

        Raises
        ------
        DynidentError
            For a name that is no estimated parameter, or more parameters than the recordings have blocks of time.

        Examples
        --------
        >>> model.wald_test({"Fc1": 3.0, "Fv1": 2.0}).p_value  # doctest: +SKIP
        >>> model.wald_test({"Fc1": "Fc3"}).p_value  # doctest: +SKIP
        """
        known = bool(isinstance(values, Mapping) and values and all(_is_condition(*item) for item in values.items()))
        remedy = 'give values by the names of parameters, {"Fc1": 3.0}, or what they are equal to, {"Fc1": "Fc3"}'
        require(known, values, "values", remedy)
        for name in (*values, *(value for value in values.values() if isinstance(value, str))):
            if name not in self._names:
                raise DynidentError(describe_missing("parameter", name, self._names, self._groupings), pointer="values")
        return FTest.from_test(compute_test_of_values(self.identification, values))

    @property
    def _deviations(self) -> FloatArray:
        """Standard deviations (b,), NaN of a parameter that was set."""
        deviations = self.identification.statistics.standard_deviations
        return np.where(deviations > 0, deviations, np.nan)

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(column.name for column in self.identification.model.kept)

    @property
    def _groupings(self) -> dict[str, str]:
        return {parameter.name: parameter.grouping for parameter in self.identification.parameters}

    def _label(self, columns: dict[str, FloatArray], title: str) -> Table:
        units = {column.name: column.unit for column in self.identification.model.kept}
        return Table(columns, units, self._names, "parameter", title, self._groupings)


def _is_condition(name: str, value: object) -> bool:
    return value != name if isinstance(value, str) else _is_finite(value)


def _is_finite(number: object) -> bool:
    return isinstance(number, Real) and not isinstance(number, bool) and math.isfinite(number)
