"""Comparisons kept in a Parquet file, a column for each signal of each joint, and what is read out of them."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow.parquet as pq
from scipy.stats import binned_statistic_2d

from dynident.arrays import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.comparing.autocorrelation import Autocorrelation, autocorrelation
from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.comparing.spectrum import (
    HIGHEST_IN_A_METRE,
    HIGHEST_IN_A_RADIAN,
    ResidualSpectrum,
    angle_spectrum,
    time_spectrum,
)
from dynident.errors import DynidentError
from dynident.recordings.arrow import as_floats, named_columns
from dynident.recordings.phases import Phase

SIGNALS = ("measured", "predicted", "lower", "upper", "residual", "phase", "deviation", "q", "dq", "ddq", "load")
METADATA_KEY = b"dynident.comparison"
ROW_GROUP = 1 << 16
"""Rows that are read at least: what is asked of a long recording is mostly a short stretch of it."""
_NORMAL_95 = 1.96


@dataclass(frozen=True, eq=False)
class JointSignals:
    """One joint's signals (m,) each: t in s, torques in N m or N, q in rad or m, dq and ddq per s and s^2.

    `residual` is measured minus predicted; where the joint stands, the distance to `lower` or `upper`, which static
    friction may hold, zero between. `band`: half-width of the 95 % band of the residual.
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

    def rows(self, chosen: BoolArray | IndexArray) -> JointSignals:
        """Some of the rows."""
        return replace(self, **{one.name: getattr(self, one.name)[chosen] for one in fields(self)})


@dataclass(frozen=True, eq=False)
class ResidualMap:
    """A joint's residual in bins of one or two signals: `mean` and `spread` (a, b), nan where a bin is empty, `count`.

    `x_edges` (a + 1,); `y_edges` (b + 1,), none over one signal, where b is 1.
    """

    x_edges: FloatArray
    y_edges: FloatArray | None
    mean: FloatArray
    spread: FloatArray
    count: FloatArray


@dataclass(frozen=True)
class SpectralPeak:
    """A line in a spectrum; `per_turn` in cycles in a turn of the joint, none over time and for a linear joint."""

    frequency: float
    amplitude: float
    per_turn: float | None


@dataclass(frozen=True, eq=False)
class JointSpectrum:
    """Amplitude spectrum of a joint's residual over time or its own position, and its highest peaks."""

    spectrum: ResidualSpectrum
    frequency_unit: Literal["Hz", "cycles/rad", "cycles/m"]
    peaks: tuple[SpectralPeak, ...]


def write_comparison(found: Comparison, path: Path) -> Path:
    """Write the signals of a comparison, a column for each signal of each joint."""
    columns: dict[str, FloatArray] = {"t": found.t, "segment": found.segment}
    signals = {signal: getattr(found, signal) for signal in SIGNALS}
    if found.temperature is not None:
        signals["temperature"] = found.temperature
    for signal, values in signals.items():
        for index, joint in enumerate(found.joint_names):
            columns[f"{signal}_{joint}"] = values[:, index]
    header = {"joint_names": found.joint_names, "units": found.units, "noise": found.noise.tolist()}
    table = named_columns(columns).replace_schema_metadata({METADATA_KEY: json.dumps(header).encode()})
    # Measured numbers hardly ever come twice: dictionaries of them take six times as long, and more room.
    pq.write_table(table, path, row_group_size=ROW_GROUP, use_dictionary=False)
    return path


class StoredComparison:
    """The signals of a comparison in a file, read as they are asked for.

    All that it is asked for of a joint raises `DynidentError` where there is no joint of that name.
    """

    def __init__(self, path: Path) -> None:
        self._file = pq.ParquetFile(path)
        header = json.loads(self._file.schema_arrow.metadata[METADATA_KEY])
        self.joint_names: list[str] = header["joint_names"]
        self._units: list[str] = header["units"]
        self._noise: list[float] = header["noise"]

    def unit(self, joint: str) -> str:
        """The unit of a joint's torques."""
        return self._units[self._index(joint)]

    def signals(self, joint: str, start: float | None = None, end: float | None = None) -> JointSignals:
        """Give one joint's signals between two times in s."""
        index = self._index(joint)
        groups = self._groups_of(start, end)
        t, segment, measured, predicted, deviation, q, dq, ddq, load = self._read(
            "t",
            "segment",
            *(f"{signal}_{joint}" for signal in ("measured", "predicted", "deviation", "q", "dq", "ddq", "load")),
            groups=groups,
        )
        residual, lower, upper, phase = self._at_rest(joint, measured, predicted, groups)
        band = _NORMAL_95 * np.sqrt(deviation**2 + self._noise[index] ** 2)
        standing = phase == Phase.STANDING
        every = JointSignals(t, segment, measured, predicted, lower, upper, standing, residual, band, q, dq, ddq, load)
        return every.rows((t >= (-np.inf if start is None else start)) & (t <= (np.inf if end is None else end)))

    def residual_map(self, joint: str, x: str, y: str | None, bins: int) -> ResidualMap:
        """Bin a joint's residual over one or two signals; `DynidentError` for a signal that there is not."""
        self._index(joint)
        names = [x] if y is None else [x, y]
        columns = [self._column(name, pointer) for name, pointer in zip(names, ("x", "y"), strict=False)]
        over_x, *rest = self._read(*columns)
        residual = self._residual(joint)
        over_y = rest[0] if rest else np.zeros_like(over_x)
        numbers_of_bins = [bins, bins if rest else 1]
        mean, x_edges, y_edges, _ = binned_statistic_2d(over_x, over_y, residual, "mean", numbers_of_bins)
        spread, *_ = binned_statistic_2d(over_x, over_y, residual, "std", numbers_of_bins)
        count, *_ = binned_statistic_2d(over_x, over_y, residual, "count", numbers_of_bins)
        filled = np.asarray(np.where(count > 0, spread, np.nan), dtype=np.float64)
        return ResidualMap(
            x_edges,
            y_edges if rest else None,
            np.asarray(mean, dtype=np.float64),
            filled,
            np.asarray(count, dtype=np.float64),
        )

    def spectrum(self, joint: str, over: Literal["angle", "time"]) -> JointSpectrum:
        """Give the amplitude spectrum of a joint's residual, over time or over the joint's own position."""
        revolute = self.unit(joint) == "N m"
        t, segment, q, dq = self._read("t", "segment", f"q_{joint}", f"dq_{joint}")
        residual = self._residual(joint)
        if over == "time":
            found = time_spectrum(t, segment, residual)
            return JointSpectrum(found, "Hz", _peaks(found, None))
        found = angle_spectrum(q, dq, residual, HIGHEST_IN_A_RADIAN if revolute else HIGHEST_IN_A_METRE)
        if revolute:
            return JointSpectrum(found, "cycles/rad", _peaks(found, 2.0 * np.pi))
        return JointSpectrum(found, "cycles/m", _peaks(found, None))

    def autocorrelation(self, joint: str, longest: float) -> Autocorrelation:
        """Give the autocorrelation of a joint's residual up to a lag in s."""
        self._index(joint)
        t, segment = self._read("t", "segment")
        return autocorrelation(t, segment, self._residual(joint), longest)

    def _residual(self, joint: str) -> FloatArray:
        """(m,): measured minus predicted; where the joint stands, the distance to what static friction may hold."""
        measured, predicted = self._read(f"measured_{joint}", f"predicted_{joint}")
        return self._at_rest(joint, measured, predicted)[0]

    def _at_rest(
        self, joint: str, measured: FloatArray, predicted: FloatArray, groups: list[int] | None = None
    ) -> tuple[FloatArray, ...]:
        """Give residual, lower, upper and phase (m,) each; files of older versions know nothing of rest."""
        if f"phase_{joint}" not in self._file.schema_arrow.names:
            return measured - predicted, predicted, predicted, np.zeros(len(measured))
        columns = (f"{signal}_{joint}" for signal in ("residual", "lower", "upper", "phase"))
        return tuple(self._read(*columns, groups=groups))

    def _groups_of(self, start: float | None, end: float | None) -> list[int] | None:
        """Groups of rows in which a time from `start` to `end` may be; None for all of them."""
        if start is None and end is None:
            return None
        known = self._file.metadata
        column = self._file.schema_arrow.names.index("t")
        times = [known.row_group(k).column(column).statistics for k in range(known.num_row_groups)]
        return [
            k
            for k, one in enumerate(times)
            if one is None or ((end is None or one.min <= end) and (start is None or one.max >= start))
        ]

    def _read(self, *columns: str, groups: list[int] | None = None) -> list[FloatArray]:
        wanted = sorted(set(columns))
        table = self._file.read(wanted) if groups is None else self._file.read_row_groups(groups, wanted)
        return [as_floats(table[name]) for name in columns]

    def _index(self, joint: str) -> int:
        if joint not in self.joint_names:
            detail = f"there is no joint {joint!r}; there are: {', '.join(self.joint_names)}"
            raise DynidentError(detail, pointer="joint", title="Unknown joint")
        return self.joint_names.index(joint)

    def _column(self, name: str, pointer: str) -> str:
        kind, _, joint = name.partition("_")
        stored = {"q": "q", "dq": "dq", "ddq": "ddq", "load": "load", "tau": "measured"}
        if f"temperature_{self.joint_names[0]}" in self._file.schema_arrow.names:
            stored["temperature"] = "temperature"
        if name in ("t", "time"):
            return "t"
        if kind in stored and joint in self.joint_names:
            return f"{stored[kind]}_{joint}"
        detail = (
            f"there is no signal {name!r}; there are t, and {', '.join(f'{one}_' for one in stored)} followed by one "
            f"of: {', '.join(self.joint_names)}"
        )
        raise DynidentError(detail, pointer=pointer, title="Unknown signal")


def _peaks(found: ResidualSpectrum, turn: float | None) -> tuple[SpectralPeak, ...]:
    return tuple(
        SpectralPeak(frequency, float(found.amplitude[k]), None if turn is None else turn * frequency)
        for k in found.peaks()
        for frequency in [float(found.frequency[k])]
    )
