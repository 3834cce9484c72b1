"""Views of comparisons, and signals thinned for plots."""

from __future__ import annotations

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis import Comparison, Judgement
from dynident.diagnosis.comparison.comparison_files import JointSignals
from dynident.diagnosis.comparison.measured_against_predicted import WorstInterval
from dynident.presentation.model_tables import ErrorKind, build_comparison_table, build_worst_table
from dynident.recordings.joint_phases import Phase, PhaseArray
from dynident_service.comparisons import wire_types as wire
from dynident_service.measurements.wire_types import PhasesView
from dynident_service.shared.field_by_field import from_view, show_figures, show_tables, to_view
from dynident_service.shared.wire_types import Table


def describe_comparison(comparison: Comparison, judgement: Judgement, held_out: bool | None) -> wire.ComparisonResult:
    """Build the view of a comparison and its judgement; `held_out` is None where that is unknown."""
    phases = PhasesView(
        standing=_phase_share(comparison.phase, Phase.STANDING),
        reversing=_phase_share(comparison.phase, Phase.REVERSING, Phase.PASSIVE_HALT),
    )
    return to_view(
        wire.ComparisonResult,
        comparison,
        n_samples=len(comparison.t),
        start_time=float(comparison.t[0]),
        end_time=float(comparison.t[-1]),
        phases=phases,
        held_out=held_out,
        **dict(show_figures(comparison.errors)),
        **dict(to_view(wire.Judgement, judgement, repetition=judgement.noise if judgement.noise.period > 0 else None)),
    )


def build_tables(result: wire.ComparisonResult) -> list[Table]:
    """Build the tables of a stored comparison: the worst intervals, and the errors beside the noise if it is known."""
    worst = [from_view(WorstInterval, interval) for interval in result.worst]
    tables = [build_worst_table(worst, result.joints, result.effort_units)] if worst else []
    # Comparisons of an earlier version do not hold the noise.
    if result.noise_floor:
        errors = ErrorKind("", result.moving or result, result)
        floor, samples, count = result.noise_floor, result.effective_samples, result.n_samples
        joints, units = result.joints, result.effort_units
        tables.insert(0, build_comparison_table("this measurement", errors, joints, units, floor, samples, count))
    return show_tables(tables)


def thin_signals(joint_signals: JointSignals, points: int) -> JointSignals:
    """Thin one joint's signals to about so many points for a plot.

    The lines look like those of all samples: the extremes of every signal are kept, and the ends of standstills as
    long as those are few.
    """
    signals = (joint_signals.measured, joint_signals.lower, joint_signals.upper, joint_signals.residual)
    return (
        joint_signals.select_rows(_select_rows(points, joint_signals.standing, *signals))
        if len(joint_signals.t) > points
        else joint_signals
    )


def _select_rows(points: int, standing: BoolArray, *signals: FloatArray) -> IndexArray:
    changes = np.flatnonzero(np.diff(standing))
    # Ends of standstills get at most half of the points; a joint that creeps has more of them than a plot can show.
    edges = np.concatenate([changes, changes + 1]) if 2 * len(changes) <= points // 2 else np.empty(0, dtype=np.intp)
    # The downsampler takes an even share of points a signal, and at least its first, last, least and greatest.
    share = max(4, (points - len(edges)) // len(signals))
    # Imported here: the package comes with the extra "service" only, and the command line thins nothing.
    from tsdownsample import MinMaxLTTBDownsampler

    selected = [MinMaxLTTBDownsampler().downsample(np.ascontiguousarray(signal), n_out=share) for signal in signals]
    # Signals share their times, so every row that one of them needs is kept for all.
    return np.unique(np.concatenate([edges, *selected])).astype(np.intp)


def _phase_share(phases: PhaseArray, *wanted: Phase) -> list[float]:
    """Return the share of rows that are in the given phases, per joint."""
    return [float(share) for share in np.isin(phases, wanted).mean(axis=0)]
