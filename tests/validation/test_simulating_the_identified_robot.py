"""The simulator with the identified parameters, and filters chosen by simulating the identification."""

from __future__ import annotations

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from support.measured_arm import BAND, EFFECTS, FC, IA, NOISE, ROBOT, recorded, with_values
from support.oracles import pinocchio_torque

from dynident.effects import EffectChoice
from dynident.effects.friction import bound_friction
from dynident.errors import Cancelled, DynidentError
from dynident.identification import (
    Identification,
    IdentificationChoices,
    extend,
    from_bytes,
    identify,
    make_physical,
    to_bytes,
)
from dynident.identification.equations.reduced_recordings import find_largest_speeds, reduce_to_rows
from dynident.identification.estimators.feasible import find_nearest_feasible
from dynident.identification.estimators.feasible_problem import _list_not_negative, list_friction_bounds
from dynident.identification.estimators.identified_robot_simulator import build_simulator, read_longest_piece
from dynident.identification.identified_models import remove_and_solve_again
from dynident.identification.identified_models.remove_and_solve_again import list_impossible
from dynident.recordings import filtered_blocks
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.simulation import TrueEffect, VirtualRobot
from dynident.validation import filters_by_simulation, sensor_noise, validate_drift, validate_simulation


def of_effect(identified, effect: str) -> list[int]:
    return [k for k, column in enumerate(identified.model.kept) if column.effect == effect]


def test_the_simulated_robot_gives_the_torque_that_was_recorded(identified, unseen):
    found = validate_simulation(identified, unseen)
    assert found.judged.verdict == "pass"
    assert found.torque.relative_total == pytest.approx(identified.held_out.relative_total, rel=0.5)
    assert np.all(found.position_share < 0.01)
    assert 10.0 < found.duration <= 12.0


def test_the_simulated_robot_has_the_identified_parameters(identified):
    virtual = build_simulator(identified.model, identified.values).robot
    q = np.array([[0.3, -1.0, 0.8, 0.2, 0.5, -0.4]])
    still = np.zeros_like(q)
    acceleration = np.full_like(q, 0.7)
    nothing, clock = np.zeros(0), np.zeros(1)
    rest = virtual.dynamics.rest(q, still, acceleration, still, nothing, clock, still, nothing)
    torque = (virtual.dynamics.rigid(q, still, acceleration) + rest)[0]
    expected = pinocchio_torque(ROBOT, q, still, acceleration)[0] + IA * 0.7
    assert torque == pytest.approx(expected, rel=0.03, abs=1.5)


def test_a_negative_rotor_that_only_a_sum_determines_is_taken_over_by_the_link(identified):
    simulator = build_simulator(identified.model, identified.values)
    assert simulator.values == pytest.approx(identified.values, rel=1e-6, abs=1e-6)
    values = identified.values.copy()
    (k,) = [k for k, column in enumerate(identified.model.kept) if column.name in ("ZZ1", "Ia1")]
    values[k] -= 3.0
    shifted = build_simulator(identified.model, values)
    assert shifted.values == pytest.approx(values, rel=1e-6, abs=1e-6)
    assert all(dict(one.values)["Ia"] >= 0 for one in shifted.robot.effects if one.effect == "rotor_inertia")


def test_wrong_parameters_fail_with_the_joint_named(identified, unseen):
    values = identified.values.copy()
    values[of_effect(identified, "coulomb")[1]] += 200.0
    found = validate_simulation(with_values(identified, values), unseen)
    assert found.judged.verdict == "fail"
    assert ROBOT.joint_names[1] in found.judged.reason


def test_instead_of_friction_that_drives_the_nearest_robot_is_simulated_and_named(identified, unseen):
    values = identified.values.copy()
    values[of_effect(identified, "viscous")[0]] = -5.0
    found = validate_simulation(with_values(identified, values), unseen)
    assert found.judged.verdict == "pass"
    assert "Fv1 = -5 " in found.judged.reason
    assert "on held-out data is" in found.judged.reason
    drift = validate_drift(with_values(identified, values), [unseen])
    assert np.isfinite(drift.drift.distance).all()
    assert "Fv1 = -5 " in drift.judged.reason


def test_a_model_that_can_be_simulated_stays_as_it_is(identified):
    possible = make_physical(identified)
    assert possible.identification is identified
    assert (possible.impossible, possible.note, possible.is_possible) == ((), "", True)


def test_a_rotor_below_zero_is_solved_again_and_the_cost_is_said(identified):
    values = identified.values.copy()
    rotor = of_effect(identified, "rotor_inertia")[-1]
    values[rotor] = -0.4
    possible = make_physical(with_values(identified, values))
    assert possible.identification.values[rotor] >= -1e-9
    assert possible.impossible[0].startswith(f"{identified.model.kept[rotor].name} = -0.4 ")
    assert re.search(r"held-out data is [\d.]+\s% instead of [\d.]+\s%", possible.note)


def test_friction_that_drives_at_some_speed_is_no_friction(identified, training):
    bent = extend(identified, [EffectChoice("viscous_nonlinear", ("elbow_joint",), (("p", 2.0),))], [training])
    assert bent.estimate.speeds == pytest.approx(
        np.max([np.abs(block.dq[block.used]).max(axis=0) for block in filtered_blocks(training, BAND)], axis=0)
    )
    assert make_physical(bent).note == ""
    kept = from_bytes(to_bytes(bent))
    np.testing.assert_array_equal(kept.estimate.speeds, bent.estimate.speeds)
    # Below zero beside other friction: a part of a sum that resists is possible, a sum that drives is not.
    values, [viscous] = bent.values.copy(), [k for k, c in enumerate(bent.model.kept) if c.name == "Fv3"]
    dry, speed = values[[c.name for c in bent.model.kept].index("Fc3")], bent.estimate.speeds[2]
    values[viscous] = -0.5 * dry / speed
    assert make_physical(with_values(bent, values)).impossible == ()
    values[viscous] = -4.0 * dry / speed
    driving = with_values(bent, values)
    possible = make_physical(driving)
    assert possible.impossible == ("friction of elbow_joint that drives it",)
    assert list_impossible(possible.identification) == []
    nearest = find_nearest_feasible(
        bent.model, bent.data.equations, driving.estimate.solution, bent.choices.trust, speeds=bent.estimate.speeds
    )
    assert "friction of elbow_joint" in nearest.limits
    standard = nearest.standard.values
    for bound in list_friction_bounds(bent.model, bent.estimate.speeds):
        assert bound.weights @ standard[bound.columns] > -1e-6 * dry


def test_friction_that_falls_beyond_the_recorded_speeds_brakes_the_simulated_robot():
    effects = [
        TrueEffect("coulomb", "elbow_joint", (("Fc", 1.0),)),
        TrueEffect("viscous", "elbow_joint", (("Fv", 9.0),)),
    ]
    cubic = TrueEffect("viscous_nonlinear", "elbow_joint", (("Fvn", -3.0),), (("p", 3.0),))
    for speeds, expected in ((None, 1 + 27 - 81.0), (np.full(ROBOT.n, 1.0), 1 + 9 - 3.0)):
        dynamics = VirtualRobot(ROBOT, [*effects, cubic], speeds=speeds).dynamics
        still, nothing = np.zeros((2, ROBOT.n)), np.zeros((2, 0))
        dq = still.copy()
        dq[:, 2] = 3.0, -3.0
        torque = dynamics.rest(still, dq, still, still, nothing, np.zeros((2, 1)), still, nothing)
        np.testing.assert_allclose(torque[:, 2], [expected, -expected])
    # Beside other friction viscous friction may be a negative part of a sum; alone it would drive the joint.
    rising = TrueEffect("viscous_nonlinear", "elbow_joint", (("Fvn", 3.0),), (("p", 0.5),))
    negative = TrueEffect("viscous", "elbow_joint", (("Fv", -0.1),))
    VirtualRobot(ROBOT, [effects[0], negative, rising])
    with pytest.raises(DynidentError, match="zero or above"):
        VirtualRobot(ROBOT, [effects[0], negative])


def test_without_a_robot_that_can_exist_nothing_is_simulated(identified, unseen, monkeypatch):
    def refuse(*_: object) -> None:
        raise DynidentError("no parameters")

    monkeypatch.setattr(remove_and_solve_again, "reidentify", refuse)
    values = identified.values.copy()
    values[of_effect(identified, "viscous")[0]] = -5.0
    found = validate_simulation(with_values(identified, values), unseen)
    assert (found.judged.verdict, found.torque) == ("fail", None)
    assert "Fv1 = -5 " in found.judged.reason


def test_effects_of_the_catalogue_are_in_the_simulated_robot(identified, training):
    grown = extend(identified, [EffectChoice("joint_spring", ("elbow_joint",))], [training])
    assert any(
        one.effect == "joint_spring" and one.joint == "elbow_joint"
        for one in build_simulator(grown.model, grown.values).robot.effects
    )
    assert validate_simulation(grown, training, longest=4.0).judged.verdict == "pass"


def test_only_the_longest_stretch_inside_the_windows_is_simulated(identified, unseen):
    windowed = unseen.with_windows(((1.0, 2.0), (4.0, 8.0)))
    motion = read_longest_piece(windowed, BAND, 20.0)
    assert motion.reference.t[0] == pytest.approx(4.0, abs=0.02)
    assert motion.reference.t[-1] == pytest.approx(8.0, abs=0.02)
    assert len(motion.tau) == len(motion.reference.t)
    cut = read_longest_piece(windowed, BAND, 1.5)
    assert cut.reference.duration == pytest.approx(1.5, abs=0.02)


def test_too_short_a_stretch_is_not_evaluated_and_none_is_refused(identified, unseen):
    short = unseen.with_windows(((2.0, 2.2),))
    assert validate_simulation(identified, short).judged.verdict == "not_evaluated"
    with pytest.raises(DynidentError, match="consecutive samples"):
        validate_simulation(identified, unseen.with_windows(((2.001, 2.002),)))
    with pytest.raises(DynidentError) as refused:
        validate_simulation(identified, unseen, longest=0.0)
    assert refused.value.pointer == "/longest"


def test_the_noise_of_the_sensors_is_told_from_the_motion():
    found = sensor_noise(recorded(3, 20.0, "noisy", encoder=1e-4))
    assert found.position == pytest.approx(np.full(ROBOT.n, 1e-4), rel=0.1)
    assert found.torque == pytest.approx(NOISE, rel=0.15)
    silent = sensor_noise(recorded(3, 20.0, "silent", noise=0.0))
    assert np.all(silent.torque < 0.02 * FC)


@pytest.mark.slow
def test_filters_that_are_too_wide_are_found_out_and_the_proposed_ones_are_better():
    """Encoder noise that no filter holds back biases the accelerations' parameters."""
    noisy, other = recorded(5, 20.0, "noisy", encoder=2e-4), recorded(6, 20.0, "other", encoder=2e-4)
    bad = replace(BAND, position_cutoff=16.0, torque_cutoff=14.0)
    found = identify(ROBOT, [noisy], [other], IdentificationChoices(effects=EFFECTS, preprocessing=bad))
    result = filters_by_simulation(found, noisy, cutoffs=[2.0, 4.0, 8.0, 16.0])
    assert result.judged.verdict == "fail"
    assert result.used.preprocessing == bad
    assert result.chosen.preprocessing.position_cutoff < 16.0
    assert result.chosen.error < result.used.error
    better = identify(
        ROBOT,
        [noisy],
        [other],
        IdentificationChoices(effects=EFFECTS, preprocessing=result.chosen.preprocessing),
    )
    inertias = of_effect(found, "rotor_inertia")
    truth = {f"Ia{j + 1}": IA[j] for j in range(ROBOT.n)}
    names = [found.model.kept[k].name for k in inertias]
    wrong, right = (
        np.sqrt(np.mean([(one.values[k] - truth[name]) ** 2 for k, name in zip(inertias, names, strict=True)]))
        for one in (found, better)
    )
    assert right < wrong


@pytest.mark.slow
def test_good_filters_pass(identified, training):
    result = filters_by_simulation(identified, training, cutoffs=[5.0, 10.0, 20.0])
    assert result.judged.verdict == "pass"
    assert all(trial.error is not None and trial.bias <= trial.error for trial in result.trials)


def test_a_robot_that_cannot_move_cannot_choose_filters(identified, training):
    plain = identify(ROBOT, [training], choices=replace(identified.choices, estimator="wls"))
    with pytest.raises(DynidentError, match="feasible") as refused:
        filters_by_simulation(with_values(plain, -plain.values), training, longest=3.0)
    assert refused.value.title == "Identification cannot be simulated"


def test_multiples_of_a_stated_cutoff_that_no_filter_reaches_are_left_out(identified, training):
    near = 0.35 * training.sampling_rate
    result = filters_by_simulation(identified, training, cutoffs=[near], longest=2.0)
    stated = [trial.preprocessing for trial in result.trials[1:]]
    assert [p.torque_cutoff for p in stated] == pytest.approx([0.5 * near, near], rel=5e-3)


def test_cutoffs_beyond_nyquist_are_refused(identified, training):
    with pytest.raises(DynidentError) as refused:
        filters_by_simulation(identified, training, cutoffs=[5.0, 60.0], longest=2.0)
    assert refused.value.pointer == "/cutoffs/1"


def test_bent_friction_of_one_joint_lets_the_friction_of_no_other_be_negative(identified, training):
    bent = extend(identified, [EffectChoice("stribeck", ("shoulder_pan_joint",))], [training])
    values, names = bent.values.copy(), [column.name for column in bent.model.kept]
    values[names.index("Fv3")] = -0.7
    driving = with_values(bent, values)
    assert any(reason.startswith("Fv3 = -0.7 ") for reason in list_impossible(driving))
    assert list_impossible(make_physical(driving).identification) == []
    not_negative = {bent.model.columns[k].name for k in _list_not_negative(bent.model)}
    assert {"Fc3", "Fv3"} <= not_negative
    assert not {"Fc1", "Fv1"} & not_negative
    own = bent.model.compute_standard_inertia(bent.values).reshape(-1, 10)
    friction = [TrueEffect("stribeck", ROBOT.joint_names[0], (("Fst", 1.0),))]
    VirtualRobot(ROBOT, (*friction, TrueEffect("viscous", ROBOT.joint_names[0], (("Fv", -0.1),))), inertias=own)
    with pytest.raises(DynidentError, match="zero or above"):
        VirtualRobot(ROBOT, (*friction, TrueEffect("viscous", ROBOT.joint_names[2], (("Fv", -0.1),))), inertias=own)


def test_friction_of_a_model_without_stored_speeds_resists_up_to_the_joints_limits(identified, training):
    bent = extend(identified, [EffectChoice("viscous_nonlinear", ("elbow_joint",), (("p", 2.0),))], [training])

    def make_old(viscous: float, limited: bool) -> Identification:
        robot = bent.model.robot
        joints = [j if limited else replace(j, limits=replace(j.limits, velocity=None)) for j in robot.joints]
        model = replace(bent.model, robot=replace(robot, joints=tuple(joints)))
        values = bent.values.copy()
        values[[column.name for column in model.kept].index("Fv3")] = viscous
        estimate = replace(bent.estimate, model=model, speeds=None)
        estimate = replace(estimate, solution=replace(estimate.solution, values=values))
        return replace(bent, estimate=estimate, data=replace(bent.data, speeds=None))

    assert list_impossible(make_old(-0.01, limited=True)) == []
    driving = make_old(-40.0, limited=True)
    assert list_impossible(driving) == ["friction of elbow_joint that drives it"]
    assert list_impossible(make_physical(driving).identification) == []
    # Without any speed no sum can be looked at, so that each part has to resist.
    assert [reason.split(" = ")[0] for reason in list_impossible(make_old(-0.01, limited=False))] == ["Fv3"]
    assert list_impossible(make_physical(make_old(-40.0, limited=False)).identification) == []


def test_speeds_of_friction_tests_count_as_recorded_and_the_search_for_them_can_be_stopped(identified, training):
    bent = extend(identified, [EffectChoice("stribeck", ("elbow_joint",))], [training])
    slow = replace(training, windows=((0.0, 4.0),))
    rows = bent.choices.row_options
    inputs = RegressorInputs((slow, replace(training, role="friction")), BAND, bent.estimate.reference)
    reported: list[tuple[float, str]] = []
    reduced = reduce_to_rows(bent.model, rows, inputs, lambda *report: reported.append(report))
    assert reduced.speeds == pytest.approx(bent.estimate.speeds)
    alone = find_largest_speeds(bent.model, replace(inputs, recordings=(slow,)))
    assert np.any(alone < 0.99 * bent.estimate.speeds)
    fractions = [fraction for fraction, _ in reported]
    assert fractions == sorted(fractions)
    assert "finding the largest speeds" in [message for _, message in reported]

    def stop(_fraction: float, message: str) -> None:
        if message == "finding the largest speeds":
            raise Cancelled

    with pytest.raises(Cancelled):
        reduce_to_rows(bent.model, rows, inputs, stop)


def test_a_falling_straight_line_of_friction_does_not_fall_beyond_the_recorded_speed():
    dq = ca.SX.sym("dq", 1)
    line = ca.Function("line", [dq], [bound_friction(2 * ca.sign(dq) - 0.5 * dq, dq, np.array([3.0]))])
    for speed, expected in ((1.0, 1.5), (3.0, 0.5), (9.0, 0.5)):
        assert float(line(speed)) == pytest.approx(expected)
        assert float(line(-speed)) == pytest.approx(-expected)
    growing = ca.Function("line", [dq], [bound_friction(2 * ca.sign(dq) + 0.5 * dq, dq, np.array([3.0]))])
    assert float(growing(9.0)) == pytest.approx(6.5)
