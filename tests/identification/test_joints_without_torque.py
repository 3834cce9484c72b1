"""A joint that moves and whose torque was not recorded: its equation is left out, its motion is used."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import FloatArray, guess, log, read

import dynident as dy
from dynident.array_types import BoolArray
from dynident.diagnosis import compare, diagnose
from dynident.effects import EffectChoice
from dynident.errors import DynidentError, Remedy
from dynident.estimation import Errors
from dynident.export import PredictingModel, export_model
from dynident.identification import (
    Identification,
    IdentificationChoices,
    extend,
    from_bytes,
    identify,
    remove,
    to_bytes,
)
from dynident.identification.identified_models.torque_prediction import predict
from dynident.recordings import Recording, RecordingError, open_recording
from dynident.recordings.joint_phases import Phase
from dynident.validation import validate_simulation
from dynident.verdict import verdict

CASES = [("ur10", 4, 3, 100.0), ("ur10", 0, 4, 200.0), ("franka_panda", 6, 5, 100.0)]


def silenced(tau: FloatArray, joint: int, value: float = np.nan) -> FloatArray:
    changed = tau.copy()
    changed[:, joint] = value
    return changed


@cache
def recorded(folder: Path, name: str, joint: int, seed: int, rate: float) -> tuple[Recording, Recording]:
    """Two recordings of an arm without the torque of a joint."""
    found = []
    for k in (seed, seed + 10):
        given = log(name, k, rate)
        (folder / str(k)).mkdir(exist_ok=True)
        found.append(read(given.robot, folder / str(k), given.columns(tau=silenced(given.tau, joint))).recording)
    return found[0], found[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("silent")


@cache
def identified(folder: Path, name: str, joint: int, seed: int, rate: float) -> Identification:
    fit, held = recorded(folder, name, joint, seed, rate)
    return identify(log(name, seed, rate).robot, [fit], [held])


def errors_without(errors: Errors, joint: int) -> float:
    keep = np.arange(len(errors.squares)) != joint
    return float(np.sqrt(errors.squares[keep].sum() / errors.measured[keep].sum()))


@pytest.mark.sweep
@pytest.mark.parametrize(("name", "joint", "seed", "rate"), CASES)
def test_the_other_joints_are_identified_as_well_as_with_it(
    folder: Path, name: str, joint: int, seed: int, rate: float
) -> None:
    given = log(name, seed, rate)
    found, silent = identified(folder, name, joint, seed, rate), given.robot.joint_names[joint]
    assert found.held_out is not None
    assert found.held_out.counts[joint] == 0
    assert np.delete(found.held_out.counts, joint).all()
    whole = []
    for k in (seed, seed + 10):
        (folder / f"whole {k}").mkdir(exist_ok=True)
        more = log(name, k, rate)
        whole.append(read(more.robot, folder / f"whole {k}", more.columns()).recording)
    with_it = identify(given.robot, whole[:1], whole[1:])
    assert with_it.held_out is not None
    assert errors_without(found.held_out, joint) < 1.2 * errors_without(with_it.held_out, joint)
    # Its own friction and drive are not known, and said to be.
    assert not [one for one in found.parameters if one.link == silent and one.effect in ("coulomb", "viscous")]
    (told,) = [one for one in found.warnings if silent in one and "not identifiable" in one]
    assert f"Fc{joint + 1}, Fv{joint + 1}" in told
    assert not [one for one in found.warnings if one.startswith("Left out, because")]
    # What is in both models has the same values.
    known = {one.name: one for one in with_it.parameters}
    for one in found.parameters:
        other = known[one.name]
        if other.standard_deviation > 0 and one.effect in ("coulomb", "viscous"):
            assert one.value == pytest.approx(other.value, abs=6 * other.standard_deviation, rel=0.02)


@pytest.mark.parametrize(("name", "joint", "seed", "rate"), CASES[:1])
def test_whatever_is_done_with_the_model_goes_on_without_that_torque(
    folder: Path, name: str, joint: int, seed: int, rate: float
) -> None:
    found = identified(folder, name, joint, seed, rate)
    fit, held = recorded(folder, name, joint, seed, rate)
    silent = found.model.robot.joint_names[joint]
    again = from_bytes(to_bytes(found))
    assert again.model.robot.joints_without_torque == (silent,)
    assert again.model.base.kept == found.model.base.kept
    state = (np.full(found.model.robot.n, 0.3), *np.ones((2, found.model.robot.n)))
    stepped = PredictingModel.from_identification(found).predictor().step(*state)
    assert np.flatnonzero(np.isnan(stepped)).tolist() == [joint]
    np.testing.assert_allclose(predict(found.estimate, *(row[None] for row in state)).torque[0], stepped)
    comparison = compare(found, held)
    assert (comparison.phase[:, joint] == Phase.NO_TORQUE).all()
    assert comparison.errors.counts[joint] == 0
    assert not comparison.residual[:, joint].any()
    diagnosis = diagnose(found, [fit])
    assert not [one for one in diagnosis.recommended if one.joints == (silent,)]
    grown = extend(again, [EffectChoice("offset")], [fit], [held])
    assert {one.link for one in grown.parameters if one.effect == "offset"} == set(fit.joint_names) - {silent}
    with pytest.raises(DynidentError):
        extend(again, [EffectChoice("stribeck", (silent,))], [fit], [held])
    fewer = remove(grown, [EffectChoice("offset")])
    assert fewer.model.n_parameters == found.model.n_parameters
    simulated = validate_simulation(found, held)
    assert simulated.torque is None or simulated.torque.counts[joint] == 0
    for form in ("urdf", "c", "json"):
        assert any(silent in note and "No recording" in note for note in export_model(found, form).notes)
    judged = verdict(found, [fit], [held])
    assert all(silent in use.reason for use in judged.uses if use.fit)


@pytest.mark.sweep
@pytest.mark.parametrize("estimator", ["ols", "irls", "feasible", "ekf"])
def test_every_estimator_does_without_it(folder: Path, estimator: str) -> None:
    name, joint, seed, rate = CASES[0]
    fit, held = recorded(folder, name, joint, seed, rate)
    found = identify(log(name, seed, rate).robot, [fit], [held], IdentificationChoices(estimator=estimator))
    assert found.held_out is not None
    assert found.held_out.relative_total < 0.05


@pytest.mark.parametrize("model", ["power", "energy"])
def test_what_needs_the_work_of_all_joints_is_refused(folder: Path, model: str) -> None:
    fit, _ = recorded(folder, *CASES[0])
    with pytest.raises(DynidentError, match="no torque of wrist_2_joint") as raised:
        identify(log().robot, [fit], choices=IdentificationChoices(model=model))
    assert raised.value.pointer == "/model"


def test_one_recording_with_the_torque_is_enough(folder: Path) -> None:
    name, joint, seed, rate = CASES[0]
    fit, held = recorded(folder, name, joint, seed, rate)
    given = log(name, seed + 20, rate)
    whole = read(given.robot, folder, given.columns()).recording
    found = identify(given.robot, [fit, whole], [held])
    assert found.model.robot.joints_without_torque == ()
    assert [one for one in found.parameters if one.link == "wrist_2_joint" and one.effect == "coulomb"]
    assert found.held_out is not None
    assert found.held_out.counts[joint] == 0


def test_a_torque_without_numbers_or_one_that_is_said_not_to_be_recorded_is_told_and_kept(tmp_path: Path) -> None:
    given = log()
    found = read(given.robot, tmp_path, given.columns(tau=silenced(given.tau, 4)))
    (told,) = [one for one in found.checks if one.name == "joint_torque"]
    assert told.status == "warning"
    assert "wrist_2_joint has no torque: its equation is left out, its motion is used" in told.detail
    assert not [one for one in found.checks if one.name in ("rows_left_out", "missing_values") and one.status != "ok"]
    assert found.recording.path is not None
    assert open_recording(found.recording.path).joints_without_torque == ("wrist_2_joint",)
    columns = {key: values for key, values in given.columns().items() if key != "tau5"}
    with pytest.raises(RecordingError, match=r'"columns": \{"tau5": "none"\}; the motion of the joint is still used'):
        read(given.robot, tmp_path, columns)
    said = read(given.robot, tmp_path, columns, columns={"tau5": "none"})
    assert said.recording.joints_without_torque == ("wrist_2_joint",)


def test_a_torque_that_is_zero_throughout_is_refused_with_that_as_its_cure(tmp_path: Path) -> None:
    given = log()
    columns = given.columns(tau=silenced(given.tau, 4, 0.0))
    with pytest.raises(RecordingError, match="the torque was not recorded") as raised:
        read(given.robot, tmp_path, columns)
    assert '"columns": {"tau5": "none"}' in str(raised.value)
    assert read(given.robot, tmp_path, columns, cures=1).recording.joints_without_torque == ("wrist_2_joint",)


def test_a_file_without_any_torque_is_refused(tmp_path: Path) -> None:
    given = log()
    with pytest.raises(RecordingError):
        read(given.robot, tmp_path, given.columns(tau=np.full_like(given.tau, np.nan)))


@pytest.mark.parametrize("joint", [0, 2, 5])
def test_inspection_tells_it_and_asks_nothing(joint: int) -> None:
    given = log("ur10", 6)
    found = guess(given.robot, given.columns(tau=silenced(given.tau, joint)))
    assert found.questions == ()
    (told,) = [one for one in found.guesses if one.field == f"columns/tau{joint + 1}"]
    assert f"{given.robot.joint_names[joint]} has no torque" in told.reason


def test_nothing_is_predicted_of_a_joint_without_torque(folder: Path) -> None:
    name, joint, seed, rate = CASES[0]
    model = identified(folder, name, joint, seed, rate)
    n = model.model.robot.n
    q = np.random.default_rng(seed).normal(size=(3, n))
    predicted = predict(model.estimate, q, q, q)
    for values in (predicted.torque, predicted.lower, predicted.upper, predicted.mean_half_width):
        assert (np.isnan(values) == (np.arange(n) == joint)).all()
    silent = model.model.robot.joint_names[joint]
    with pytest.raises(DynidentError, match=f"the torque of {silent} was not recorded"):
        dy.Model(model).forward_dynamics(q, q, q)
    assert not [column.name for column in model.model.kept if column.link == silent and column.effect == "viscous"]


def test_a_torque_of_zero_behind_a_brake_saturates_nowhere_and_is_told_with_a_way_on(tmp_path: Path) -> None:
    given = log("ur10", 8)
    columns, m = {name: values.copy() for name, values in given.columns().items()}, len(given.t)
    halves = slice(0, m // 2), slice(m // 2, m)
    for joint in range(6):
        # The first three joints move in the first half, and then the others.
        moves, waits = halves if joint < 3 else halves[::-1]
        columns[f"q{joint + 1}"][waits] = columns[f"q{joint + 1}"][moves][-1 if joint < 3 else 0]
        columns[f"tau{joint + 1}"][waits] = 0.0
        # Gravity acts one way.
        columns[f"tau{joint + 1}"][moves] += 1.1 * np.abs(given.tau[:, joint]).max()
    with pytest.raises(RecordingError, match="its joint stands there behind its brake, with the drive off") as raised:
        read(given.robot, tmp_path, columns)
    windows = f'"windows": [[0, {given.t[m // 2 - 1]:.6g}]]'
    others = '"columns": {"tau4": "none", "tau5": "none", "tau6": "none"}'
    assert windows in raised.value.detail
    assert others in raised.value.detail
    assert [str(remedy) for remedy in raised.value.remedies[:2]] == [windows, others]
    # The first joint works in the first and the last fifth, and no other where it works.
    fifths = np.linspace(0, m, 6).astype(int)
    columns["q1"][fifths[1] : fifths[4]] = columns["q1"][fifths[1]]
    columns["q1"][fifths[4] :] = columns["q1"][fifths[1]] + given.q[fifths[4] :, 0] - given.q[fifths[4], 0]
    columns["tau1"] = given.tau[:, 0] + 1.1 * np.abs(given.tau[:, 0]).max()
    columns["tau1"][fifths[1] : fifths[4]] = 0.0
    with pytest.raises(RecordingError, match="behind its brake") as raised:
        read(given.robot, tmp_path, columns)
    spans = ((0.0, given.t[fifths[1] - 1]), (given.t[fifths[4]], given.t[m - 1]))
    assert str(Remedy("windows", spans)) in raised.value.detail
    # A torque whose one sign is cut off is 0 while its joint moves.
    columns = given.columns()
    columns["tau2"] = np.maximum(columns["tau2"] - np.quantile(columns["tau2"], 0.4), 0.0)
    with pytest.raises(RecordingError, match="or the log, saturates there"):
        read(given.robot, tmp_path, columns)


def clipped(tau: FloatArray, joints: tuple[int, ...], step: float, seed: int) -> tuple[FloatArray, BoolArray]:
    """Torques whose sensors end at nine tenths of their rows, or toggle there by a step; and where they do."""
    changed, ends = tau.copy(), np.zeros(tau.shape, dtype=bool)
    rng = np.random.default_rng(seed)
    for joint in joints:
        own = changed[:, joint]
        end = np.quantile(np.abs(own), 0.9)
        ends[:, joint] = np.abs(own) >= end
        toggles = step * np.ptp(own) * rng.integers(0, 2, len(own))
        changed[:, joint] = np.where(ends[:, joint], np.sign(own) * (end - toggles), own)
    return changed, ends


@pytest.mark.parametrize(
    ("name", "joints", "step", "seed", "rate"),
    [
        ("ur10", (1, 2), 0.0, 3, 200.0),
        ("ur10", (1,), 2.0**-12, 4, 500.0),
        ("franka_panda", (1, 3), 2.0**-12, 5, 500.0),
    ],
)
def test_rows_of_a_torque_at_its_range_are_told_and_left_out_of_that_joint_alone(
    tmp_path: Path, name: str, joints: tuple[int, ...], step: float, seed: int, rate: float
) -> None:
    found: list[list[Recording]] = [[], []]
    for number, (k, seconds) in enumerate(((seed, 30.0), (seed + 10, 20.0))):
        given = log(name, k, rate, seconds)
        tau, ends = clipped(given.tau, joints, step, k)
        for kind, torques in enumerate((given.tau, tau)):
            folder = tmp_path / f"{number} {kind}"
            folder.mkdir()
            one = read(given.robot, folder, given.columns(tau=torques))
            (told,) = [check for check in one.checks if check.name == "saturation"]
            found[kind].append(one.recording)
            if not kind:
                assert told.status == "ok"
                assert one.recording.torque_ranges == ()
        for joint in joints:
            assert f"tau{joint + 1}" in told.detail
            low, high = one.recording.torque_ranges[joint]
            beyond = (tau[:, joint] <= low) | (tau[:, joint] >= high)
            # A peak that the sensor just reaches now and then is no plateau, and needs none.
            assert (beyond == ends[:, joint]).mean() > 0.99
        assert one.recording.path is not None
        assert open_recording(one.recording.path).torque_ranges == one.recording.torque_ranges
    clean, with_ends = (identify(given.robot, [fit], [held]) for fit, held in found)
    assert clean.held_out is not None
    assert with_ends.held_out is not None
    assert with_ends.held_out.relative_total < 1.3 * clean.held_out.relative_total
    others = np.delete(np.arange(given.robot.n), joints)
    assert (with_ends.held_out.counts[others] == clean.held_out.counts[others]).all()
    assert (with_ends.held_out.counts[list(joints)] < 0.95 * clean.held_out.counts[list(joints)]).all()


def test_coarse_torques_of_a_joint_that_stands_are_at_no_range(tmp_path: Path) -> None:
    given = log("ur10", 6, 500.0)
    q, tau = given.q.copy(), given.tau.copy()
    # Joint 2 stands where gravity acts most, with a digit of noise, in the middle of the motion.
    rests = slice(len(q) // 3, len(q) // 2)
    step = 2.0**-12 * np.ptp(tau[:, 1])
    q[rests, 1] = q[rests.start, 1]
    tau[rests, 1] = np.abs(tau[:, 1]).max() + step * np.random.default_rng(0).integers(0, 2, len(q[rests]))
    columns = given.columns(q=q, tau=step * np.round(tau / step))
    accept = ("position_jump", "joint_order", "torque_scale", "held_samples", "torque_sign", "torque_order")
    found = read(given.robot, tmp_path, columns, accept=accept)
    assert [check.status for check in found.checks if check.name == "saturation"] == ["ok"]
    assert found.recording.torque_ranges == ()
