"""What a diagnosis says of arms that stand and stick, and of torque that no effect in nature gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from support.joints_at_rest import COULOMB, MOVES, NOISE, PERIOD, resting_motion, resting_torque
from support.oracles import arm, pinocchio_torque, record
from support.scored_candidates import judged

from dynident.diagnosis import compare, diagnose
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search import next_finding, static_friction
from dynident.diagnosis.search.acceptance_rules import find_rejection, is_shadowed
from dynident.diagnosis.search.search_state import State, gather_state
from dynident.diagnosis.search.static_friction import Halts, find_halts, is_extrapolated
from dynident.effects import CATALOGUE, EffectChoice
from dynident.identification import extend, identify
from dynident.recordings import Recording

pytestmark = pytest.mark.sweep

SCARA = arm("scara")
SMALL = Reason.build("not_significant", p=1.0, level=0.01)
EXCESS = 2.5


def resting(seed: int, excess: float, vs: float) -> Recording:
    """An arm that rests between moves, its first joint harder to move at low speed."""
    motion = resting_motion(SCARA, 60.0, 200.0, seed)
    tau = resting_torque(SCARA, motion, seed)
    speed = motion.dq[:, 0]
    tau[:, 0] += excess * np.exp(-((speed / vs) ** 2)) * np.sign(speed) * (np.abs(speed) > 1e-6)
    return record(SCARA, motion, tau, f"run{seed}")


@pytest.mark.parametrize("vs", [0.03, 0.06])
def test_friction_that_peaks_at_low_speed_is_named_on_a_joint_that_stops_at_every_move(vs: float):
    # 0.03 rad/s is below the slowest rows that the filter's width leaves between halts.
    run = resting(1, EXCESS, vs)
    found = diagnose(identify(SCARA, [run], [resting(2, EXCESS, vs)]), [run])
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("stribeck", SCARA.joint_names[:1])]
    assert found.recommended[0].shape_values["delta"] == 2.0
    assert found.recommended[0].shape_values["vs"] == pytest.approx(vs, rel=0.05)


def test_nothing_is_named_on_an_arm_that_only_rests_between_its_moves():
    run = resting(1, 0.0, 0.06)
    assert diagnose(identify(SCARA, [run], [resting(2, 0.0, 0.06)]), [run]).recommended == ()


def held(
    seed: int, most: float, spread: float, friction: Callable[[np.ndarray], np.ndarray], duration: float = 60.0
) -> Recording:
    """The first joint is held by up to `most` at every rest; where it moves it has `friction` of its velocity more."""
    motion = resting_motion(SCARA, duration, 200.0, seed)
    tau = resting_torque(SCARA, motion, seed)
    rests = motion.t % PERIOD >= MOVES
    random = np.random.default_rng(200 + seed)
    sizes = most * random.uniform(1.0 - spread, 1.0, 100) * random.choice([-1.0, 1.0], 100)
    rest = pinocchio_torque(SCARA, motion.q, 0 * motion.q, 0 * motion.q)[:, 0] + random.normal(0, NOISE, len(rests))
    tau[rests, 0] = (rest + sizes[np.floor(motion.t / PERIOD).astype(int)])[rests]
    speed = motion.dq[:, 0]
    tau[:, 0] += friction(speed) * (np.abs(speed) > 1e-6) * ~rests
    return record(SCARA, motion, tau, f"run{seed}")


def breaking_away(
    seed: int, most: float, spread: float, excess: float, vs: float = 0.012, duration: float = 60.0
) -> Recording:
    """As `held`; `excess` of it is friction that falls off at low speed."""
    return held(seed, most, spread, lambda speed: excess * np.exp(-((speed / vs) ** 2)) * np.sign(speed), duration)


def test_static_friction_that_shows_at_rest_alone_is_named_by_what_holds_the_joint(monkeypatch):
    rows = []
    monkeypatch.setattr(
        static_friction,
        "gather_state",
        lambda *asked: rows.append(asked[2].kept_rows) or gather_state(*asked),
    )
    # 0.012 rad/s is passed within a filter's width: hardly any row of the moving joint shows it.
    runs = [breaking_away(seed, COULOMB + EXCESS, 0.1, EXCESS) for seed in (1, 2)]
    found = diagnose(identify(SCARA, runs), runs)
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("stribeck", SCARA.joint_names[:1])]
    # The rows of the model are filtered once for all that is tried.
    assert len(rows) > 1
    assert rows[0]
    assert all(each is rows[0] for each in rows)
    first = found.candidates[0]
    assert first.significant
    assert "These are halts" in first.evidence
    assert first.p_value <= 0.01
    # Whether it falls off with speed or with distance, halts do not tell.
    assert first.equivalent == ("break_away",)
    grown = extend(identify(SCARA, runs), found.recommended, runs)
    (excess,) = (p.value for p in grown.parameters if p.effect == "stribeck")
    assert excess == pytest.approx(EXCESS, rel=0.6)


@pytest.mark.parametrize("vs", [0.014, 0.016])
def test_six_halts_are_enough_where_the_moving_rows_ask_for_the_same_friction(vs: float):
    run = breaking_away(3, COULOMB + EXCESS, 0.1, EXCESS, vs, duration=21.0)
    plain = identify(SCARA, [run])
    seen = find_halts([compare(plain, run)], 0)
    assert len(seen.beyond) == seen.count_large(float(plain.noise[0])) == 6
    # Alone they are not: of a joint without static friction two halts in five may hold as much.
    assert SCARA.n * seen.compute_p(float(plain.noise[0])) > 0.01
    found = diagnose(plain, [run])
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("stribeck", SCARA.joint_names[:1])]
    assert "These are halts" in found.candidates[0].evidence
    assert found.candidates[0].p_value <= 0.01


@pytest.mark.parametrize("seed", range(1, 7))
def test_six_halts_that_a_brake_held_are_not(seed: int):
    run = breaking_away(seed, COULOMB + EXCESS, 0.1, 0.0, duration=21.0)
    assert "stribeck" not in {choice.effect for choice in diagnose(identify(SCARA, [run]), [run]).recommended}


@pytest.mark.parametrize(("most", "spread"), [(0.95 * COULOMB, 0.1), (4 * COULOMB, 1.0)])
def test_neither_coulomb_friction_at_its_limit_nor_a_brake_is_static_friction(most: float, spread: float):
    runs = [breaking_away(seed, most, spread, 0.0) for seed in (1, 2)]
    # A brake holds whatever there is to hold: nothing like that is in the friction of the moving joint.
    found = diagnose(identify(SCARA, runs), runs)
    assert "stribeck" not in {choice.effect for choice in found.recommended}


@pytest.mark.parametrize(("size", "vs"), [(3.0, 0.3), (3.0, 0.5)])
def test_friction_that_saturates_is_one_nonlinear_friction_though_no_power_of_the_velocity_is_like_it(size, vs):
    runs = [held(seed, COULOMB, 0.1, lambda speed: size * COULOMB * np.tanh(speed / vs)) for seed in (1, 2)]
    found = diagnose(identify(SCARA, runs), runs)
    assert [choice.effect for choice in found.recommended] == ["viscous_nonlinear"]


def test_friction_that_saturates_lowers_the_error_at_rest_as_well_as_where_the_joint_moves():
    runs = [held(seed, COULOMB, 0.1, lambda speed: 0.5 * COULOMB * np.tanh(speed / 0.15)) for seed in (1, 2)]
    plain = identify(SCARA, runs)
    grown = extend(plain, [EffectChoice("viscous_nonlinear", SCARA.joint_names[:1], (("p", 0.5),))], runs)
    assert grown.fit_moving.rms[0] < 0.5 * plain.fit_moving.rms[0]
    # Continued to zero, the power would hold 2.4 N m of 3 at rest.
    assert grown.fit.rms[0] < 0.5 * plain.fit.rms[0]


def test_halts_tell_nothing_beside_a_power_of_the_velocity_which_may_have_taken_the_friction_from_them() -> None:
    runs = [breaking_away(seed, COULOMB + EXCESS, 0.1, EXCESS) for seed in (1, 2)]
    curved = EffectChoice("viscous_nonlinear", SCARA.joint_names[:1], (("p", 0.5),))
    found = diagnose(extend(identify(SCARA, runs), [curved], runs), runs)
    assert "stribeck" not in {choice.effect for choice in found.recommended}


def test_laws_of_the_velocity_take_friction_from_halts_and_those_of_the_path_do_not() -> None:
    stribeck = CATALOGUE["stribeck"]
    assert is_extrapolated(stribeck, {"coulomb", "viscous_nonlinear"})
    assert not is_extrapolated(stribeck, {"coulomb", "viscous", "presliding"})


def halts(beyond: np.ndarray, friction: float, along: float = 0.5) -> Halts:
    each = np.full(len(beyond), friction)
    towards = (np.arange(len(beyond)) < along * len(beyond)).astype(float)
    return Halts(beyond, each, beyond**2, np.ones(len(beyond)), towards)


def test_halts_speak_for_static_friction_where_nearly_all_hold_much_more_than_the_friction_and_the_noise() -> None:
    most, noise = np.full(20, 0.5), 0.05
    assert halts(most, 1.0).count_large(noise) == 20
    assert halts(most, 1.0).compute_p(noise) < 1e-6
    # Little beside the friction, little beside the noise, or a model that has no friction that could be exceeded.
    assert halts(0.3 * most, 1.0).count_large(noise) == 0
    assert halts(most, 1.0).count_large(0.2) == 0
    assert halts(most, 0.0).count_large(noise) == 0
    half = np.where(np.arange(20) < 10, 0.5, 0.1)
    assert halts(half, 1.0).compute_p(noise) > 0.1
    assert halts(np.zeros(0), 1.0).compute_p(noise) == 1.0


def test_what_a_brake_holds_is_not_alike_from_halt_to_halt() -> None:
    assert halts(np.linspace(0.45, 0.55, 20), 1.0).are_alike
    assert not halts(np.linspace(0.2, 3.0, 20), 1.0).are_alike


def test_what_friction_holds_is_towards_the_motion_beside_it_and_what_a_brake_holds_towards_either_side() -> None:
    sizes = np.linspace(0.2, 3.0, 20)
    assert halts(sizes, 1.0, 0.95).are_along_the_motion
    assert not halts(sizes, 1.0, 0.8).are_along_the_motion
    # Four halts of a brake are all on one side in one of sixteen joints.
    assert not halts(sizes[:4], 1.0, 1.0).are_along_the_motion


def test_each_rest_of_a_joint_is_a_halt_and_what_is_held_beyond_its_friction_is_its_distance_from_the_band() -> None:
    run = breaking_away(1, COULOMB + EXCESS, 0.1, 0.0)
    compared = compare(identify(SCARA, [run]), run)
    found = find_halts([compared], 0)
    rests = round(60.0 / PERIOD)
    assert rests - 1 <= len(found.beyond) <= rests + 1
    assert np.median(found.friction) == pytest.approx(COULOMB, rel=0.1)
    assert np.median(found.beyond) == pytest.approx(0.95 * (COULOMB + EXCESS) - COULOMB, rel=0.25)
    assert 0.25 <= found.along.mean() <= 0.75
    sticks = resting(1, EXCESS, 0.03)
    assert find_halts([compare(identify(SCARA, [sticks]), sticks)], 0).along.mean() >= 0.9


def state_of(*, turns: bool) -> State:
    """As much of a state as the choice looks at: one run, and the kinds of rows that candidates are about."""
    run = SimpleNamespace(run=np.zeros(40, dtype=int))
    data = SimpleNamespace(moving=run, find_row_kinds=lambda columns: (turns, False))
    pool = SimpleNamespace(is_change=lambda candidate: candidate.runs == ("later",))
    return State(cast(Any, data), cast(Any, pool), (), np.ones(1), np.ones(1))


def counted(joints: int) -> State:
    """A state that knows how many rows a candidate is about."""
    data = SimpleNamespace(count_rows=lambda columns: np.ones((40, joints)))
    pool = SimpleNamespace(is_change=lambda candidate: False)
    return State(cast(Any, data), cast(Any, pool), (), np.ones(joints), 0.1 * np.ones(joints))


def test_what_would_reach_far_beyond_the_data_is_no_finding_though_it_is_no_chance():
    state = counted(1)
    gains, rows = np.linspace(1.0, 2.0, 40), np.ones((40, 1))
    seen = judged(gains, name="viscous_asymmetric", p=1e-3, t=4.0, drop=0.3, before=2.0 * rows, after=rows)
    assert find_rejection(state, replace(seen, separability=0.1)) is None
    assert find_rejection(state, replace(seen, separability=0.03)) is not None


def test_warmth_that_says_nearly_as_much_of_it_leaves_no_wear(monkeypatch):
    gains = np.linspace(1.0, 2.0, 40)
    worn = judged(gains, name="coulomb")
    worn = replace(worn, candidate=replace(worn.candidate, runs=("later",)))
    monkeypatch.setattr(next_finding, "find_rejection", lambda state, item: None)
    monkeypatch.setattr(next_finding, "find_impossibility", lambda state, item: None)
    state = state_of(turns=False)

    def nothing_left(state, others):
        return [judged(0.0 * gains, name=one.effect) for one in others]

    monkeypatch.setattr(next_finding, "score_all", nothing_left)
    for share, name, other, named in (
        (0.95, "temperature_friction", (6, 7), "temperature_friction"),
        (0.5, "temperature_friction", (6, 7), "coulomb"),
        (0.95, "load_dependent_friction", (6, 7), "coulomb"),
    ):
        warm = judged(share * gains, columns=other, name=name)
        found = next_finding.select_candidate(state, [worn, warm])
        assert found is not None
        assert found[0].candidate.effect == named


@pytest.mark.parametrize(("left", "named"), [(1.5, "presliding"), (1.98, None)])
def test_friction_that_remembers_the_path_is_named_where_it_lowers_the_error_of_moving_joints_alone(
    monkeypatch, left, named
):
    rows, gains = np.ones((40, 1)), np.linspace(1.0, 2.0, 40)
    sliding = judged(gains, name="presliding")
    asked = []

    def where_it_moves(state, candidates, *, kinds=None):
        asked.append(kinds)
        return [judged(gains, name="presliding", before=2.0 * rows, after=left * rows)]

    monkeypatch.setattr(next_finding, "find_rejection", lambda state, item: None)
    monkeypatch.setattr(next_finding, "find_impossibility", lambda state, item: None)
    monkeypatch.setattr(next_finding, "score_all", where_it_moves)
    found = next_finding.select_candidate(state_of(turns=True), [sliding])
    assert (found and found[0].candidate.effect) == named
    assert asked == [(False, False)]


def test_what_is_small_beside_a_rough_formula_is_taken_for_what_it_leaves():
    rows = np.ones((40, 1))
    floor = np.ones(1)
    cable = judged(np.ones(40), name="cable_force", before=100.0 * rows, after=rows)
    spring = judged(np.ones(40), name="joint_spring", before=100.0 * rows, after=rows)
    small, large = (judged(np.ones(40), name="offset", before=b * rows, after=rows) for b in (2.5, 7.0))
    assert is_shadowed(small, cable, floor)
    assert not is_shadowed(large, cable, floor)
    assert not is_shadowed(small, spring, floor)
    # What friction of one joint leaves is on that joint.
    law = judged(np.ones(40), name="viscous_nonlinear", before=100.0 * rows, after=rows)
    assert is_shadowed(small, law, floor)
    assert not is_shadowed(replace(small, joints=(1,)), law, floor)


def test_a_cable_that_helps_one_of_its_two_joints_alone_is_a_function_of_that_joint():
    state = counted(2)
    before = np.column_stack([np.linspace(4.0, 5.0, 40), np.linspace(9.0, 10.0, 40)])

    def cable(left: tuple[float, float]) -> ScoredCandidate:
        return judged(
            np.ones(40), name="cable_force", joints=(0, 1), before=before, after=before * left, p=1e-3, drop=0.8
        )

    assert find_rejection(state, cable((0.5, 0.1))) is None
    assert find_rejection(state, cable((1.0, 0.1))) is not None
    assert find_rejection(state, cable((0.99, 0.1))) is not None
