"""Statistics of a sample's columns: which is a clock, which changes, which has steps."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.errors import Remedy
from dynident.identification.column_inference.metadata_proposal import Question, UnitGuess
from dynident.recordings.file_source import describe_bursts, find_bursts
from dynident.recordings.sampling_clock import GAP_PERIODS
from dynident.recordings.signal_spectra import fill_gaps, find_rate_by_slopes
from dynident.recordings.time_columns import find_unfilled
from dynident.recordings.units import FACTORS


@dataclass(frozen=True, eq=False)
class Sample:
    """Consecutive rows of a file.

    Parameters
    ----------
    names : tuple of str
        Names of the columns.
    values : (m, columns)
        Their values; NaN where there is no number.
    units : dict of str to str
        Units that the file states, by column.
    remarks : tuple of str
        How the file was read, for the user.
    stated : dict of str to str
        What the user says that columns are, as our name of each.
    has_stated_rate : bool
        Whether the time was made of the number of the row and a rate that the user states.
    """

    names: tuple[str, ...]
    values: FloatArray
    units: dict[str, str]
    remarks: tuple[str, ...] = ()
    stated: dict[str, str] = field(default_factory=dict)
    has_stated_rate: bool = False


@dataclass(frozen=True)
class Clock:
    """The column that holds time.

    Parameters
    ----------
    column : int
        Number of the column.
    unit : str
        Its unit.
    factor : float
        Makes seconds of it.
    rate : float
        Rate of the rows in Hz.
    jitter : float
        Standard deviation of its steps over their median.
    sure : bool
        Whether the unit is sure.
    reason : str
        The reason, as a clause.
    """

    column: int
    unit: str
    factor: float
    rate: float
    jitter: float
    sure: bool
    reason: str


TICK = 1e-7
"""s: a tick of the clocks of Windows and .NET."""
CLOCK_FACTORS = {unit: FACTORS["t", None][unit] for unit in ("s", "ms", "us", "ns", "min", "h", "d")}
_TICKS = ((1.2e17, 1.5e17), (6.2e17, 6.6e17))
"""Times from 1981 to 2076 in ticks of 100 ns since 1601, as Windows counts them, and from 1965 to 2091 since year 1."""
_DAYS = ((36_526.0, 55_153.0), (730_486.0, 749_113.0))
"""Times from 2000 to 2050 in days, as spreadsheets count them from 1900, and MATLAB from year 0."""
_SHORTEST_RUN = 16
"""Rows of a run, at least, on average: a joint that sweeps within a grid of poses also rises and starts again."""
_BEGINS = 5.0
"""Steps from the first row's time within which a clock that starts again begins."""
_SLOWEST, _FASTEST = 8.0, 8000.0
"""Hz: a robot's recording has a rate between them, so that one unit alone, in steps of a thousand, fits."""


_MOMENT, _VERY_SLOW = 1.0, 1.0
"""s of a recording below which a slower clock is meant, and its rate in Hz at least."""


def drop_empty_rows(sample: Sample, times: Sequence[int]) -> Sample:
    """Return the sample without rows that an import leaves out: those that repeat the row before, or were never filled.

    Parameters
    ----------
    sample : Sample
        The rows as they were read.
    times : sequence of int
        Columns that are called a time: a file without one may repeat a row of a robot that stands.
    """
    values = sample.values
    if not len(times) or len(values) < 2:
        return sample
    before = values[:-1]
    is_new = np.append(True, ~((values[1:] == before) | (np.isnan(values[1:]) & np.isnan(before))).all(axis=1))
    unfilled = find_unfilled(values[:, times[0]]) & (np.nan_to_num(values) == 0.0).all(axis=1)
    kept = is_new & ~unfilled
    return sample if kept.all() else replace(sample, values=values[kept])


def mask_outliers(sample: Sample, times: Sequence[int]) -> Sample:
    """Return the sample without the few numbers that are far from all others of their column: no sensor gave them.

    Parameters
    ----------
    sample : Sample
        The rows.
    times : sequence of int
        Columns that are called a time, which stay as they are.
    """
    values = sample.values
    if len(values) < _FEWEST_ROWS:
        return sample
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        # Columns without any number have no percentiles.
        warnings.simplefilter("ignore", RuntimeWarning)
        low, high = np.nanpercentile(values, [_FEW, 100.0 - _FEW], axis=0)
        far = (values < low - _FAR * (high - low)) | (values > high + _FAR * (high - low))
    far &= (high > low) & (far.mean(axis=0) <= 0.01 * _FEW)
    far[:, list(times)] = False
    return replace(sample, values=np.where(far, np.nan, values)) if far.any() else sample


def restore_masked(masked: FloatArray, values: FloatArray) -> FloatArray:
    """Return values with the numbers that were masked: the steps of an import name outliers themselves.

    Parameters
    ----------
    masked : (m, c)
        Values with NaN where a number was masked, and perhaps further columns behind.
    values : (m, k)
        As the file has them.
    """
    restored = np.array(masked)
    own = restored[:, : values.shape[1]]
    own[:] = np.where(np.isnan(own), values, own)
    return restored


_FEWEST_ROWS = 200
_FEW, _FAR = 1.0, 20.0
"""Per cent of the numbers at either end that may be corrupted, and how many spans of the others these lie outside them:
a torque's peaks are within a few."""


def find_changing_columns(values: FloatArray) -> BoolArray:
    """Return which columns (columns,) hold numbers in most rows, and more than one."""
    if not len(values):
        return np.zeros(values.shape[1], dtype=bool)
    finite = np.isfinite(values)
    enough = finite.mean(axis=0) > 0.5
    low = np.where(finite, values, np.inf).min(axis=0)
    high = np.where(finite, values, -np.inf).max(axis=0)
    return np.asarray(enough & (high > low))


def find_clock_columns(values: FloatArray) -> list[int]:
    """Return the columns that run forward and never back, nearly evenly."""
    clocks = []
    for column in range(values.shape[1]):
        whole = np.flatnonzero(np.isfinite(values[:, column]))
        # Rows of another kind may stand at the ends, such as means below a table.
        if len(whole) < 0.99 * len(values) or len(whole) < 2:
            continue
        steps = np.diff(values[whole[0] : whole[-1] + 1, column])
        if not np.isfinite(steps).all():
            continue
        middle = float(np.median(steps))
        # A clock may start again with every run of a file, from where it began.
        later = values[whole[0] + 1 : whole[-1] + 1, column]
        if _SHORTEST_RUN * np.count_nonzero(steps < 0) > len(steps):
            continue
        forward = (steps >= 0) | (later <= values[whole[0], column] + _BEGINS * middle)
        if middle > 0 and forward.mean() > 0.995 and np.mean(np.abs(steps - middle) < 0.9 * middle) > 0.7:
            clocks.append(column)
    return clocks


def read_clock(values: FloatArray, column: int, unit: str | None) -> Clock | None:
    """Read a column as a clock; None where no unit gives the rate of a robot's recording.

    Parameters
    ----------
    values : (m, columns)
        Values of all columns.
    column : int
        Number of the column.
    unit : str, optional
        What its name states.
    """
    steps = np.diff(values[:, column])
    # Gaps between runs, and rows that repeat a time, must not count for the period.
    steps = steps[steps > 0]
    middle = float(np.median(steps))
    jitter = float(np.std(steps[steps < 5 * middle]) / middle)
    mean = float(np.mean(steps[steps < 5 * middle]))
    # Units are a factor of a thousand apart, as is the range of rates, so that one of them fits.
    usual = [(name, factor) for name, factor in CLOCK_FACTORS.items() if factor <= 1.0]
    fits = [name for name, factor in usual if _SLOWEST <= 1.0 / (mean * factor) <= _FASTEST]
    if unit in CLOCK_FACTORS:
        rate = 1.0 / (mean * CLOCK_FACTORS[unit])
        sure = _SLOWEST / 4 <= rate <= 4 * _FASTEST
        return Clock(
            column, unit, CLOCK_FACTORS[unit], rate, jitter, sure, f"its name says {unit}; that gives {rate:.4g} Hz"
        )
    if any(low < np.nanmin(values[:, column]) < high for low, high in _TICKS):
        fits = ["100ns"]
    days = [low < np.nanmin(values[:, column]) < high for low, high in _DAYS]
    if not fits and any(days) and _SLOWEST <= 1.0 / (mean * CLOCK_FACTORS["d"]) <= _FASTEST:
        fits = ["d"]
    if len(fits) != 1:
        return None
    (only_unit,) = fits
    # A log slower than a robot's is still more likely than a thousandth of its length, which would be a moment.
    slower = {"ms": "s", "us": "ms", "ns": "us"}.get(only_unit)
    if slower is not None and len(steps) * mean * CLOCK_FACTORS[only_unit] < _MOMENT:
        only_unit = slower if 1.0 / (mean * CLOCK_FACTORS[slower]) > _VERY_SLOW else only_unit
    factor = TICK if only_unit == "100ns" else CLOCK_FACTORS[only_unit]
    rate = 1.0 / (mean * factor)
    return Clock(column, only_unit, factor, rate, jitter, True, f"its steps give {rate:.4g} Hz in {only_unit}")


def is_counter(values: FloatArray, column: int) -> bool:
    """Tell whether a column counts rows: it goes up by one.

    Parameters
    ----------
    values : (m, columns)
        Values of all columns.
    column : int
        Number of the column.
    """
    # Rows may be missing, so nearly all steps are enough.
    return bool((np.diff(values[:, column]) == 1.0).mean() > 0.999)


def compute_roughness(values: FloatArray) -> FloatArray:
    """Return the roughness of every column (c,): near 0 for positions, large for torques.

    It is the rms of the second difference over the standard deviation.

    Parameters
    ----------
    values : (m, c)
        Values of the columns.
    """
    values = fill_gaps(values)
    second = np.diff(values, n=2, axis=0)
    size = values.std(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(np.sqrt((second**2).mean(axis=0)) / size))


def find_exact_step(values: FloatArray) -> float | None:
    """Return the step of which all differences of a signal are whole multiples; None where there is none.

    Parameters
    ----------
    values : (m,)
        The signal; NaN where there is no number.
    """
    levels = np.unique(values[np.isfinite(values)])
    gaps = np.diff(levels)
    # Numbers of 32 bits do not give the same level twice once they were computed with.
    gaps = gaps[gaps > 4.0 * np.finfo(np.float32).eps * np.abs(levels).max(initial=0.0)]
    if len(gaps) < _FEWEST_STEPS:
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    counts = np.rint(gaps / step)
    # The sum of all differences gives the step to more digits than one of them.
    step = float(gaps.sum() / counts.sum())
    return step if float(np.abs(gaps / step - counts).max()) < _WHOLE else None


_FEWEST_STEPS = 12
"""Differences between neighbouring levels below which a common step may be chance."""
_WHOLE = 0.1
"""Steps by which a difference may miss a whole number of them: positions written with three decimals have 0.03."""

_FULL_RANGE = 100.0
"""Number at the upper end of a calibrated range."""
_SERVO_COUNTS = 4096
"""Counts per turn of Feetech STS and Dynamixel X servos."""
_FEWEST_COUNTS = 100
"""Counts that the calibrated range of a joint has at least."""
_SERVO_STEPS = (
    "the numbers of a joint have one step, a count of its servo. In LeRobot's degrees it is 360/4095. In the shares of "
    "-100 to 100 that LeRobot writes without use_degrees it is 200 (gripper: 100) over the calibrated range, so that "
    "the unit is counts:N with N = 4096 * 200 / (range_max - range_min) of the calibration file (gripper: 100)"
)
"""Why a unit was taken, as a clause."""
_SAME_STEP, _SAME_COUNT = 1e-3, 0.1
"""Relative difference of steps that are the same, and difference to a whole number of counts of a range."""


def _find_servo_units(q: FloatArray) -> list[str | None]:
    """Find the units of positions that LeRobot wrote, by the step between the numbers of each joint.

    It writes degrees, of which a count is 360/4095 in every joint; or shares of the range that the calibration of a
    joint found, -100 to 100 (0 to 100 of a gripper), of which a count is 200 (100) over that range in counts.

    Parameters
    ----------
    q : (m, n)
        Positions of joints that turn, as the file has them.

    Returns
    -------
    list of str or None
        "deg" or "counts:N" of each joint; None of one that moves too little. Empty where the steps are others.
    """
    units: list[str | None] = []
    ranges = set()
    for column in q.T:
        step = find_exact_step(column)
        counts = 2.0 * _FULL_RANGE / step if step else 0.0
        if step is None:
            units.append(None)
        elif abs(step * (_SERVO_COUNTS - 1) / 360.0 - 1.0) < _SAME_STEP:
            units.append("deg")
        elif (
            float(np.nanmax(np.abs(column))) < _FULL_RANGE * (1.0 + _SAME_STEP)
            and _FEWEST_COUNTS < counts < 2 * _SERVO_COUNTS
            and abs(counts - np.rint(counts)) < _SAME_COUNT
        ):
            ranges.add(round(counts))
            units.append(f"counts:{_SERVO_COUNTS * step:.4f}")
        else:
            return []
    # One step for all is that of an encoder or of rounding: ranges of calibrations differ.
    return units if "deg" in units or len(ranges) > 1 else []


def guess_servo_units(q: FloatArray, joints: Sequence[int]) -> dict[int, UnitGuess]:
    """Guess the units of joints that turn by the counts of their servos; empty if none show.

    Parameters
    ----------
    q : (m, n)
        Positions as the file has them.
    joints : sequence of int
        Those that turn.
    """
    units = dict(zip(joints, _find_servo_units(q[:, list(joints)]), strict=False))
    guesses = {joint: UnitGuess(unit, 0.95, _SERVO_STEPS) for joint, unit in units.items() if unit is not None}
    # A joint that moves too little is in degrees if another is; in shares the range of its calibration is needed.
    in_degrees = "deg" in units.values()
    still = UnitGuess("deg", 0.95 if in_degrees else 0.4, f"it moves too little to show its unit, but {_SERVO_STEPS}")
    return {joint: guesses.get(joint, still) for joint in units}


_ZERO_ALIKE, _FEWEST_JOINTS = 0.1, 3
"""Relative distance within which the middles of most joints' efforts are one number; and joints from which on gravity
does not make that so."""


def find_converter_zero(values: FloatArray) -> float | None:
    """Return the number about which the efforts (m, n) of all joints vary; None where there is none.

    A converter that measures both directions, without a sign, writes half of its range where nothing flows. It counts:
    numbers that are not whole are none of it.
    """
    if not (np.isnan(values) | (values == np.rint(values))).all():
        return None
    middle, spread = np.nanmedian(values, axis=0), np.nanstd(values, axis=0)
    zero = float(np.median(middle))
    is_zero = values.shape[1] >= _FEWEST_JOINTS and (middle > spread).all() and (spread > 0.0).all()
    return zero if is_zero and np.median(np.abs(middle - zero)) < _ZERO_ALIKE * zero else None


_MOST_BETWEEN = 0.6
"""Share of the time that lies between bursts of rows, from which on a clock does not say when they were measured."""


_ALIKE = 2.0
"""Times the change from row to row that signals change by across a gap where only the time has it: a gap of the
recording is of at least `GAP_PERIODS`, and where the robot stands in it, it slows down before."""


def ask_for_rate_of_bursts(name: str, values: FloatArray, clock: Clock) -> Question | None:
    """Ask for the rate of rows that come several at a time, with most of the time between; None of other clocks.

    Gaps of the time alone are asked about: where the signals have them, too, there is none to correct.

    Parameters
    ----------
    name : str
        Name of the clock.
    values : (m, columns)
        Values of all columns.
    clock : Clock
        The clock.
    """
    t = values[:, clock.column]
    steps = np.diff(t)
    step = float(np.median(steps))
    ends = np.flatnonzero(steps > GAP_PERIODS * step)
    burst, rate = find_bursts(ends, t[ends], step)
    if not burst or steps[ends].sum() < _MOST_BETWEEN * (t[-1] - t[0]):
        return None
    signals = np.setdiff1d(np.flatnonzero(find_changing_columns(values)), find_clock_columns(values))
    if not _are_continuous(fill_gaps(values[:, signals]), ends):
        return None
    detail, rate_remedy = describe_bursts(name, burst, rate / CLOCK_FACTORS.get(clock.unit, 1.0))
    as_it_is = Remedy("columns", {"t": name})
    detail += f" If {name} is right, take it as it is: {as_it_is}."
    return Question("columns/t", detail, remedies=(rate_remedy, as_it_is))


def _are_continuous(signals: FloatArray, ends: IntArray) -> bool:
    """Return whether smooth signals change behind these rows about as much as from any row to the next."""
    changes = np.abs(np.diff(signals, axis=0))
    usual = np.median(changes, axis=0)
    # Noise changes by the same wherever it is looked at; of a smooth signal the next change is nearly the last one.
    smooth = (usual > 0.0) & (np.median(np.abs(np.diff(signals, 2, axis=0)), axis=0) < usual)
    ratios = np.median(changes[ends], axis=0)[smooth] / usual[smooth]
    return bool(len(ratios) and 1.0 / _ALIKE < np.median(ratios) < _ALIKE)


def select_whole_signals(columns: Sequence[int], values: FloatArray, alive: BoolArray, n: int) -> list[int]:
    """Return the columns that change; or all of them, where only all make whole signals of n joints.

    Parameters
    ----------
    columns : sequence of int
        Numbers of the columns in question.
    values : (m, c)
        Values of all columns.
    alive : (c,)
        Which columns change.
    n : int
        Number of joints.

    Returns
    -------
    list of int
        Numbers of the columns that are left.
    """
    # A second clock, or a counter of rows, is no signal of a joint.
    running = {*find_clock_columns(values), *(index for index in columns if _counts_on(values[:, index]))}
    numbers = [index for index in columns if np.isfinite(values[:, index]).all() and index not in running]
    moving = [index for index in numbers if alive[index]]
    return numbers if len(moving) % n and not len(numbers) % n else moving


_FEWEST_SECONDS = 5


def _counts_on(values: FloatArray) -> bool:
    """Return whether a column (m,) rises by equal steps with many rows between them, as a clock of whole seconds."""
    steps = np.diff(values)
    counts = steps[steps != 0.0]
    return _FEWEST_SECONDS <= len(counts) < 0.5 * len(steps) and bool(np.allclose(counts, abs(counts[0]), rtol=1e-6))


_RIGHT, _SAME_RATIO, _GEARED = 0.05, 0.02, 20.0
_RATIOS_OF_UNITS = np.array([30.0 / np.pi, np.pi / 30.0, 1.0 / 6.0, 2.0 * np.pi, 0.5 / np.pi])
"""Share by which a stated rate may miss that of the velocities, and a ratio those of rpm or turns with rad or degrees:
30 / π is near 10, a usual mistake of rates; from the third number on a ratio is that of degrees, or of gears."""


def ask_for_other_rate(sample: Sample, clock: Clock) -> list[Question]:
    """Ask for another rate than the stated one, where columns are the derivatives of others at another.

    Parameters
    ----------
    sample : Sample
        The rows.
    clock : Clock
        Their time.
    """
    rate = find_rate_by_slopes(np.delete(sample.values, clock.column, axis=1)) if sample.has_stated_rate else 0.0
    ratio = rate / clock.rate
    known = abs(ratio - 1.0) < _RIGHT or bool((np.abs(ratio / _RATIOS_OF_UNITS - 1.0) < _SAME_RATIO).any())
    if known or not 1.0 / _GEARED < ratio < _GEARED:
        return []
    remedy = Remedy("rate", rate)
    detail = (
        f"At {clock.rate:.4g} Hz the velocities are {ratio:.3g} times the derivatives of the positions; at {rate:g} Hz "
        f"they are right: {remedy}. If {clock.rate:.4g} Hz is right, they are in another unit, or those of motors."
    )
    return [Question("units/t", detail, check="clock_rate", remedies=(remedy,))]
