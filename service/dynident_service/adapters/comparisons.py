"""Comparisons between the contract and the science: their figures, and their signals as a Parquet file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.stats import binned_statistic_2d
from tsdownsample import MinMaxLTTBDownsampler

from dynident.arrays import FloatArray
from dynident.diagnosis import Comparison, Judgement, ResidualSpectrum, angle_spectrum, autocorrelation, time_spectrum
from dynident.diagnosis.comparing.spectrum import HIGHEST_IN_A_METRE, HIGHEST_IN_A_RADIAN
from dynident.errors import DynidentError
from dynident.recordings.phases import Phase, PhaseArray
from dynident_service.adapters.identifications import finite, numbers, show_figures
from dynident_service.models import comparisons as wire
from dynident_service.models.measurements import PhasesView

SIGNALS = ("measured", "predicted", "lower", "upper", "residual", "phase", "deviation", "q", "dq", "ddq", "load")
METADATA_KEY = b"dynident.comparison"
ROW_GROUP = 1 << 16
"""Rows that are read at least: what is asked of a long recording is mostly a short stretch of it."""


def describe_comparison(found: Comparison, judged: Judgement, held_out: bool | None) -> wire.ComparisonResult:
    """Describe a comparison for the wire; `held_out` None where nobody knows."""
    noise, fit = judged.noise, judged.noise.lack_of_fit
    return wire.ComparisonResult(
        joints=list(found.joint_names),
        effort_units=list(found.units),
        n_samples=len(found.t),
        start_time=float(found.t[0]),
        end_time=float(found.t[-1]),
        rms=numbers(found.errors.rms),
        relative=numbers(found.errors.relative),
        relative_total=finite(found.errors.relative_total),
        moving=show_figures(found.moving_errors),
        raw=show_figures(found.raw_errors),
        phases=PhasesView(standing=_share(found.phase, Phase.STANDING), reversing=_share(found.phase, Phase.REVERSING)),
        worst=[
            wire.WorstStretch.model_validate(
                {
                    "joint": one.joint,
                    "from": one.start,
                    "to": one.end,
                    "rms": one.rms,
                    "ratio": one.ratio,
                    "time": one.time,
                    "pose": list(one.pose),
                    "speed": list(one.speed),
                }
            )
            for one in found.worst
        ],
        held_out=held_out,
        noise_floor=numbers(noise.values),
        noise_source=noise.source,
        over_noise=numbers(judged.over_noise),
        effective_samples=numbers(judged.effective_samples),
        repetition=wire.Repetition(period=noise.period, repetitions=noise.repetitions) if noise.period > 0 else None,
        lack_of_fit=None if fit is None else wire.LackOfFit(f=numbers(fit.f), p_value=numbers(fit.p_value)),
        repeated_motion=None
        if judged.repeated is None
        else wire.RepeatedMotion(measurement=judged.repeated.name, share=judged.repeated.share),
        notes=list(judged.notes),
    )


def write_comparison(found: Comparison, path: Path) -> Path:
    """Write the signals of a comparison, a column for each signal of each joint."""
    columns: dict[str, FloatArray] = {"t": found.t, "segment": found.segment}
    signals = {signal: getattr(found, signal) for signal in SIGNALS}
    if found.temperature is not None:
        signals["temperature"] = found.temperature
    for signal, values in signals.items():
        for index, joint in enumerate(found.joint_names):
            columns[f"{signal}_{joint}"] = np.ascontiguousarray(values[:, index])
    header = {"joint_names": found.joint_names, "units": found.units, "noise": found.noise.tolist()}
    table = pa.table(columns).replace_schema_metadata({METADATA_KEY: json.dumps(header).encode()})
    # Measured numbers hardly ever come twice: dictionaries of them take six times as long, and more room.
    pq.write_table(table, path, row_group_size=ROW_GROUP, use_dictionary=False)
    return path


class StoredComparison:
    """The signals of a comparison in a file, read as they are asked for."""

    def __init__(self, path: Path) -> None:
        self._file = pq.ParquetFile(path)
        header = json.loads(self._file.schema_arrow.metadata[METADATA_KEY])
        self.joint_names: list[str] = header["joint_names"]
        self._units: list[str] = header["units"]
        self._noise: list[float] = header["noise"]

    def series(self, joint: str, start: float | None, end: float | None, points: int) -> wire.Series:
        """Give one joint's signals between two times, thinned to about so many points with their extremes kept."""
        index = self._index(joint)
        groups = self._groups_of(start, end)
        t, segment, measured, predicted, deviation, q, dq, ddq, load = self._read(
            "t",
            "segment",
            *(f"{signal}_{joint}" for signal in ("measured", "predicted", "deviation", "q", "dq", "ddq", "load")),
            groups=groups,
        )
        residual, lower, upper, phase = self._at_rest(joint, measured, predicted, groups)
        inside = np.flatnonzero((t >= (-np.inf if start is None else start)) & (t <= (np.inf if end is None else end)))
        standing = phase == Phase.STANDING
        shown = inside[
            _thinned(points, standing[inside], measured[inside], lower[inside], upper[inside], residual[inside])
        ]
        band = 1.96 * np.sqrt(deviation**2 + self._noise[index] ** 2)
        return wire.Series(
            joint=joint,
            effort_unit=self._units[index],
            n_samples=len(inside),
            t=t[shown].tolist(),
            segment=segment[shown].astype(int).tolist(),
            measured=measured[shown].tolist(),
            predicted=predicted[shown].tolist(),
            lower=lower[shown].tolist(),
            upper=upper[shown].tolist(),
            standing=standing[shown].tolist(),
            residual=residual[shown].tolist(),
            band=band[shown].tolist(),
            q=q[shown].tolist(),
            dq=dq[shown].tolist(),
            ddq=ddq[shown].tolist(),
            load=load[shown].tolist(),
        )

    def residual_map(self, joint: str, x: str, y: str | None, bins: int) -> wire.ResidualMap:
        """Bin a joint's residual over one or two signals."""
        index = self._index(joint)
        names = [x] if y is None else [x, y]
        columns = [self._column(name, pointer) for name, pointer in zip(names, ("x", "y"), strict=False)]
        over_x, *rest = self._read(*columns)
        residual = self._residual(joint)
        over_y = rest[0] if rest else np.zeros_like(over_x)
        numbers_of_bins = [bins, bins if rest else 1]
        mean, x_edges, y_edges, _ = binned_statistic_2d(over_x, over_y, residual, "mean", numbers_of_bins)
        spread, *_ = binned_statistic_2d(over_x, over_y, residual, "std", numbers_of_bins)
        count, *_ = binned_statistic_2d(over_x, over_y, residual, "count", numbers_of_bins)
        return wire.ResidualMap(
            joint=joint,
            effort_unit=self._units[index],
            x=x,
            y=y,
            x_edges=x_edges.tolist(),
            y_edges=y_edges.tolist() if rest else None,
            mean=[numbers(row) for row in np.asarray(mean, dtype=np.float64)],
            spread=[numbers(np.where(filled > 0, row, np.nan)) for row, filled in zip(spread, count, strict=True)],
            count=count.astype(int).tolist(),
        )

    def spectrum(self, joint: str, over: Literal["angle", "time"]) -> wire.Spectrum:
        """Give the amplitude spectrum of a joint's residual, over time or over the joint's own position."""
        unit = self._units[self._index(joint)]
        t, segment, q, dq = self._read("t", "segment", f"q_{joint}", f"dq_{joint}")
        residual = self._residual(joint)
        revolute = unit == "N m"
        if over == "time":
            found, frequency_unit, turn = time_spectrum(t, segment, residual), "Hz", None
        else:
            found = angle_spectrum(q, dq, residual, HIGHEST_IN_A_RADIAN if revolute else HIGHEST_IN_A_METRE)
            frequency_unit, turn = ("cycles/rad", 2.0 * np.pi) if revolute else ("cycles/m", None)
        return wire.Spectrum.model_validate(
            {
                "joint": joint,
                "effort_unit": unit,
                "over": over,
                "frequency_unit": frequency_unit,
                "frequency": found.frequency.tolist(),
                "amplitude": found.amplitude.tolist(),
                "resolution": found.resolution,
                "peaks": _peaks(found, turn),
            }
        )

    def autocorrelation(self, joint: str, longest: float) -> wire.AutocorrelationView:
        """Give the autocorrelation of a joint's residual up to a lag in s."""
        self._index(joint)
        t, segment = self._read("t", "segment")
        found = autocorrelation(t, segment, self._residual(joint), longest)
        return wire.AutocorrelationView(
            joint=joint,
            lag=found.lag.tolist(),
            value=found.value.tolist(),
            limit=found.limit,
            n_samples=found.n_samples,
            effective_samples=found.effective_samples,
        )

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
        return [table[name].to_numpy() for name in columns]

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


def _peaks(found: ResidualSpectrum, turn: float | None) -> list[wire.SpectralPeak]:
    return [
        wire.SpectralPeak(
            frequency=float(found.frequency[k]),
            amplitude=float(found.amplitude[k]),
            per_turn=None if turn is None else turn * float(found.frequency[k]),
        )
        for k in found.peaks()
    ]


def _thinned(points: int, standing: NDArray[np.bool_], *signals: FloatArray) -> NDArray[np.intp]:
    """Indices of samples whose lines look like those of all samples: the extremes of every signal among them.

    Where a stretch in which the joint is `standing` begins and ends is among them, too, as long as there are few.
    """
    count = len(signals[0])
    if count <= points:
        return np.arange(count)
    changes = np.flatnonzero(np.diff(standing))
    edges = np.concatenate([changes, changes + 1]) if 2 * len(changes) <= points // 2 else np.empty(0, dtype=np.intp)
    share = max(4, (points - len(edges)) // len(signals))
    picked = [MinMaxLTTBDownsampler().downsample(np.ascontiguousarray(one), n_out=share) for one in signals]
    return np.unique(np.concatenate([edges, *picked])).astype(np.intp)


def _share(phases: PhaseArray, phase: Phase) -> list[float]:
    """Share of every joint's rows that are of a phase."""
    return [float(share) for share in (phases == phase).mean(axis=0)]
