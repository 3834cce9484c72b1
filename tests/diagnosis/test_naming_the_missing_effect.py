"""One effect that the model lacks is named, on the right joint, and adding it leaves the noise alone."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from support.hidden_effects import (
    BAND,
    CASES,
    NAMES,
    NOISE,
    PLAIN,
    ROBOT,
    WITH_OFFSET,
    Case,
    Experiment,
    experiment,
    floor,
    hysteresis,
    nothing,
    on_joint,
    recorded,
)
from support.oracles import fourier_motion

from dynident.advice import advise
from dynident.diagnosis import Diagnosis, DiagnosisChoices, compare, diagnose, diagnose_model, examine
from dynident.diagnosis.candidates.candidate_pool import Candidate, build_pool, build_pool_of_choices
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.residuals.resolution_at_reversals import compute_resolution
from dynident.diagnosis.residuals.shape_proposals import ShapeProposals
from dynident.diagnosis.residuals.spectral_peaks import AngleLines, find_angle_lines
from dynident.diagnosis.search import forward_selection
from dynident.diagnosis.search.comparison_of_rivals import name_findings
from dynident.diagnosis.search.finding_refinement import RecordedSource, refine_constants, refine_findings
from dynident.diagnosis.search.identifiability_and_invisible_effects import extend_with_findings
from dynident.diagnosis.search.search_state import Finding, State, gather_state, score_all
from dynident.effects import EffectChoice, UnknownEffectError
from dynident.errors import Cancelled
from dynident.identification import IdentificationChoices, extend, identify
from dynident.progress import ignore_progress
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs

FAST = ("offset", "load_dependent_friction")


SHAPES = {
    "stribeck": ("vs", 0.12),
    "presliding": ("d0", 0.02),
    "torque_ripple": ("k", 21.0),
    "viscous_nonlinear": ("p", 2.0),
}
THOROUGH = pytest.mark.thorough


def assert_named(case: Case, seed: int) -> None:
    run = experiment(case.hidden, case.effects, seed)
    found = diagnose(run.identification, [run.training])
    assert found.verdict == "missing_effect", found.summary
    first = found.candidates[0]
    assert first.significant
    assert case.effect == first.effect or case.effect in first.equivalent, found.summary
    if case.joint is not None:
        assert first.joints == (NAMES[case.joint],)
    significant = [c for c in found.candidates if c.significant]
    assert len(significant) == len(found.recommended)
    assert [choice.effect for choice in found.recommended] == [case.effect]
    if case.effect in SHAPES:
        name, value = SHAPES[case.effect]
        assert found.recommended[0].shape_values[name] == pytest.approx(value, rel=0.1)
    assert_down_to_the_noise(case, run, found, seed)


def assert_down_to_the_noise(case: Case, run: Experiment, found: Diagnosis, seed: int) -> None:
    grown = extend(run.identification, found.recommended, [run.training], [run.validation])
    before, after = run.identification.held_out.rms / floor(seed), grown.held_out.rms / floor(seed)
    worst = max(case.joints, key=lambda j: before[j])
    assert before[worst] > 1.3
    assert after.max() <= 1.1


@pytest.mark.parametrize("effect", FAST)
def test_a_hidden_effect_alone_is_named_and_leaves_nothing_but_noise_once_added(effect):
    assert_named(CASES[effect], 0)


@pytest.mark.sweep
@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=THOROUGH) for seed in (0, 2, 4))])
@pytest.mark.parametrize("effect", CASES)
def test_every_hidden_effect_alone_is_named_with_its_shape_and_leaves_nothing_but_noise_once_added(effect, seed):
    assert_named(CASES[effect], seed)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=THOROUGH) for seed in (1, 2))])
def test_nothing_is_recommended_where_nothing_is_missing(seed):
    run = experiment(seed=seed)
    found = diagnose(run.identification, [run.training])
    assert found.recommended == ()
    assert found.verdict == "adequate"
    assert not any(c.significant for c in found.candidates)
    assert found.unknown == ()
    np.testing.assert_allclose(found.residual_rms, found.noise_floor, rtol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, *(pytest.param(seed, marks=THOROUGH) for seed in range(5, 16))])
def test_no_false_alarm_on_many_clean_runs(seed):
    run = experiment(seed=seed)
    assert diagnose(run.identification, [run.training]).recommended == ()


@pytest.mark.slow
def test_two_effects_on_two_joints_are_both_named():
    ripple, spring = CASES["torque_ripple"], CASES["joint_spring"]

    def both(motion, load):
        return ripple.hidden(motion, load) + spring.hidden(motion, load)

    run = experiment(both)
    found = diagnose(run.identification, [run.training])
    named = {(choice.effect, choice.joints) for choice in found.recommended}
    assert named == {("torque_ripple", (NAMES[3],)), ("joint_spring", (NAMES[0],))}


@pytest.mark.slow
@pytest.mark.parametrize("k", [2, pytest.param(3, marks=pytest.mark.thorough)])
def test_a_slow_ripple_that_other_friction_of_its_joint_hides_is_named_beside_it(k):
    friction = CASES["load_dependent_friction"]
    ripple = on_joint(2, lambda q, v, load: 1.5 * np.sin(k * q + 0.4))

    def both(motion, load):
        return friction.hidden(motion, load) + ripple(motion, load)

    run = experiment(both)
    found = diagnose(run.identification, [run.training])
    assert {choice.joints for choice in found.recommended} == {(NAMES[2],)}
    names = [{item.effect, *item.equivalent} for item in found.candidates if item.significant]
    # A balancer with constants of its own says as much of so few waves within chance: it is either of both.
    assert len(names) == 2
    assert {"load_dependent_friction"} in names
    assert any("torque_ripple" in each for each in names)


@pytest.mark.slow
def test_one_family_on_all_joints_is_named_as_one_group():
    def hidden(motion, load):
        return 0.1 * np.abs(load) * np.sign(motion.dq)

    run = experiment(hidden)
    found = diagnose(run.identification, [run.training])
    effects = {choice.effect for choice in found.recommended}
    assert effects == {"load_dependent_friction"}
    joints = {name for choice in found.recommended for name in choice.joints}
    assert {NAMES[1], NAMES[2]} <= joints  # those that carry a load


@pytest.mark.slow
def test_a_torque_that_no_effect_explains_is_reported_by_joint_and_variable():
    # A bump at one speed, in one direction.
    bump = on_joint(2, lambda q, v, load: 4.0 * np.exp(-(((v - 0.6) / 0.12) ** 2)))
    run = experiment(bump)
    found = diagnose(run.identification, [run.training], DiagnosisChoices(("joint_spring", "base_tilt")))
    assert found.verdict == "unexplained"
    assert found.unknown[0].joint == NAMES[2]
    assert found.unknown[0].variable == "velocity"
    assert NAMES[2] in found.summary


@pytest.fixture(scope="module")
def offset() -> tuple[Experiment, Diagnosis]:
    case = CASES["offset"]
    run = experiment(case.hidden, case.effects)
    return run, diagnose(run.identification, [run.training])


def test_a_diagnosis_says_what_it_means(offset):
    _, found = offset
    first = found.candidates[0]
    assert "Torque offset" in found.summary
    assert NAMES[1] in found.summary
    assert "left out of the fit" in first.evidence
    assert "coulomb_asymmetric" in first.equivalent
    assert 0 < first.error_after < first.error_before < 1
    assert first.error_drop == pytest.approx(1 - first.error_after / first.error_before)
    assert [c.rank for c in found.candidates] == list(range(1, len(found.candidates) + 1))
    assert len({c.effect for c in found.candidates if not c.significant}) == sum(
        not c.significant for c in found.candidates
    )


def test_the_error_that_is_promised_is_the_error_that_is_kept(offset):
    run, found = offset
    first = found.candidates[0]
    grown = extend(run.identification, found.recommended, [run.training], [run.validation])
    joint = 1
    assert grown.fit.relative[joint] == pytest.approx(first.error_after, rel=0.15)
    assert grown.held_out.rms[joint] < run.identification.held_out.rms[joint]


def test_the_failure_map_names_the_joint_that_fails(offset):
    _, found = offset
    assert {spot.joint for spot in found.failure_map} <= set(NAMES)
    for spot in found.failure_map:
        assert spot.low < spot.high
        assert spot.ratio > 1
        assert spot.unit in ("rad", "rad/s", "N m", "s")


def test_effects_in_the_model_are_not_proposed_again():
    run = experiment(CASES["joint_spring"].hidden, (*WITH_OFFSET, EffectChoice("joint_spring", (NAMES[0],))))
    found = diagnose(
        run.identification, [run.training], DiagnosisChoices(("joint_spring", "offset", "viscous_asymmetric"))
    )
    assert found.recommended == ()
    assert not any(c.effect == "joint_spring" and NAMES[0] in c.joints for c in found.candidates)
    assert not any(c.effect == "offset" for c in found.candidates)


def test_only_the_candidates_asked_for_are_tried():
    run = experiment(CASES["joint_spring"].hidden)
    found = diagnose(run.identification, [run.training], DiagnosisChoices(("joint_spring",)))
    assert {c.effect for c in found.candidates} == {"joint_spring"}
    assert found.recommended == (EffectChoice("joint_spring", (NAMES[0],)),)


def test_an_unknown_candidate_is_refused_by_its_place():
    run = experiment()
    with pytest.raises(UnknownEffectError) as caught:
        diagnose(run.identification, [run.training], DiagnosisChoices(("offset", "magic")))
    assert caught.value.pointer == "/candidates/1"


@dataclass(frozen=True)
class ScoredStub:
    candidate: Candidate
    joints: tuple[int, ...]
    p: float = 0.001
    total_gain: float = 1.0


def test_a_search_ends_where_nothing_more_passes_and_not_at_a_number_of_effects(monkeypatch):
    ripples = [Candidate("torque_ripple", (NAMES[0],), (("k", 8.0 + k),), (k,)) for k in range(20)]
    pool = SimpleNamespace(
        initial_candidates=ripples, candidates=(), faint=frozenset(), observation=SimpleNamespace(robot=ROBOT)
    )
    for name, stub in {
        "select_candidate": lambda state, judged, rejections: (judged[0], ()),
        "compare_names": lambda rows, state, choice, judged: choice,
        "score_family": lambda state, left, *_: SimpleNamespace(
            scored=[ScoredStub(candidate, (0,)) for candidate in left], is_fresh=True
        ),
        "is_determined": lambda *_: True,
        "_list_neighbour_columns": lambda *_: (),
    }.items():
        monkeypatch.setattr(forward_selection, name, stub)
    monkeypatch.setattr(State, "estimate_noise", lambda state: state)
    first = SimpleNamespace(scored=[ScoredStub(candidate, (0,)) for candidate in ripples], is_fresh=True)
    state = State(cast(Any, None), cast(Any, pool), (), np.ones(1), np.ones(1))
    record = forward_selection.search_findings(state, cast(Any, first), cast(Any, None), ignore_progress)
    assert [finding.judged.candidate for finding in record.state.findings] == ripples


def test_a_search_with_further_proposals_goes_on_where_the_first_ended_and_is_refined_once(monkeypatch):
    named, refined = [], []

    def refine(*asked):
        refined.append(len(asked[1]))
        return refine_findings(*asked)

    def name(rows, state):
        named.append(sorted(finding.judged.candidate.effect for finding in state.findings))
        return name_findings(rows, state)

    monkeypatch.setattr(diagnose_model, "name_findings", name)
    monkeypatch.setattr(diagnose_model, "refine_findings", refine)
    # The large error hides the line of the small one, which only the second search is asked about.
    run = experiment(on_joint(3, lambda q, v, load: 30.0 * hysteresis(q, 0.02) + 0.9 * np.sin(21.0 * q + 0.7)))
    found = diagnose(run.identification, [run.training])
    assert {choice.effect for choice in found.recommended} == {"presliding", "torque_ripple"}
    # All names are asked again once, at the end of the search.
    assert named == [["presliding", "torque_ripple"]]
    assert refined == [2]


def test_a_search_goes_on_beside_the_best_constants_of_what_it_found_and_not_beside_those_of_the_grid(monkeypatch):
    constants = []

    def search(*asked):
        earlier = asked[4]
        constants.append([] if earlier is None else [choice.shape for choice in earlier.choices])
        return forward_selection.search_findings(*asked)

    monkeypatch.setattr(diagnose_model, "search_findings", search)
    run = experiment(on_joint(3, lambda q, v, load: 30.0 * hysteresis(q, 0.0238)))
    diagnose(run.identification, [run.training])
    first, (own, *_) = constants
    assert first == []
    assert dict(own)["d0"] == pytest.approx(0.0238, rel=0.05)


def test_a_finding_gets_the_name_that_says_more_beside_all_that_was_found():
    run = experiment(on_joint(2, lambda q, v, load: 0.08 * load))
    model, plain = run.identification.model, run.identification
    inputs = RegressorInputs([run.training], plain.preprocessing, plain.estimate.next_reference())
    names = ("drive_gain_saturation", "drive_gain_error", "offset")
    pool = build_pool_of_choices(model, [EffectChoice(name, (NAMES[2],)) for name in names])
    state = gather_state(model, pool, inputs, plain.noise)
    (wrong, *_) = score_all(state, [pool.candidates[0]])
    state = state.add_finding(Finding(replace(wrong, p=0.001), (), 0.001))
    (found,) = name_findings(RecordedSource(model, inputs), state).findings
    assert found.judged.candidate.effect == "drive_gain_error"
    # The old name stands where the new one turns out to be impossible, but is none that the data leave open.
    assert [scored.candidate.effect for scored in found.former] == ["drive_gain_saturation"]
    assert found.equal == ()
    # What is right already stays.
    state = gather_state(model, pool, inputs, plain.noise)
    (right, *_) = score_all(state, [pool.candidates[1]])
    state = state.add_finding(Finding(replace(right, p=0.001), (), 0.001))
    (kept,) = name_findings(RecordedSource(model, inputs), state).findings
    assert kept.judged.candidate == right.candidate


def test_a_finding_that_gets_another_name_keeps_what_explains_as_much():
    run = experiment(CASES["offset"].hidden, PLAIN)
    model, plain = run.identification.model, run.identification
    inputs = RegressorInputs([run.training], plain.preprocessing, plain.estimate.next_reference())
    names = ("viscous_asymmetric", "offset", "coulomb_asymmetric")
    pool = build_pool_of_choices(model, [EffectChoice(name, (NAMES[1],)) for name in names])
    state = gather_state(model, pool, inputs, plain.noise)
    (wrong, *_) = score_all(state, [pool.candidates[0]])
    state = state.add_finding(Finding(replace(wrong, p=0.001), (), 0.001))
    (found,) = name_findings(RecordedSource(model, inputs), state).findings
    both = (found.judged.candidate.effect, *(scored.candidate.effect for scored in found.equal))
    assert sorted(both) == ["coulomb_asymmetric", "offset"]
    assert [scored.candidate.effect for scored in found.former] == ["viscous_asymmetric"]


def test_a_search_is_not_repeated_beside_what_has_no_constants(monkeypatch):
    searches = []

    def search(*asked):
        searches.append(asked)
        return forward_selection.search_findings(*asked)

    monkeypatch.setattr(diagnose_model, "search_findings", search)
    run = experiment(CASES["offset"].hidden, PLAIN)
    found = diagnose(run.identification, [run.training], DiagnosisChoices(FAST))
    assert [choice.effect for choice in found.recommended] == ["offset"]
    assert len(searches) == 1


def test_refining_constants_tells_its_progress_and_can_be_cancelled(monkeypatch):
    def refine(*asked):
        asked[-1](0.5, "refined once")
        return refine_constants(*asked)

    def cancel(fraction, message):
        if is_cancelled(message):
            raise Cancelled

    monkeypatch.setattr(diagnose_model, "refine_constants", refine)
    run = experiment(CASES["stribeck"].hidden)
    is_cancelled = "refined once".__eq__
    with pytest.raises(Cancelled):
        diagnose(run.identification, [run.training], DiagnosisChoices(("stribeck",)), progress=cancel)
    model, plain = run.identification.model, run.identification
    inputs = RegressorInputs([run.training], plain.preprocessing, plain.estimate.next_reference())
    choice = EffectChoice("stribeck", (NAMES[1],), (("delta", 2.0), ("vs", 0.1)))
    pool = build_pool_of_choices(model, [choice])
    (scored,) = score_all(gather_state(model, pool, inputs, plain.noise), pool.candidates)
    resolved = compute_resolution([compare(plain, run.training)], plain.preprocessing)
    is_cancelled = bool
    with pytest.raises(Cancelled):
        refine_constants(model, [Finding(scored, (), 0.001)], inputs, resolved, cancel)


@pytest.mark.parametrize("code", ["cannot_be_added", "not_confirmed", "no_help_once_added"])
def test_what_is_dropped_once_a_wrong_name_is_gone_is_none_of_the_findings(monkeypatch, code):
    calls = []

    def extend(model, choices, recordings, validation, progress):
        calls.append([(choice.effect, choice.joints) for choice in choices])
        if len(calls) == 1:
            return extend_with_findings(model, choices, recordings, validation, progress)
        return model, {0: Reason.build(code, detail="none", share=0.1, least=0.5)}

    def hidden(motion, load):
        tau = CASES["load_dependent_friction"].hidden(motion, load)
        return tau + CASES["offset"].hidden(motion, load)

    monkeypatch.setattr(diagnose_model, "extend_with_findings", extend)
    monkeypatch.setattr(diagnose_model, "find_misnamed", lambda *asked: [0])
    run = experiment(hidden, PLAIN)
    found = diagnose(run.identification, [run.training], DiagnosisChoices(FAST))
    assert [len(choices) for choices in calls] == [2, 1]
    assert found.recommended == ()
    # Only what could not be put to the test may be there unseen.
    assert (calls[1][0] in [(item.effect, item.joints) for item in found.not_visible]) is (code == "cannot_be_added")


def test_further_proposals_leave_the_numbers_of_all_earlier_columns():
    model = build_model(ROBOT, WITH_OFFSET)
    first = build_pool(model)
    later = build_pool(model, None, ShapeProposals(AngleLines(clear=((0, 9.0),))), None, first)
    assert later.candidates[: len(first.candidates)] == first.candidates
    assert {candidate.effect for candidate in later.candidates[len(first.candidates) :]} >= {"torque_ripple"}
    # What the earlier pool has compiled is not compiled again.
    assert later.observation.parts is not None
    assert later.observation.parts[0] is first.observation


def test_what_this_motion_could_not_have_shown_is_said():
    # A joint that moves by half a degree: a spring on it pulls like a constant torque.
    motion = fourier_motion(ROBOT, 40.0, 200.0, 5)
    motion.q[:, 5] = 1.0 + 0.01 * (motion.q[:, 5] - motion.q[:, 5].mean())
    motion.dq[:, 5] *= 0.01
    motion.ddq[:, 5] *= 0.01
    run = recorded(motion, nothing, 3, "run")
    identification = identify(ROBOT, [run], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    found = advise(examine(identification, [run], DiagnosisChoices(("joint_spring",))))
    hidden = {item.joints: item for item in found.not_visible}
    assert (NAMES[5],) in hidden
    assert (NAMES[0],) not in hidden
    assert "independent of the model" in hidden[(NAMES[5],)].reason
    assert found.next_experiment is not None
    assert "Joint spring" in found.next_experiment.reason


def test_what_these_data_are_too_few_to_show_is_said_with_its_size():
    # The wrist is light and slow: as soft as arms are, it would not be seen among the noise.
    run = experiment()
    found = diagnose(run.identification, [run.training], DiagnosisChoices(("joint_elasticity", "offset")))
    hidden = {item.joints: item.reason for item in found.not_visible if item.effect == "joint_elasticity"}
    assert "an arm with this effect has about" in hidden[(NAMES[5],)]
    wanted = r"\w+2 would have shown from \S+ rad/\(N m\) on; an arm with this effect has about \S+ rad/\(N m\)"
    assert re.match(wanted, hidden[(NAMES[1],)])
    assert all(item.effect == "joint_elasticity" for item in found.not_visible)


def test_progress_reaches_the_end_and_may_cancel():
    run = experiment()
    seen: list[float] = []
    diagnose(
        run.identification,
        [run.training],
        DiagnosisChoices(("offset", "viscous_asymmetric")),
        progress=lambda share, message: seen.append(share),
    )
    assert seen == sorted(seen)
    assert 0.9 <= seen[-1] <= 1.0

    def cancel(share: float, message: str) -> None:
        if share > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        diagnose(run.identification, [run.training], progress=cancel)


def test_what_explains_most_of_the_error_is_named_on_a_motion_too_short_to_determine_the_model():
    short = recorded(fourier_motion(ROBOT, 4.5, 200.0, 504), CASES["stribeck"].hidden, 4, "short")
    found = diagnose(
        identify(ROBOT, [short], choices=IdentificationChoices(WITH_OFFSET, preprocessing=BAND)),
        [short],
        DiagnosisChoices(("stribeck", "joint_spring", "torque_ripple")),
    )
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("stribeck", (NAMES[1],))]


def test_a_residual_far_above_the_noise_is_never_adequate_though_it_depends_on_nothing_that_is_tried():
    def rumble(motion, load):
        """Noise of a narrow band, twice as large as the sensor's: six times it behind the filter."""
        ringing = np.exp(-np.arange(200) / 10.0) * np.sin(np.arange(200) / 6.0)
        noise = np.convolve(np.random.default_rng(5).normal(size=len(load)), ringing, "same")
        added = np.zeros_like(load)
        added[:, 1] = 2.0 * NOISE[1] * noise / noise.std()
        return added

    run = experiment(rumble)
    found = diagnose(run.identification, [run.training], DiagnosisChoices(("offset", "joint_spring")))
    assert found.recommended == ()
    assert found.residual_rms[1] > 4.0 * found.noise_floor[1]
    assert found.verdict == "unexplained"
    assert "depends on none of the variables" in found.summary


def test_a_ripple_that_a_larger_effect_hides_is_looked_for_once_that_is_in_the_model():
    hidden = on_joint(3, lambda q, v, load: 0.24 * np.abs(load) * np.sign(v) + 0.1 * np.sin(21.0 * q + 0.7))
    run = experiment(hidden)
    names = ["load_dependent_friction", "torque_ripple"]
    # The residual of the plain model has no line over the angle that stands out.
    leads = find_angle_lines([compare(run.identification, run.training)], ROBOT)
    assert not any(joint == 3 for joint, _ in leads.clear)
    found = diagnose(run.identification, [run.training], DiagnosisChoices(tuple(names)))
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [(name, (NAMES[3],)) for name in names]
    assert found.recommended[1].shape_values["k"] == pytest.approx(21.0, abs=0.1)
