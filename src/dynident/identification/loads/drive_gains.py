"""Identify drive gains from runs without and with a known payload [12.17], by total least squares.

Holds when a gain counts as not identifiable (10 %).

In g_j u_j = W_j χ + w_j, with u the recorded currents and w the torque of the known payload, gains and parameters are
found together [Gautier & Briot 2011]; only the known payload gives them a scale. The errors are those of the currents.
So g_j u_j cannot simply be moved to the side of the columns: ordinary least squares would make the gains too small.
This form of total least squares knows where the errors are: it minimises Σ |u_j - (W_j χ + w_j) / g_j|² over the noise
of every joint. It starts from the singular vector of the smallest singular value of [W w -u].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import EffectChoice, get_role
from dynident.errors import DynidentError
from dynident.estimation import EquationFactors, EstimationError, Reduction, solve_weighted, statistics
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.estimation.prior_information import extract_deviations
from dynident.identification.loads.payloads_of_recordings import (
    PLAIN_EFFECTS,
    read_known_payload,
    reduce_with_payloads,
    scale_torque,
)
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.robot import Robot


def get_stated_gains(robot: Robot, stated: Sequence[float] | None) -> FloatArray:
    """Return the stated gains (n,): those given, else those of the robot's drives, else 1.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    stated : sequence of float, optional
        One gain for each joint; None for those of the robot's drives.

    Raises
    ------
    DynidentError
        Where what is given is not one number other than 0 a joint.
    """
    if stated is None:
        return np.array([1.0 if drive.gain is None else drive.gain for drive in robot.drives])
    gains = np.asarray(stated, dtype=np.float64)
    # A gain of zero would make every torque zero; a negative one is a matter of signs, and allowed.
    if gains.shape != (robot.n,) or not np.all(np.isfinite(gains) & (gains != 0)):
        raise DynidentError(
            f"the given gains are {list(stated)}; give one number other than 0 for each of the {robot.n} joints",
            pointer="/gains",
        )
    return gains


def refuse_coupled_drives(robot: Robot, what: str) -> None:
    """Raise where a motor acts on several joints: no joint's torque is then its own current times a gain.

    Parameters
    ----------
    robot : Robot
        The robot with its drives.
    what : str
        What cannot be done, as the beginning of a clause of the message.

    Raises
    ------
    DynidentError
        Where a drive is coupled with other joints.
    """
    coupled = [name for name, drive in zip(robot.joint_names, robot.drives, strict=True) if drive.coupling]
    if coupled:
        raise DynidentError(
            f"the motors of {', '.join(coupled)} act on several joints; {what} motors that each act on one joint",
            pointer=f"/drives/{coupled[0]}/coupling",
            title="Coupled drives",
        )


# Gauss-Newton steps at most, and the relative change of the gains below which they have settled.
_ROUNDS = 60
_SETTLED = 1e-8
# Relative standard deviation above which a gain is said not to be identifiable from the data.
_IDENTIFIABLE = 0.1


@dataclass(frozen=True)
class DriveGain:
    """The drive gain of one joint.

    Parameters
    ----------
    joint : str
        Name of the joint.
    drive_gain : float
        Estimated gain, in N m/A or N/A as those of `DriveGains`.
    standard_deviation : float
        Standard deviation of the gain.
    interval : tuple of float
        Ends of the interval that holds the true gain in 95 of 100 cases.
    stated : float
        The gain that the recorded torque was computed with.
    factor : float
        `drive_gain` over `stated`.
    identifiable : bool
        Whether the data determine the gain to a tenth.
    """

    joint: str
    drive_gain: float
    standard_deviation: float
    interval: tuple[float, float]
    stated: float
    factor: float
    identifiable: bool


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Drive gains of all joints.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the joints.
    values : (n,)
        Gains in N m/A or N/A, in the units of `stated`; in N m/rad or N/m of position servos.
    covariance : (n, n)
        Covariance of the gains, with the correlation of the residuals accounted for.
    stated : (n,)
        Gains that the recorded torque was computed with; 1 where the columns are currents or nothing is known of them.
    identifiable : tuple of bool
        For each joint whether the data leave its gain less than a tenth uncertain.
    warnings : tuple of str
        Warnings about gains that are uncertain or negative.
    from_commands : bool
        Whether they are gains of position servos, whose torque was made of commands.
    """

    joint_names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    stated: FloatArray
    identifiable: tuple[bool, ...]
    warnings: tuple[str, ...] = ()
    from_commands: bool = False

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations (n,), in the unit of `values`."""
        return extract_deviations(self.covariance)

    @property
    def intervals(self) -> FloatArray:
        """95 % confidence intervals (n, 2)."""
        reach = NORMAL_95 * self.standard_deviations
        return np.column_stack([self.values - reach, self.values + reach])

    @property
    def factors(self) -> FloatArray:
        """Factors (n,) that the recorded torque is to be multiplied by."""
        return np.asarray(self.values / self.stated)

    @property
    def each(self) -> tuple[DriveGain, ...]:
        """The gains joint by joint."""
        deviations, intervals, factors = self.standard_deviations, self.intervals, self.factors
        return tuple(
            DriveGain(
                name,
                float(self.values[k]),
                float(deviations[k]),
                (float(intervals[k, 0]), float(intervals[k, 1])),
                float(self.stated[k]),
                float(factors[k]),
                self.identifiable[k],
            )
            for k, name in enumerate(self.joint_names)
        )


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """Estimated mass of a payload.

    Parameters
    ----------
    mass : float
        The mass in kg.
    standard_deviation : float
        Its standard deviation in kg, that of the gains included.
    from_gains : float
        The part of the deviation in kg that uncertain gains cause.
    """

    mass: float
    standard_deviation: float
    from_gains: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval, kg."""
        return self.mass - NORMAL_95 * self.standard_deviation, self.mass + NORMAL_95 * self.standard_deviation

    @property
    def identifiable(self) -> bool:
        """Whether the interval leaves out zero, so that the data show a payload at all."""
        return abs(self.mass) > NORMAL_95 * self.standard_deviation


@single_threaded
def identify_gains(
    robot: Robot,
    unloaded: Sequence[Recording],
    loaded: Sequence[Recording],
    *,
    effects: Sequence[EffectChoice] = PLAIN_EFFECTS,
    stated: Sequence[float] | None = None,
    preprocessing: Preprocessing | None = None,
    progress: Progress = ignore_progress,
) -> DriveGains:
    """Identify the drive gains from the same motion without and with a known payload.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    unloaded, loaded : sequences of Recording
        The metadata of the loaded ones state the payload: its mass (kg) and, where known, its centre (m).
    effects : sequence of EffectChoice
        The model besides the payload.
    stated : sequence of float, optional
        Gains that the recordings' torque was computed with; those of the robot's drives where left out, else 1.
    preprocessing : Preprocessing, optional
        Filters; from the data where left out.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    DriveGains
        The gains of all joints, with warnings about those that the data do not determine.

    Raises
    ------
    DynidentError
        For a missing run, a payload without a usable mass, torque that is zero, or data that do not determine the
        model.
    """
    refuse_coupled_drives(robot, "gains are identified for")
    payloads = [read_known_payload(recording) for recording in loaded]
    data = reduce_with_payloads(robot, unloaded, loaded, effects, preprocessing, progress)
    # Some payload parameters have no effect at all on this robot: a planar arm does not feel how high the load is.
    unfelt = {
        (column.parameter, column.runs)
        for column in (data.model.columns[k] for k in data.model.base.without_effect)
        if get_role(column) == "load"
    }
    known = {
        data.payload_column(recording, name): value
        for recording, payload in zip(loaded, payloads, strict=True)
        for name, value in payload.parameters.items()
        if (name, (recording.name,)) not in unfelt
    }
    # The recorded torque is the measured side, so its factors are relative to the stated gains.
    factors, covariance = solve_total_least_squares(data.reduction, known)
    # From factors on the recorded torque to gains.
    scale = get_stated_gains(robot, stated)
    deviations = np.sqrt(np.diag(covariance)) / np.abs(factors)
    identifiable = tuple(bool(d <= _IDENTIFIABLE) for d in deviations)
    warnings = (*_warn_of_uncertain_gains(robot, deviations, identifiable), *_warn_of_negative_gains(robot, factors))
    return DriveGains(
        robot.joint_names,
        factors * scale,
        covariance * np.outer(scale, scale),
        scale,
        identifiable,
        warnings,
        from_commands=any(recording.torque_from_commands for recording in (*unloaded, *loaded)),
    )


@single_threaded
def payload_mass(
    robot: Robot,
    unloaded: Sequence[Recording],
    loaded: Recording,
    *,
    gains: DriveGains | None = None,
    effects: Sequence[EffectChoice] = PLAIN_EFFECTS,
    preprocessing: Preprocessing | None = None,
    progress: Progress = ignore_progress,
) -> PayloadEstimate:
    """Weigh the payload of a recording, by comparison with recordings without it.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    unloaded : sequence of Recording
        Recordings without the payload.
    loaded : Recording
        The recording with the payload.
    gains : DriveGains, optional
        Identified for torque columns that were computed with the same stated gains; the recorded torque is taken as it
        is where they are left out.
    effects : sequence of EffectChoice
        The model besides the payload.
    preprocessing : Preprocessing, optional
        Filters; from the data where left out.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    PayloadEstimate
        The mass, with the part of its uncertainty that comes from the gains.

    Raises
    ------
    DynidentError
        Where the recordings do not determine the model.
    """
    data = reduce_with_payloads(robot, unloaded, [loaded], effects, preprocessing, progress)
    column = data.payload_column(loaded, "Mp")
    factors = np.ones(robot.n) if gains is None else gains.factors
    reduction = scale_torque(data.reduction, factors)
    solution = solve_weighted(reduction)
    variance = float(statistics(reduction, solution).covariance[column, column])
    by_gain = 0.0
    if gains is not None:
        # The mass is linear in each joint's torque, and that is proportional to the joint's gain. So the slope of the
        # mass over a gain is the joint's contribution to the mass, divided by the gain.
        slopes = _compute_contributions(reduction, solution.noise, solution.normal_inverse[column]) / gains.values
        by_gain = float(slopes @ gains.covariance @ slopes)
    return PayloadEstimate(float(solution.values[column]), float(np.sqrt(variance + by_gain)), float(np.sqrt(by_gain)))


def solve_total_least_squares(reduction: Reduction, known: Mapping[int, float]) -> tuple[FloatArray, FloatArray]:
    """Return the factors f (n,) on the measured side of f_j y_j = W_j χ, and their covariance (n, n).

    Parameters
    ----------
    reduction : Reduction
        Rows of [W | y], y in any unit, one unit an equation.
    known : mapping of column to value
        Parameters that are known, in the unit of χ; they give the factors their scale.

    Raises
    ------
    EstimationError
        Where what is known leaves no trace in the data.
    """
    c, n = reduction.n_columns, len(reduction.equations)
    fixed = np.zeros(c)
    fixed[list(known)] = list(known.values())
    free = np.array([k for k in range(c) if k not in known], dtype=np.intp)
    # The problem is not convex: the singular vector gives a start that is near the right minimum.
    values, inverse = _compute_start(reduction, fixed, free)
    for _ in range(_ROUNDS):
        if not np.isfinite([*values, *inverse]).all():
            raise _unsettled_error()
        # Gauss-Newton in k = 1 / f: y_j = k_j W_j χ is bilinear, and its errors are those of y as measured.
        linear = _linearise(reduction, free, values, inverse)
        solution = solve_weighted(linear)
        before = inverse
        values = fixed.copy()
        values[free] = solution.values[: len(free)]
        inverse = solution.values[len(free) :]
        if np.abs(inverse - before).max() <= _SETTLED * np.abs(inverse).max():
            break
    else:
        raise _unsettled_error()
    covariance = statistics(linear, solution).covariance[len(free) :, len(free) :]
    # The covariance of f = 1 / k by the delta method.
    slope = 1.0 / inverse**2
    return 1.0 / inverse, np.asarray(covariance[:n, :n] * np.outer(slope, slope))


def _unsettled_error() -> EstimationError:
    return EstimationError(
        "the gains do not converge: the payload torque is too small compared with the noise; carry a heavier payload, "
        "and check the given mass",
        pointer="/loaded_ids",
        title="Not identifiable",
    )


def _compute_start(reduction: Reduction, fixed: FloatArray, free: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Return χ (c,) and 1/f (n,) of the singular vector of the smallest singular value of [W w -y].

    The columns are scaled to equal size.
    """
    c, n = reduction.n_columns, len(reduction.equations)
    parts = []
    for j, equation in enumerate(reduction.equations):
        k = len(equation.columns)
        # An equation that is exact would get an infinite weight.
        noise = max(equation.own_noise, 1e-9 * float(np.abs(equation.whole_factor).max()))
        # One column for the torque of each joint, so that every joint has a factor of its own; one for the known
        # payload.
        wide = np.zeros((k + 1, c + 1 + n))
        wide[:, equation.columns] = equation.whole_factor[:, :k]
        wide[:, c] = equation.whole_factor[:, :k] @ fixed[equation.columns]
        wide[:, c + 1 + j] = -equation.whole_factor[:, k]
        parts.append(wide / noise)
    rows = np.vstack(parts)[:, [*free, *range(c, c + 1 + n)]]
    sizes = np.linalg.norm(rows, axis=0)
    if not sizes.all():
        raise EstimationError(
            "the known payload, or the torque of a joint, has no effect in the data",
            pointer="/loaded_ids",
            title="Not identifiable",
        )
    if not np.isfinite(sizes).all():
        raise _unsettled_error()
    vector = np.linalg.svd(rows / sizes)[2][-1] / sizes
    # The singular vector has any length; the column of the known payload counts once, which gives it its scale.
    vector = vector / vector[len(free)]
    values = fixed.copy()
    values[free] = vector[: len(free)]
    return values, 1.0 / vector[len(free) + 1 :]


def _linearise(reduction: Reduction, free: IndexArray, values: FloatArray, inverse: FloatArray) -> Reduction:
    """Linearise y_j = k_j W_j χ about χ and k = 1/f: columns k_j W_j of the free parameters and W_j χ of k_j."""
    number = {int(column): new for new, column in enumerate(free)}
    equations = []
    for j, equation in enumerate(reduction.equations):
        p = len(equation.columns)
        own = [i for i, column in enumerate(equation.columns) if int(column) in number]
        change = np.zeros((p + 1, len(own) + 2))
        # The columns of W times k_j, and one column W_j χ for the change of k_j itself.
        change[own, range(len(own))] = inverse[j]
        change[:p, len(own)] = values[equation.columns]
        # The measured side of the linearised equation: y_j plus the product at the old values, which stands in both
        # groups of columns.
        change[own, -1] = inverse[j] * values[equation.columns[own]]
        change[p, -1] = 1.0
        columns = [number[int(equation.columns[i])] for i in own] + [len(free) + j]
        equations.append(equation.mix_columns(change, np.array(columns, dtype=np.intp)))
    return Reduction(len(free) + len(reduction.equations), tuple(equations), reduction.spans)


def _compute_contributions(reduction: Reduction, noise: FloatArray, row: FloatArray) -> FloatArray:
    """Return the contribution (n,) of each equation's torque to a parameter; `row` (c,) is its row of (WᵀW)⁻¹."""

    def compute_share(equation: EquationFactors, sigma: float) -> float:
        k = len(equation.columns)
        score = equation.whole_factor[:, :k].T @ equation.whole_factor[:, k] / sigma**2
        return float(row[equation.columns] @ score)

    return np.array([compute_share(e, float(s)) for e, s in zip(reduction.equations, noise, strict=True)])


def _warn_of_uncertain_gains(robot: Robot, deviations: FloatArray, identifiable: Sequence[bool]) -> list[str]:
    """Return a warning for every gain that the data do not determine."""
    return [
        f"The gain of {name} is not identifiable from these data: its standard deviation is "
        f"{format_percent(deviation, decimals=0)}. The payload changes the torque of this joint too little: carry a "
        "heavier payload, or move more."
        for name, deviation, good in zip(robot.joint_names, deviations, identifiable, strict=True)
        if not good
    ]


def _warn_of_negative_gains(robot: Robot, factors: FloatArray) -> list[str]:
    """Return a warning about gains with the sign opposite to the stated one."""
    names = [name for name, factor in zip(robot.joint_names, factors, strict=True) if factor < 0]
    if not names:
        return []
    return [
        f"Compared with the given gains, the gains of {', '.join(names)} are negative. Check whether runs with the "
        "load were declared as runs without it; otherwise the sign of these torque columns is wrong."
    ]
