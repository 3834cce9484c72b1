"""Build the equations of the filtered, energy, power and base-wrench models from recordings, and their constants.

Holds how the pole of F(s) and the intervals are chosen; their rows are computed in regressors/.

Parameters that are in the equations of the base's wrench but of no interest are removed (marginalised).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import EstimationError
from dynident.estimation.least_squares import build_weighted_factor, compute_noise_levels
from dynident.estimation.qr_decomposition import compute_r_factor
from dynident.estimation.triangular_factors import EquationFactors, Reduction
from dynident.identification.estimation_problem_options import RowOptions
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording, find_motion_band
from dynident.recordings.recording import WRENCH_NAMES
from dynident.regressors.equation_forms import EquationForm, build_filtered_form, build_power_form, build_wrench_model
from dynident.regressors.filtered_energy_power_rows import (
    SHARE_OF_PERIOD,
    Treatment,
    filter_with_pole,
    integrate_over_intervals,
    reduce_form,
    stream_equations,
)
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import RegressorInputs

# Rounds that estimate the noise of every equation; on sound data the third changes no visible digit.
_NOISE_ROUNDS = 3
# Directions with a smaller singular value, in columns of unit length, count as not excited.
_FLAT = 1e-11


def marginalise_parameters(reduction: Reduction, n_nuisance: int, *, weighted: bool = True) -> Reduction:
    """Remove the first `n_nuisance` parameters from the equations by projection.

    Every column, and Y, is replaced by its residual of a regression on the nuisance columns; least squares on the rest
    then gives the same estimates and the same residuals as on the whole (Frisch and Waugh 1933, Lovell 1963).

    Parameters
    ----------
    reduction : Reduction
        With c columns, the nuisance ones first.
    n_nuisance : int
        Number of leading columns to remove.
    weighted : bool
        Weight every equation by the noise of its own residual, as weighted least squares does.

    Returns
    -------
    Reduction
        The equations in the other c - n_nuisance parameters.
    """
    c = reduction.n_columns
    noise = np.ones(len(reduction.equations))
    for _ in range(_NOISE_ROUNDS if weighted else 0):
        factor = build_weighted_factor(reduction, noise)
        noise = compute_noise_levels(reduction, _regress(factor[:, :c], factor[:, c:])[:, 0])
    factor = build_weighted_factor(reduction, noise)
    # The regression runs over all equations at once, because a nuisance parameter has one value in all of them.
    explained = _regress(factor[:, :n_nuisance], factor[:, n_nuisance:])
    change = np.vstack([-explained, np.eye(c + 1 - n_nuisance)])
    columns = np.arange(c - n_nuisance)
    equations = []
    for equation in reduction.equations:
        selected = change[np.append(equation.columns, c)]
        equations.append(EquationFactors(columns, compute_r_factor(equation.factors @ selected), equation.counts))
    return Reduction(c - n_nuisance, tuple(equations), reduction.spans)


def _regress(w: FloatArray, y: FloatArray) -> FloatArray:
    """Return the coefficients (p, q) of y (r, q) regressed on w (r, p); zero along directions without excitation."""
    scales = np.linalg.norm(w, axis=0)
    scales = np.where(scales > 0, scales, 1.0)
    return np.asarray(np.linalg.lstsq(w / scales, y, rcond=_FLAT)[0] / scales[:, None])


def build_wrench_equations(
    model: Model,
    rows: RowOptions,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    progress: Progress = ignore_progress,
) -> Reduction:
    """Reduce recordings to six equations in the model's base parameters.

    Parameters that only the wrench shows are fitted to whatever the others are, and eliminated.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    rows : RowOptions
        The equation type and its constants.
    recordings : sequence of Recording
        With the columns of the wrench.
    preprocessing : Preprocessing
        Filters of the recordings.
    progress : Progress
        Called with the fraction done and a message.

    Raises
    ------
    DynidentError
        For an effect that does not show in the base's wrench, a recording without one, or a base parameter that the
        wrench does not determine.
    """
    if model.robot.base != "fixed":
        raise DynidentError(
            f"{model.robot.name} has a {model.robot.base} base, whose own equations are those of a base wrench: choose "
            "the dynamic model",
            pointer="/model",
            title="Not for a base that moves",
        )
    check_wrench_effects(model)
    check_wrenches(recordings)
    wrench = build_wrench_model(model, tolerance=rows.tolerance)
    # The wrench holds only what the base feels; a parameter that it does not show would be any number.
    if wrench.unseen:
        raise EstimationError(
            f"the base wrench does not determine {', '.join(wrench.unseen)} of this robot; choose another model",
            pointer="/model",
            title="Not identifiable with this model",
        )
    # The columns of the links need no predicted load, so any reference parameters will do.
    nothing = ReferenceParameters.massless(model.robot)
    reduction = reduce_form(
        wrench.form, stream_equations, RegressorInputs(recordings, preprocessing, nothing), progress
    )
    # Nothing to eliminate from: the caller raises the error of no rows.
    if reduction.n_rows == 0:
        return reduction.combine_columns(wrench.coordinates[:, wrench.n_extra :])
    # Columns that only the wrench shows come first; they are eliminated so that the rest is in the model's
    # parameters.
    return marginalise_parameters(reduction.combine_columns(wrench.coordinates), wrench.n_extra, weighted=rows.weighted)


def check_wrench_effects(model: Model) -> None:
    """Raise where an effect does not show in the base's wrench."""
    silent_ones = {column.effect for column in model.columns if column.wrench is None}
    for index, choice in enumerate(model.effects):
        if choice.effect in silent_ones:
            raise DynidentError(
                f"{', '.join(sorted(silent_ones))}: not in the base wrench, which contains only the weight and the "
                "motion of the links; torques between two links, such as friction, a motor or a spring, cancel in it. "
                "Choose the effect rigid_body, and payload if some runs carry one, or another model",
                pointer=f"/effects/{index}",
                title="Effects that the base wrench does not show",
            )


def check_wrenches(recordings: Sequence[Recording]) -> None:
    """Raise where a recording has no wrench of the base."""
    for index, recording in enumerate(recordings):
        if not recording.has_wrench:
            raise DynidentError(
                f"{recording.name} has no wrench of the base: record the columns {', '.join(WRENCH_NAMES)} (force and "
                "moment of the base on the robot, along the base frame's axes, about its origin), or choose another "
                "model",
                pointer=f"/recordings/{index}",
                title="Wrench of the base needed",
            )


_SMALLEST_POLE = 10.0
"""rad/s: the smallest a of F(s) that is recommended."""

_SETTLING_TIMES = 4.7
"""Times 1 / a after which F(s) keeps a twentieth of a sample: (1 + 4.7) exp(-4.7)."""

_HARMONICS = 15.0
"""Times the band of the motion that F(s) passes where no cut-off of the torque is chosen."""


def find_constants(
    rows: RowOptions, recordings: Sequence[Recording], preprocessing: Preprocessing
) -> tuple[RowOptions, Preprocessing]:
    """Return the rows with the constants that their model needs, and the filters with the reasons for these constants.

    Parameters
    ----------
    rows : RowOptions
        The equation type and its constants.
    recordings : sequence of Recording
        Recordings of the robot.
    preprocessing : Preprocessing
        Filters of the recordings.

    Returns
    -------
    tuple of RowOptions and Preprocessing

    Raises
    ------
    DynidentError
        Where the recordings are too short to tell them.
    """
    if rows.model == "filtered" and rows.pole is None:
        pole, reason = _choose_pole(recordings, preprocessing)
        return replace(rows, pole=pole), replace(preprocessing, reasons=(*preprocessing.reasons, reason))
    if rows.model == "energy" and rows.interval is None:
        interval, reason = _choose_interval(recordings)
        return replace(rows, interval=interval), replace(preprocessing, reasons=(*preprocessing.reasons, reason))
    return rows, preprocessing


def build_equations(
    model: Model,
    rows: RowOptions,
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
) -> Reduction:
    """Reduce recordings to the equations of a model of rows, in the columns of its base parameters.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    rows : RowOptions
        The equation type and its constants.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Called with the fraction done and a message.

    Raises
    ------
    DynidentError
        Where filter or intervals leave no equation, or the base's wrench was not recorded or does not show an effect.
    """
    if rows.model == "base_wrench":
        return build_wrench_equations(model, rows, inputs.recordings, inputs.preprocessing, progress)
    # Found here once more for callers that did not: with constants given, nothing is searched.
    rows, _ = find_constants(rows, inputs.recordings, inputs.preprocessing)
    form, treatment = _select_form(model, rows)
    # F(s) starts from rest, which the robot does not. Rows count only once the filter has forgotten where it began.
    memory = _SETTLING_TIMES / rows.pole if rows.model == "filtered" and rows.pole is not None else 0.0
    reduction = reduce_form(form, treatment, inputs, progress, memory)
    if reduction.n_rows == 0:
        raise _no_rows_error(rows)
    return reduction


def _select_form(model: Model, rows: RowOptions) -> tuple[EquationForm, Treatment]:
    known = model.robot, model.kept, model.signals
    if rows.model == "filtered" and rows.pole is not None:
        return build_filtered_form(*known), filter_with_pole(rows.pole)
    if rows.model == "energy" and rows.interval is not None:
        return build_power_form(*known), integrate_over_intervals(rows.interval)
    if rows.model == "power":
        return build_power_form(*known), stream_equations
    raise ValueError(f"no equations for the model {rows.model}")


def _choose_pole(recordings: Sequence[Recording], preprocessing: Preprocessing) -> tuple[float, str]:
    """Return the pole a of F(s), and why: as wide as the band that Y and W are filtered to.

    A narrower one gains nothing, and noise above that band is gone already.
    """
    cutoff = preprocessing.torque_cutoff
    source = "the torque cut-off"
    if cutoff is None:
        # The torque is not filtered, so the band of the motion itself has to serve.
        cutoff, source = _HARMONICS * find_motion_band(recordings), f"{_HARMONICS:g} times the band of the motion"
    # The pole in rad/s whose corner is the cut-off in Hz.
    pole = max(_SMALLEST_POLE, round(2.0 * pi * cutoff, 1))
    return pole, (
        f"Filtered model: a = {pole:g} rad/s in F(s), 2 pi times {source} of {cutoff:.3g} Hz (at least "
        f"{_SMALLEST_POLE:g} rad/s, the smallest recommended value): F(s) passes the motion, and a further filter "
        "removes the noise above it."
    )


def _choose_interval(recordings: Sequence[Recording]) -> tuple[float, str]:
    """Return the interval of an energy equation, and why: as long as energy at the motion's highest frequency grows.

    Energy goes with the square of velocity, so it swings twice as fast as the motion. Longer intervals lose what swings
    more than once in them, and gather the errors of low frequency (§12.6.2); shorter ones are differences of nearly the
    same energy.
    """
    band = find_motion_band(recordings)
    # Half a swing of the energy at the highest frequency of the motion.
    interval = 1.0 / (SHARE_OF_PERIOD * band)
    return interval, (
        f"Energy model: intervals of {interval:.3g} s, an eighth of the shortest period of the motion (its band ends "
        f"at {band:.2g} Hz): energy oscillates at twice the frequency of the motion, and differs most over half of "
        "its period; over longer intervals torque offsets accumulate."
    )


def _no_rows_error(rows: RowOptions) -> DynidentError:
    """Return the error that no rows are left, with the remedy for the equation type."""
    if rows.model == "filtered" and rows.pole is not None:
        detail = (
            f"no rows are left: F(s) with a = {rows.pole:g} rad/s needs {10 / rows.pole:.3g} s to settle, but no run "
            "inside the windows is longer; use a longer recording, wider windows, or a larger pole"
        )
        return DynidentError(detail, pointer="/pole", title="Too few samples")
    if rows.model == "energy" and rows.interval is not None:
        detail = (
            f"no rows are left: no run inside the windows contains an interval of {rows.interval:g} s; use a longer "
            "recording, wider windows, or a shorter interval"
        )
        return DynidentError(detail, pointer="/interval", title="Too few samples")
    return DynidentError(
        "no rows are left after filtering; use a longer recording or wider windows",
        pointer="/recordings",
        title="Too few samples",
    )
