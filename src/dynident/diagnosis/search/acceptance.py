"""What a candidate needs beside the gate: a gain above the sensor's noise, a larger one where sticking looks alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.diagnosis.candidates.gate import (
    SMALLEST_DROP_OF_STICKING,
    SMALLEST_GAIN_AT_REVERSALS,
    SMALLEST_GAIN_OVER_NOISE,
    Judged,
)
from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate
from dynident.diagnosis.search.state import Finding, State
from dynident.effects import Effect, EffectChoice, effect_by_id
from dynident.robot.model import FloatArray

VISIBLE = 0.02
"""Share of a column that has to be left beside the model for the data to show its effect at all."""

# A sensitivity of which so little is left beside the model reaches far beyond the data: it has to gain much.
_BLURRED, _DROP_OF_BLURRED = 0.2, 0.25
# Times the smallest slip distance that is looked for.
_HARDLY = 2.01
# What each joint of a group needs for itself.
_JOINT_DROP, _JOINT_DROP_OF_STICKING = 0.03, 0.08
JOINT_T = 2.0
"""t of the gain of a joint of a group."""
LARGE_DROP, JOINT_T_OF_LARGE = 0.3, 1.5
"""Where it gains this share of its error, a smaller t will do."""


def acceptable(state: State, data: PhasedProducts, item: Judged) -> bool:
    """Whether a candidate is a finding."""
    effect = effect_by_id(item.candidate.effect)
    if item.separability < VISIBLE or not item.passes:
        return False
    resolved = [spec for spec in effect.shapes if spec.resolved_by is not None]
    if max(gain_over_floor(item, j, state.floor, data) for j in item.joints) < least_gain(effect):
        return False
    beside = {
        f.judged.candidate.effect for f in state.picks if set(f.judged.candidate.joints) & set(item.candidate.joints)
    }
    if resolved and beside & set(effect.confused_with) and item.total_drop < SMALLEST_DROP_OF_STICKING:
        return False
    if effect.first_order and item.separability < _BLURRED and item.drop < _DROP_OF_BLURRED:
        return False
    return not may_be_sticking(item)


def hardly_resolved(candidate: Candidate) -> bool:
    """Whether a slip distance is so small that a joint which sticks for a moment would look like it."""
    resolved = [s for s in effect_by_id(candidate.effect).shapes if s.resolved_by is not None and s.least > 0]
    return any(dict(candidate.shape)[spec.name] <= _HARDLY * spec.least for spec in resolved)


def sticks(finding: Finding, refined: EffectChoice) -> bool:
    """Whether a finding, with its slip distance refined, may well be a joint that sticks for a moment."""
    judged = finding.judged
    return may_be_sticking(replace(judged, candidate=replace(judged.candidate, shape=refined.shape)))


def may_be_sticking(item: Judged) -> bool:
    """Whether a slip distance is hardly resolved, and gains no more than a joint that sticks for a moment would."""
    return hardly_resolved(item.candidate) and item.total_drop < SMALLEST_DROP_OF_STICKING


def least_drop(candidate: Candidate) -> float:
    """Share of its own error that a joint of a group has to gain."""
    return _JOINT_DROP_OF_STICKING if hardly_resolved(candidate) else _JOINT_DROP


def least_gain(effect: Effect) -> float:
    """Share of the sensor noise's power that an effect has to remove."""
    at_reversals = any(spec.resolved_by is not None for spec in effect.shapes)
    return SMALLEST_GAIN_AT_REVERSALS if at_reversals else SMALLEST_GAIN_OVER_NOISE


def gain_over_floor(item: Judged, joint: int, floor: FloatArray, data: PhasedProducts) -> float:
    """Squared error that a candidate removes on a joint, over that of the sensor's noise."""
    removed = float((item.before - item.after)[:, joint].sum()) / max(
        float(data.of(item.candidate.columns).counts[:, joint].sum()), 1.0
    )
    return removed / max(float(floor[joint]) ** 2, np.finfo(float).tiny)
