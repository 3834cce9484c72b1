"""Names that take much of the same error are weighed with finer constants, and on the rows that both are about."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, ROBOT, WITH_OFFSET, Hidden, experiment, nothing, on_joint, recorded
from support.oracles import FloatArray, Motion, fourier_motion, pinocchio_torque
from support.scored_candidates import judged as scored_with

from dynident.diagnosis import DiagnosisChoices, diagnose, examine
from dynident.diagnosis.candidates.candidate_pool import Candidate, build_pool_of_choices
from dynident.diagnosis.changes_between_recordings import identify_on_both
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search import comparison_of_rivals, next_finding
from dynident.diagnosis.search.comparison_of_rivals import name_findings
from dynident.diagnosis.search.finding_refinement import RecordedSource
from dynident.diagnosis.search.next_finding import select_candidate
from dynident.diagnosis.search.search_state import Finding, State, gather_state, score_all, score_family
from dynident.effects import EffectChoice, get_effect
from dynident.identification import IdentificationChoices, identify
from dynident.identification.shape_refinement import list_shape_variables
from dynident.identification.shape_search import list_between
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import Robot
from dynident.robot.limits_and_drives import HARDWARE


def _balancer(q, v, load):
    """A spring from a point of the antecedent link to a crank of 0.4, in line at an angle between those of the grid."""
    x = q + 1.57
    length = np.sqrt(1.0 + 0.4**2 + 0.8 * np.cos(x))
    return 60.0 * np.sin(x) * (1.0 - 0.8 / length)


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [3, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_balancer_between_two_values_of_the_grid_is_no_cable_and_no_ripple(seed):
    motion = fourier_motion(
        ROBOT, 40.0, 200.0, 100 + seed, base_frequency=0.05, harmonics=4, amplitude=2.8, fastest=1.0
    )
    recording = recorded(motion, on_joint(1, _balancer), seed, "swinging far")
    model = identify(ROBOT, [recording], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    found = diagnose(model, [recording])
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("gravity_compensator", (NAMES[1],))]
    shape = found.recommended[0].shape_values
    # A crank of so much of the other one's length and one of so many times it are the same spring.
    assert (shape["phi"], min(shape["r"], 1.0 / shape["r"])) == pytest.approx((-1.57, 0.4), rel=0.03)


@pytest.mark.slow
def test_a_balancer_that_two_waves_and_a_third_a_turn_would_say_as_well_is_no_ripple():
    motion = fourier_motion(ROBOT, 24.0, 200.0, 203, base_frequency=0.125, harmonics=3, amplitude=2.2, fastest=2.0)

    def spring(q, v, load):
        length = np.sqrt(1.0 + 0.3**2 + 0.6 * np.cos(q + 0.3))
        return 25.0 * np.sin(q + 0.3) * (1.0 - 0.7 / length)

    recording = recorded(motion, on_joint(1, spring), 3, "three harmonics")
    model = identify(ROBOT, [recording], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    found = diagnose(model, [recording])
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("gravity_compensator", (NAMES[1],))]


def test_a_wave_that_turns_with_the_joint_closes_after_a_turn():
    (cycles,) = get_effect("torque_ripple").shapes
    assert [cycles.list_allowed_values(k) for k in (2.4, 3.0, 4.9, 5.3)] == [(2.0, 3.0), (3.0,), (4.0, 5.0), (5.3,)]
    slow, fast = (EffectChoice("torque_ripple", (NAMES[1],), (("k", k),)) for k in (3.0, 20.0))
    assert list_between(slow) == [slow]
    assert len(list_between(fast)) == 9
    for k in (5.0, 5.02):
        near = list_between(EffectChoice("torque_ripple", (NAMES[1],), (("k", k),)))
        assert min(choice.shape_values["k"] for choice in near) >= 5.0
    assert [place.choice for place in list_shape_variables([slow, fast])] == [1]
    # Other constants may be below zero, and are searched for all the same.
    spring = EffectChoice("gravity_compensator", (NAMES[1],), (("phi", -0.5), ("r", 0.25)))
    assert len({choice.shape_values["phi"] for choice in list_between(spring)}) == 5


def test_constants_between_those_of_the_grid_are_tried_together_and_stay_what_nature_allows():
    spring = EffectChoice("gravity_compensator", (NAMES[1],), (("phi", 0.0), ("r", 0.25)))
    around = list_between(spring)
    assert around[0] == spring
    assert len(set(around)) == len(around) == 25
    assert min(choice.shape_values["r"] for choice in around) > 0.0
    power = EffectChoice("viscous_nonlinear", (NAMES[0],), (("p", 0.5),))
    assert min(choice.shape_values["p"] for choice in list_between(power)) >= 0.4
    assert list_between(EffectChoice("offset", (NAMES[0],))) == [EffectChoice("offset", (NAMES[0],))]


def heavier_upper_arm(motion: Motion, load: FloatArray) -> FloatArray:
    """A point mass of 1.5 kg on the second link."""
    x, y, z = 0.12, 0.02, 0.03
    inertia = [y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y]
    inertias = ROBOT.inertias.copy()
    inertias[1] += 1.5 * np.array([*inertia, x, y, z, 1.0])
    heavy = Robot(ROBOT.name, ROBOT.joints, ROBOT.gravity, ROBOT.drives, ROBOT.description, inertias)
    return pinocchio_torque(heavy, motion.q, motion.dq, motion.ddq) - load


@pytest.mark.slow
def test_a_mass_that_a_spring_would_say_as_well_keeps_its_name_from_day_to_day():
    since = ("friday",)
    mass, spring = (EffectChoice(name, (NAMES[1],), (), since) for name in ("payload", "joint_spring"))
    days = [
        recorded(
            fourier_motion(ROBOT, 20.0, 200.0, seed, base_frequency=0.1, harmonics=5, amplitude=0.8, fastest=1.5),
            heavier,
            seed,
            name,
        )
        for seed, name, heavier in ((300, "monday", nothing), (301, *since, heavier_upper_arm))
    ]
    model = identify(ROBOT, days[:1], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    both, days, _ = identify_on_both(model, days[:1], days[1:])
    pool = replace(build_pool_of_choices(both.model, [mass, spring]), since=since)
    rows = RecordedSource(both.model, RegressorInputs(days, both.preprocessing, both.estimate.next_reference()))
    floor = np.full(6, 0.05)
    state = State(rows.gather_products(pool), pool, tuple(range(pool.n_base)), floor, floor).estimate_noise()
    tried = [pool.find_candidate(choice) for choice in (mass, spring)]
    family = score_family(state, tried)
    # What was scored beside the same model is not scored again, and stays as sure.
    again = score_family(state, tried[:1], family)
    assert again.is_fresh
    assert again.scored[0].after is family.scored[0].after
    assert again.draws[0] is family.draws[0]
    judged = family.scored
    choice = select_candidate(state, judged)
    assert choice is not None
    chosen, equal = choice
    (found,) = name_findings(rows, state.add_finding(Finding(chosen, equal, chosen.p))).findings
    assert (found.judged.candidate.choice, [item.candidate.choice for item in found.equal]) == (mass, [spring])


def test_a_balancer_that_a_spring_explains_as_well_is_told_as_either_of_both():
    def spring(q, v, load):
        x = q + 0.2
        return 150.0 * np.sin(x) * (1.0 - 0.8 / np.sqrt(1.25 + np.cos(x)))

    motion = fourier_motion(ROBOT, 24.0, 200.0, 203, base_frequency=0.125, harmonics=3, amplitude=1.0, fastest=2.0)
    recording = recorded(motion, on_joint(1, spring), 3, "a small range")
    model = identify(ROBOT, [recording], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    names = ["gravity_compensator", "joint_spring"]
    found = examine(model, [recording], DiagnosisChoices(tuple(names)))
    (first, *_), (doubt, *_) = found.diagnosis.candidates, found.doubts
    assert sorted((first.effect, *first.equivalent)) == names
    lacking = found.diagnosis.summary.split(". ")[0].lower()
    assert f" on {NAMES[1]}, or " in lacking
    # Neither is said to be a part of the robot, which is asked for both.
    assert all(f"({part}?)" in lacking for part in ("gravity compensating spring", "joint spring"))
    assert all(f"Does the robot have {HARDWARE[part]}?" in found.diagnosis.summary for part in ("spring", names[0]))
    known = ("spring", names[0])
    summary = diagnose(model, [recording], DiagnosisChoices(tuple(names), has=known)).summary
    assert "?" not in summary.split(". ")[0]
    assert "Does the robot have" not in summary
    # The next experiment tells them apart.
    assert sorted((doubt.suspect.effect, *(rival.effect for rival in doubt.rivals))) == names


def named(hidden: Hidden, found: list[EffectChoice], rivals: list[EffectChoice], *equal: EffectChoice) -> list[Finding]:
    """What findings are called in the end; `equal` are those of the first before."""
    run = experiment(hidden)
    model, plain = run.identification.model, run.identification
    inputs = RegressorInputs([run.training], plain.preprocessing, plain.estimate.next_reference())
    pool = build_pool_of_choices(model, [*found, *rivals, *equal])
    state = gather_state(model, pool, inputs, plain.noise)
    for number, choice in enumerate(found):
        known = equal if number == 0 else ()
        scored, *others = score_all(state, [pool.find_candidate(each) for each in (choice, *known)])
        state = state.add_finding(Finding(replace(scored, p=0.001), tuple(others), 0.001))
    return list(name_findings(RecordedSource(model, inputs), state).findings)


def test_two_findings_never_get_the_same_name_on_the_same_joint():
    saturation, error = (EffectChoice(name, (NAMES[2],)) for name in ("drive_gain_saturation", "drive_gain_error"))
    other = EffectChoice("position_dependent_friction", (NAMES[2],), (("k", 1.0),))
    findings = named(on_joint(2, lambda q, v, load: 0.08 * load), [saturation, other], [error])
    effects = [finding.judged.candidate.effect for finding in findings]
    assert effects == ["drive_gain_error", "position_dependent_friction"]


@pytest.mark.parametrize(
    ("joint", "law", "wrong", "right"),
    [
        (
            2,
            lambda q, v, load: 3.0 * np.sin(4.0 * q),
            EffectChoice("joint_spring", (NAMES[2],)),
            EffectChoice("torque_ripple", (NAMES[2],), (("k", 4.0),)),
        ),
        (
            0,
            lambda q, v, load: 4.0 * np.sign(v) * v**2,
            EffectChoice("viscous_asymmetric", (NAMES[0],)),
            EffectChoice("viscous_nonlinear", (NAMES[0],), (("p", 2.0),)),
        ),
    ],
)
def test_a_name_with_more_constants_that_explains_clearly_more_takes_over(joint, law, wrong, right):
    (found,) = named(on_joint(joint, law), [wrong], [right])
    assert found.judged.candidate.effect == right.effect
    assert found.equal == ()
    assert [scored.candidate.effect for scored in found.former] == [wrong.effect]


def test_equals_on_other_joints_stay_whatever_the_names_on_the_own_joint_say():
    gain, rival = (EffectChoice(name, (NAMES[2],)) for name in ("drive_gain_error", "drive_gain_saturation"))
    elsewhere = EffectChoice("joint_spring", (NAMES[1],))
    hidden = on_joint(2, lambda q, v, load: 0.08 * load)
    (found,) = named(hidden, [gain], [rival], elsewhere)
    assert found.judged.candidate.choice == gain
    assert found.equal[-1].candidate.choice == elsewhere
    # So they do where the name changes: they were not compared with the new one.
    (renamed,) = named(hidden, [rival], [gain], elsewhere)
    assert renamed.judged.candidate.choice == gain
    assert renamed.equal[-1].candidate.choice == elsewhere


def test_of_equals_the_one_that_explains_most_comes_first(monkeypatch):
    monkeypatch.setattr(comparison_of_rivals, "_are_alike", lambda state, scores, name, other: other != name)
    monkeypatch.setattr(comparison_of_rivals, "_choose_name", lambda state, scores, name: name)
    monkeypatch.setattr(comparison_of_rivals, "_is_acceptable", lambda state, scored: True)
    monkeypatch.setattr(comparison_of_rivals, "RULES", replace(RULES, contends=-1e9))
    names = ("drive_gain_saturation", "offset", "drive_gain_error", "joint_spring")
    own, *rivals = (EffectChoice(name, (NAMES[2],)) for name in names)
    (found,) = named(on_joint(2, lambda q, v, load: 0.08 * load), [own], rivals)
    gains = [scored.total_gain for scored in found.equal]
    assert len(gains) >= 2
    assert gains == sorted(gains, reverse=True)
    assert found.equal[0].candidate.effect == "drive_gain_error"


def test_a_peak_at_low_speeds_that_falls_is_no_power_of_the_velocity_that_gains_at_reversals_alone(monkeypatch):
    drop = EffectChoice("viscous_asymmetric", (NAMES[1],))
    power = EffectChoice("viscous_nonlinear", (NAMES[1],), (("p", 2.0),))
    hidden = on_joint(1, lambda q, v, load: 12.0 * np.sign(v) * v**2)
    assert named(hidden, [drop], [power])[0].judged.candidate.effect == power.effect
    asked = []

    def check(state, scored):
        asked.append(scored.candidate.effect)
        return Reason.build("only_at_reversals", share=0.0, least=0.02)

    monkeypatch.setattr(comparison_of_rivals, "check_moving_joints", check)
    (kept,) = named(hidden, [drop], [power])
    assert (kept.judged.candidate.choice, kept.equal) == (drop, ())
    assert asked == [power.effect]


def test_the_constants_of_a_rival_are_chosen_on_other_parts_of_the_data():
    # Of two constants each is best where the other is not: neither is chosen where it would gain.
    first, second = np.repeat([[4.0, 0.0], [0.0, 3.0]], 10, axis=1)
    scores = [scored_with(first), scored_with(second)]
    run = np.repeat([0, 1], 10)
    assert comparison_of_rivals._nest_gains(scores, run).tolist() == [0.0] * 20
    # Within one run, or where the effect acts in one of them only, nothing is learned from the other runs.
    for parts, runs in ((run, ("b",)), (np.zeros(20, dtype=int), ())):
        own = [replace(each, candidate=replace(each.candidate, runs=runs)) for each in scores]
        assert comparison_of_rivals._nest_gains(own, parts).sum() > 0.0


def test_candidates_that_only_show_at_reversals_are_scored_once_each_without_these_rows(monkeypatch):
    scored, links = [], [SimpleNamespace(link=name) for _ in range(20) for name in ("a", "b")]

    def score(state, candidates, kinds):
        scored.append(candidates)
        return [SimpleNamespace(error_drop=0.0) for _ in candidates]

    monkeypatch.setattr(next_finding, "score_all", score)
    # Of each group the second joint is idle: what is checked is the candidate without it.
    monkeypatch.setattr(next_finding, "has_gain_on_joint", lambda state, scored, joint: joint == "a")
    robot = SimpleNamespace(get_movers=lambda name: (name,))
    state = SimpleNamespace(
        data=SimpleNamespace(find_row_kinds=lambda columns: (True, False)),
        pool=SimpleNamespace(observation=SimpleNamespace(robot=robot, columns=links)),
        rules=SimpleNamespace(least_error_drop=0.02),
    )
    groups = [Candidate("presliding", ("a", "b"), (("s", float(k)),), (2 * k, 2 * k + 1)) for k in range(20)]
    passing, known = [SimpleNamespace(candidate=group) for group in groups], {}
    for k, group in enumerate(groups):
        slim = SimpleNamespace(candidate=replace(group, joints=("a",), columns=group.columns[:1]))
        assert next_finding.check_moving_joints(state, slim, passing[k:] if known else (), known) is not None
    # The first by itself, and then all that are left at once.
    assert [len(candidates) for candidates in scored] == [1, 19]
    twin = SimpleNamespace(candidate=Candidate("stribeck", ("a",), (), (40,)))
    next_finding.check_moving_joints(state, twin, passing, known)
    assert scored[2:] == [[twin.candidate]]
