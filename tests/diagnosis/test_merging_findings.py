"""Two findings over one joint's position become one where a single curve says as much; not where they are two."""

from __future__ import annotations

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, ROBOT, on_joint, recorded
from support.oracles import fourier_motion

from dynident.diagnosis.candidates.candidate_pool import build_pool_of_choices
from dynident.diagnosis.search import forward_selection
from dynident.diagnosis.search.finding_refinement import RecordedSource
from dynident.diagnosis.search.forward_selection import merge_findings_on_joint
from dynident.diagnosis.search.search_state import Finding, State, score_all
from dynident.effects import EffectChoice, get_effect
from dynident.identification import IdentificationChoices, identify
from dynident.regressors.observation_matrix import RegressorInputs

JOINT = (NAMES[1],)


def balancer(q, v, load):
    x = q + 0.9
    return 40.0 * np.sin(x) * (1.0 - 0.6 / np.sqrt(1.0 + 0.25**2 + 0.5 * np.cos(x)))


def offset_and_ripple(q, v, load):
    return 3.0 + 1.5 * np.sin(12.0 * q + 0.3)


def find_offset_and_wave(hidden, k: float, curves: list[EffectChoice]) -> tuple[RecordedSource, State]:
    """Return the state with an offset and a wave as findings, and these curves over the position as candidates."""
    motion = fourier_motion(ROBOT, 40.0, 200.0, 311, base_frequency=0.1, harmonics=4, amplitude=1.2, fastest=1.5)
    recording = recorded(motion, on_joint(1, hidden), 3, "curves")
    model = identify(ROBOT, [recording], [], IdentificationChoices(preprocessing=BAND))
    two = [EffectChoice("offset", JOINT), EffectChoice("torque_ripple", JOINT, (("k", k),))]
    pool = build_pool_of_choices(model.model, [*two, *curves])
    rows = RecordedSource(
        model.model, RegressorInputs((recording,), model.preprocessing, model.estimate.next_reference())
    )
    base, floor = tuple(range(pool.n_base)), np.full(6, 0.05)
    state = State(rows.gather_products(pool), pool, base, floor, floor).estimate_noise()
    for choice in two:
        (judged,) = score_all(state, [pool.find_candidate(choice)])
        state = state.add_finding(Finding(judged, (), 1e-4))
    return rows, state


@pytest.mark.parametrize(
    ("hidden", "k", "names"),
    [
        (balancer, 2.0, ["gravity_compensator"]),
        (offset_and_ripple, 12.0, ["offset", "torque_ripple"]),
    ],
)
def test_of_an_offset_and_a_wave_one_spring_remains_where_it_says_both(hidden, k, names):
    grid = [tuple(sorted(shape.items())) for shape in get_effect("gravity_compensator").grid(ROBOT, 1)]
    curves = [EffectChoice("gravity_compensator", JOINT, shape) for shape in grid]
    rows, state = find_offset_and_wave(hidden, k, curves)
    base = range(state.pool.n_base)
    after = merge_findings_on_joint(rows, state)
    assert [finding.judged.candidate.effect for finding in after.findings] == names
    assert set(after.base) == {*base, *(k for finding in after.findings for k in finding.columns)}


def test_one_curve_in_place_of_two_findings_has_the_others_that_explain_as_much_as_equals(monkeypatch):
    curves = [EffectChoice("joint_spring", JOINT), EffectChoice("position_dependent_friction", JOINT, (("k", 2.0),))]
    rows, state = find_offset_and_wave(balancer, 2.0, curves)
    monkeypatch.setattr(forward_selection, "explains_as_much", lambda slim, other: True)
    (found,) = merge_findings_on_joint(rows, state).findings
    names = [found.judged.candidate.effect, *(scored.candidate.effect for scored in found.equal)]
    assert len(names) > 1
    assert len(set(names)) == len(names)
    # They are candidates of the search's own pool, as the finding is.
    assert all(scored.candidate in state.pool.candidates for scored in (found.judged, *found.equal))
