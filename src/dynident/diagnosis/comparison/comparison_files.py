"""Comparisons as Parquet files, a column a signal and joint; figures, residual maps and spectra are read from them."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow.parquet as pq

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.diagnosis.comparison.residual_autocorrelation_and_spectra import (
    HIGHEST_IN_A_METRE,
    HIGHEST_IN_A_RADIAN,
    Autocorrelation,
    ResidualSpectrum,
    angle_spectrum,
    autocorrelation,
    time_spectrum,
)
from dynident.errors import DynidentError, describe_missing_joint
from dynident.recordings.arrow_tables import table_column_to_floats, table_from_arrays
from dynident.recordings.joint_phases import Phase

SIGNALS = ("measured", "predicted", "lower", "upper", "residual", "phase", "deviation", "q", "dq", "ddq", "load")
METADATA_KEY = b"dynident.comparison"
ROW_GROUP = 1 << 16
"""Rows that are read at least: what is asked of a long recording is mostly a short interval of it."""
_NORMAL_95 = 1.96


@dataclass(frozen=True, eq=False)
class JointSignals:
    """Signals of one joint in a comparison.

    Parameters
    ----------
    t : (m,)
        Times, s.
    segment : (m,)
        Number of the segment of each row.
    measured : (m,)
        Measured torque, N m or N.
    predicted : (m,)
        Predicted torque.
    lower : (m,)
        Lower end of the band that static friction may hold where the joint stands.
    upper : (m,)
        Upper end of that band.
    standing : (m,)
        Whether the joint stands.
    residual : (m,)
        Measured less predicted torque; where the joint stands, the distance to the band.
    band : (m,)
        Half-width of the 95 % band of the residual.
    q : (m,)
        Positions, rad or m.
    dq : (m,)
        Velocities, rad/s or m/s.
    ddq : (m,)
        Accelerations, rad/s² or m/s².
    load : (m,)
        Part of the prediction that the rigid bodies make.
    """

    t: FloatArray
    segment: FloatArray
    measured: FloatArray
    predicted: FloatArray
    lower: FloatArray
    upper: FloatArray
    standing: BoolArray
    residual: FloatArray
    band: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    load: FloatArray

    def select_rows(self, chosen: BoolArray | IndexArray) -> JointSignals:
        """Return some of the rows."""
        return replace(self, **{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


@dataclass(frozen=True, eq=False)
class ResidualMap:
    """A joint's residual in bins of one or two signals.

    Parameters
    ----------
    x_edges : (a + 1,)
        Edges of the bins of the first signal.
    y_edges : (b + 1,) or None
        Edges of the bins of the second signal; None over one signal, where b is 1.
    mean : (a, b)
        Mean of the residual; nan where a bin is empty.
    spread : (a, b)
        Standard deviation of the residual; nan where a bin is empty.
    count : (a, b)
        Number of rows.
    """

    x_edges: FloatArray
    y_edges: FloatArray | None
    mean: FloatArray
    spread: FloatArray
    count: FloatArray


@dataclass(frozen=True)
class SpectralPeak:
    """A line in a spectrum.

    Parameters
    ----------
    frequency : float
        Frequency, in the unit of the spectrum.
    amplitude : float
        Amplitude, N m or N.
    per_turn : float or None
        Cycles in a turn of the joint; None over time and for a prismatic joint.
    """

    frequency: float
    amplitude: float
    per_turn: float | None


@dataclass(frozen=True, eq=False)
class JointSpectrum:
    """Amplitude spectrum of a joint's residual over time or its own position, and its highest peaks.

    Parameters
    ----------
    spectrum : ResidualSpectrum
        The spectrum.
    frequency_unit : {"Hz", "cycles/rad", "cycles/m"}
        Unit of the frequencies.
    peaks : tuple of SpectralPeak
        The highest peaks, highest first.
    """

    spectrum: ResidualSpectrum
    frequency_unit: Literal["Hz", "cycles/rad", "cycles/m"]
    peaks: tuple[SpectralPeak, ...]


def write_comparison(comparison: Comparison, path: Path) -> Path:
    """Write the signals of a comparison to a Parquet file, a column for each signal of each joint.

    Parameters
    ----------
    comparison : Comparison
        The comparison.
    path : Path
        The file, which is replaced if it exists.

    Returns
    -------
    Path
        The path of the file.
    """
    columns: dict[str, FloatArray] = {"t": comparison.t, "segment": comparison.segment}
    signals = {signal: getattr(comparison, signal) for signal in SIGNALS}
    if comparison.temperature is not None:
        signals["temperature"] = comparison.temperature
    for signal, values in signals.items():
        for index, joint in enumerate(comparison.joint_names):
            columns[f"{signal}_{joint}"] = values[:, index]
    header = {"joint_names": comparison.joint_names, "units": comparison.units, "noise": comparison.noise.tolist()}
    table = table_from_arrays(columns).replace_schema_metadata({METADATA_KEY: json.dumps(header).encode()})
    # Measured numbers hardly ever come twice: dictionaries of them take six times as long, and more room.
    pq.write_table(table, path, row_group_size=ROW_GROUP, use_dictionary=False)
    return path


class StoredComparison:
    """Signals of a comparison in a file, read when they are needed.

    All methods that take a joint raise `DynidentError` where there is no joint of that name.
    """

    def __init__(self, path: Path) -> None:
        self._file = pq.ParquetFile(path)
        header = json.loads(self._file.schema_arrow.metadata[METADATA_KEY])
        self.joint_names: list[str] = header["joint_names"]
        self._units: list[str] = header["units"]
        self._noise: list[float] = header["noise"]

    def get_unit(self, joint: str) -> str:
        """Return the unit of a joint's torques."""
        return self._units[self._find_joint(joint)]

    def read_signals(self, joint: str, start: float | None = None, end: float | None = None) -> JointSignals:
        """Return one joint's signals between two times in s.

        Parameters
        ----------
        joint : str
            Name of the joint.
        start : float or None
            First time, s; the beginning where left out.
        end : float or None
            Last time, s; the end where left out.
        """
        index = self._find_joint(joint)
        groups = self._find_row_groups(start, end)
        t, segment, measured, predicted, deviation, q, dq, ddq, load = self._read(
            "t",
            "segment",
            *(f"{signal}_{joint}" for signal in ("measured", "predicted", "deviation", "q", "dq", "ddq", "load")),
            groups=groups,
        )
        residual, lower, upper, phase = self._read_band_at_standstill(joint, measured, predicted, groups)
        band = _NORMAL_95 * np.sqrt(deviation**2 + self._noise[index] ** 2)
        standing = phase == Phase.STANDING
        every = JointSignals(t, segment, measured, predicted, lower, upper, standing, residual, band, q, dq, ddq, load)
        return every.select_rows((t >= (-np.inf if start is None else start)) & (t <= (np.inf if end is None else end)))

    def compute_residual_map(self, joint: str, x: str, y: str | None, bins: int) -> ResidualMap:
        """Bin a joint's residual over one or two signals; raise `DynidentError` for a signal that there is not.

        Parameters
        ----------
        joint : str
            Name of the joint.
        x, y : str
            Names of the signals: t, or q_, dq_, ddq_, load_, tau_, temperature_ followed by a joint's name; `y` is None
            for a map over one.
        bins : int
            Number of bins of each signal.
        """
        # Importing it takes half a second, so that only those who need it do.
        from scipy.stats import binned_statistic_2d

        self._find_joint(joint)
        names = [x] if y is None else [x, y]
        columns = [self._find_column(name, pointer) for name, pointer in zip(names, ("x", "y"), strict=False)]
        over_x, *rest = self._read(*columns)
        residual = self._read_residual(joint)
        over_y = rest[0] if rest else np.zeros_like(over_x)
        # Over one signal the second axis is a single bin, so that one call serves both cases.
        numbers_of_bins = [bins, bins if rest else 1]
        mean, x_edges, y_edges, _ = binned_statistic_2d(over_x, over_y, residual, "mean", numbers_of_bins)
        spread, *_ = binned_statistic_2d(over_x, over_y, residual, "std", numbers_of_bins)
        count, *_ = binned_statistic_2d(over_x, over_y, residual, "count", numbers_of_bins)
        # SciPy gives 0 as the spread of an empty bin, which would look like perfect agreement.
        filled = np.asarray(np.where(count > 0, spread, np.nan), dtype=np.float64)
        return ResidualMap(
            x_edges,
            y_edges if rest else None,
            np.asarray(mean, dtype=np.float64),
            filled,
            np.asarray(count, dtype=np.float64),
        )

    def compute_spectrum(self, joint: str, over: Literal["angle", "time"]) -> JointSpectrum:
        """Compute the amplitude spectrum of a joint's residual, over time or over the joint's own position.

        Parameters
        ----------
        joint : str
            Name of the joint.
        over : {"angle", "time"}
            What the residual is a function of.
        """
        # The file has no kinds of joints; the unit of the torque tells them.
        revolute = self.get_unit(joint) == "N m"
        t, segment, q, dq = self._read("t", "segment", f"q_{joint}", f"dq_{joint}")
        residual = self._read_residual(joint)
        if over == "time":
            residual_spectrum = time_spectrum(t, segment, residual)
            return JointSpectrum(residual_spectrum, "Hz", _list_peaks(residual_spectrum, None))
        residual_spectrum = angle_spectrum(q, dq, residual, HIGHEST_IN_A_RADIAN if revolute else HIGHEST_IN_A_METRE)
        if revolute:
            return JointSpectrum(residual_spectrum, "cycles/rad", _list_peaks(residual_spectrum, 2.0 * np.pi))
        return JointSpectrum(residual_spectrum, "cycles/m", _list_peaks(residual_spectrum, None))

    def compute_autocorrelation(self, joint: str, longest: float) -> Autocorrelation:
        """Compute the autocorrelation of a joint's residual up to a lag in s.

        Parameters
        ----------
        joint : str
            Name of the joint.
        longest : float
            Longest lag, s.
        """
        self._find_joint(joint)
        t, segment = self._read("t", "segment")
        return autocorrelation(t, segment, self._read_residual(joint), longest)

    def _read_residual(self, joint: str) -> FloatArray:
        """Return (m,): measured minus predicted; at standstill the distance to the band of static friction."""
        measured, predicted = self._read(f"measured_{joint}", f"predicted_{joint}")
        return self._read_band_at_standstill(joint, measured, predicted)[0]

    def _read_band_at_standstill(
        self, joint: str, measured: FloatArray, predicted: FloatArray, groups: list[int] | None = None
    ) -> tuple[FloatArray, ...]:
        """Return residual, lower, upper and phase (m,) each; files of older versions have no band at standstill."""
        if f"phase_{joint}" not in self._file.schema_arrow.names:
            return measured - predicted, predicted, predicted, np.zeros(len(measured))
        columns = (f"{signal}_{joint}" for signal in ("residual", "lower", "upper", "phase"))
        return tuple(self._read(*columns, groups=groups))

    def _find_row_groups(self, start: float | None, end: float | None) -> list[int] | None:
        """Return the row groups that may hold a time from `start` to `end`; None for all of them."""
        if start is None and end is None:
            return None
        metadata = self._file.metadata
        column = self._file.schema_arrow.names.index("t")
        # Parquet stores the extremes of a column by row group: groups outside of the times are not read at all.
        times = [metadata.row_group(k).column(column).statistics for k in range(metadata.num_row_groups)]
        return [
            k
            for k, statistics in enumerate(times)
            if statistics is None
            or ((end is None or statistics.min <= end) and (start is None or statistics.max >= start))
        ]

    def _read(self, *columns: str, groups: list[int] | None = None) -> list[FloatArray]:
        # Each column is read once, even if a caller names it twice.
        names = sorted(set(columns))
        table = self._file.read(names) if groups is None else self._file.read_row_groups(groups, names)
        return [table_column_to_floats(table[name]) for name in columns]

    def _find_joint(self, joint: str) -> int:
        if joint not in self.joint_names:
            detail = describe_missing_joint(joint, self.joint_names)
            raise DynidentError(detail, pointer="joint", title="Unknown joint")
        return self.joint_names.index(joint)

    def _find_column(self, name: str, pointer: str) -> str:
        kind, _, joint = name.partition("_")
        stored = {"q": "q", "dq": "dq", "ddq": "ddq", "load": "load", "tau": "measured"}
        if f"temperature_{self.joint_names[0]}" in self._file.schema_arrow.names:
            stored["temperature"] = "temperature"
        if name in ("t", "time"):
            return "t"
        if kind in stored and joint in self.joint_names:
            return f"{stored[kind]}_{joint}"
        detail = (
            f"there is no signal {name!r}; there are t, and {', '.join(f'{prefix}_' for prefix in stored)} followed "
            f"by one of: {', '.join(self.joint_names)}"
        )
        raise DynidentError(detail, pointer=pointer, title="Unknown signal")


def _list_peaks(spectrum: ResidualSpectrum, turn: float | None) -> tuple[SpectralPeak, ...]:
    return tuple(
        SpectralPeak(frequency, float(spectrum.amplitude[k]), None if turn is None else turn * frequency)
        for k in spectrum.list_highest_peaks()
        for frequency in [float(spectrum.frequency[k])]
    )
