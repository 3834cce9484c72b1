"""The simulator with the identified parameters, and filters chosen by simulating the identification."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.measured_arm import BAND, EFFECTS, FC, IA, NOISE, ROBOT, recorded, with_values
from support.oracles import pinocchio_torque

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, extend, identify
from dynident.identification.estimators.identified_robot_simulator import build_simulator, read_longest_piece
from dynident.validation import filters_by_simulation, sensor_noise, validate_simulation


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


def test_friction_that_drives_cannot_be_simulated_and_fails(identified, unseen):
    values = identified.values.copy()
    values[of_effect(identified, "viscous")[0]] = -5.0
    found = validate_simulation(with_values(identified, values), unseen)
    assert found.judged.verdict == "fail"
    assert found.torque is None
    assert "Fv" in found.judged.reason


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
