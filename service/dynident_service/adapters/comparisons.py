"""Comparisons between the contract and the science."""

from __future__ import annotations

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IndexArray
from dynident.diagnosis import Comparison, Judgement
from dynident.diagnosis.comparing.stored import JointSignals
from dynident.recordings.phases import Phase, PhaseArray
from dynident_service.adapters.answers import show_figures, shown
from dynident_service.models import comparisons as wire
from dynident_service.models.measurements import PhasesView


def describe_comparison(comparison: Comparison, judgement: Judgement, held_out: bool | None) -> wire.ComparisonResult:
    """Describe a comparison for the wire; `held_out` None where nobody knows."""
    phases = PhasesView(
        standing=_share(comparison.phase, Phase.STANDING),
        reversing=_share(comparison.phase, Phase.REVERSING, Phase.PASSIVE_HALT),
    )
    return shown(
        wire.ComparisonResult,
        comparison,
        n_samples=len(comparison.t),
        start_time=float(comparison.t[0]),
        end_time=float(comparison.t[-1]),
        phases=phases,
        held_out=held_out,
        **dict(show_figures(comparison.errors)),
        **dict(shown(wire.Judgement, judgement, repetition=judgement.noise if judgement.noise.period > 0 else None)),
    )


def thinned(joint_signals: JointSignals, points: int) -> JointSignals:
    """About so many samples whose lines look like those of all samples: the extremes of every signal among them.

    Where a stretch in which the joint is standing begins and ends is among them, too, as long as there are few.
    """
    signals = (joint_signals.measured, joint_signals.lower, joint_signals.upper, joint_signals.residual)
    return (
        joint_signals.rows(_chosen(points, joint_signals.standing, *signals))
        if len(joint_signals.t) > points
        else joint_signals
    )


def _chosen(points: int, standing: BoolArray, *signals: FloatArray) -> IndexArray:
    changes = np.flatnonzero(np.diff(standing))
    edges = np.concatenate([changes, changes + 1]) if 2 * len(changes) <= points // 2 else np.empty(0, dtype=np.intp)
    share = max(4, (points - len(edges)) // len(signals))
    # Of [service] alone; `dynident compare` thins nothing.
    from tsdownsample import MinMaxLTTBDownsampler

    picked = [MinMaxLTTBDownsampler().downsample(np.ascontiguousarray(signal), n_out=share) for signal in signals]
    return np.unique(np.concatenate([edges, *picked])).astype(np.intp)


def _share(phases: PhaseArray, *wanted: Phase) -> list[float]:
    """Share of every joint's rows that are of some phases."""
    return [float(share) for share in np.isin(phases, wanted).mean(axis=0)]
