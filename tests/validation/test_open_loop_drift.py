"""A simulated robot that is left alone: its motion is Pinocchio's, and it drifts where its parameters are wrong."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice
from dynident.errors import Cancelled, DynidentError
from dynident.export import export_model
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.identification.estimators.identified_robot_simulator import RecordedMotion, build_simulator, read_pieces
from dynident.recordings import Recording
from dynident.robot import to_pinocchio
from dynident.simulation import Reference, VirtualRobot
from dynident.validation import compute_open_loop_drift, validate_drift, validate_simulation
from dynident.validation.open_loop_drift import simulate_from_many_starts
from dynident.validation.validation_request import DriftTrial, build_trial
from dynident.verdict.fitness_by_use import compute_drift, judge_simulation
from dynident.verdict.held_out_evidence import HeldOutEvidence

ROBOT = arm("ur10")
LINKS = IdentificationChoices((EffectChoice("rigid_body"),), estimator="feasible")


def test_free_motion_under_given_torque_is_that_of_the_articulated_body_algorithm() -> None:
    motion = fourier_motion(ROBOT, 1.0, 1000.0, 2)
    tau = 0.9 * pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    model = to_pinocchio(ROBOT)
    data = model.createData()
    q, dq, path = motion.q[0].copy(), motion.dq[0].copy(), []
    ddq = pin.aba(model, data, q, dq, tau[0]).copy()
    start = Reference(motion.t[:1], q[None].copy(), dq[None].copy(), ddq[None])
    # As many starts as are taken side by side, and one by itself.
    several, _ = VirtualRobot(ROBOT).move_freely([start] * 5, np.repeat(tau[:, None], 5, axis=1), 1e-3)
    alone, _ = VirtualRobot(ROBOT).move_freely([start], tau[:, None], 1e-3, returned=np.arange(0, len(tau), 7))
    found = several[:, 4]
    np.testing.assert_allclose(alone[:, 0], found[::7], rtol=1e-9)
    for row in tau:
        path.append(q.copy())
        # Runge and Kutta's method, with the torque of the sample held.
        k1 = pin.aba(model, data, q, dq, row).copy()
        k2 = pin.aba(model, data, q + 5e-4 * dq, dq + 5e-4 * k1, row).copy()
        k3 = pin.aba(model, data, q + 5e-4 * dq + 2.5e-7 * k1, dq + 5e-4 * k2, row).copy()
        k4 = pin.aba(model, data, q + 1e-3 * dq + 5e-7 * k2, dq + 1e-3 * k3, row).copy()
        q = q + 1e-3 * dq + 1e-6 / 6.0 * (k1 + k2 + k3)
        dq = dq + 1e-3 / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    moved = np.abs(np.array(path) - path[0]).max()
    assert np.abs(found[:500] - np.array(path)[:500]).max() < 0.01 * moved


def test_a_simulation_without_a_controller_reports_progress_and_can_be_stopped(heavier: Identification) -> None:
    recordings = [_record_links(1.0, 4.0, 5)]
    reports: list[float] = []
    compute_open_loop_drift(heavier, recordings, (0.1, 2.0), lambda fraction, _: reports.append(fraction))
    assert len(reports) > 5
    assert reports == sorted(reports)
    assert reports[-1] > 0.8
    reports.clear()
    validate_simulation(heavier, recordings[0], progress=lambda fraction, _: reports.append(fraction))
    assert len([fraction for fraction in reports if fraction > 0.65]) > 3
    assert reports == sorted(reports)

    def stop(fraction: float, _message: str) -> None:
        if fraction > 0.4:
            raise Cancelled

    with pytest.raises(Cancelled):
        compute_open_loop_drift(heavier, recordings, (0.1, 2.0), stop)


def test_a_right_model_stays_near_and_one_of_other_links_runs_away() -> None:
    recordings = []
    for seed in (3, 4):
        motion = fourier_motion(ROBOT, 10.0, 200.0, seed)
        recordings.append(record(ROBOT, motion, pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq), f"run{seed}"))
    right = compute_open_loop_drift(identify(ROBOT, recordings[:1], choices=LINKS), recordings[1:])
    assert right.starts > 5
    assert right.share[0].max() < 0.01
    assert right.share[1].max() < 0.05
    motion = fourier_motion(ROBOT, 10.0, 200.0, 3)
    wrong = record(ROBOT, motion, 1.3 * pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq), "wrong")
    off = compute_open_loop_drift(identify(ROBOT, [wrong], choices=LINKS), recordings[1:])
    assert off.share[1].max() > 0.3
    assert off.way == pytest.approx(right.way)


def test_what_a_tracking_controller_makes_up_for_does_not_pass() -> None:
    motion = fourier_motion(ROBOT, 10.0, 200.0, 3)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    unseen = fourier_motion(ROBOT, 6.0, 200.0, 4)
    held_out = record(ROBOT, unseen, pinocchio_torque(ROBOT, unseen.q, unseen.dq, unseen.ddq), "unseen")
    right = validate_simulation(identify(ROBOT, [record(ROBOT, motion, tau)], choices=LINKS), held_out, 0.9)
    assert right.judged.verdict == "pass"
    assert right.drift is not None
    assert "after 0.5 s" in right.judged.reason
    # Torque that is too large by a quarter: the controller follows all the same, and the limit on torque is wide.
    wrong = validate_simulation(identify(ROBOT, [record(ROBOT, motion, 1.25 * tau)], choices=LINKS), held_out, 0.9)
    assert wrong.position_share is not None
    assert wrong.position_share.max() < 0.02
    assert wrong.judged.verdict == "fail"
    assert "half a second" in wrong.judged.reason


@pytest.mark.parametrize(("effect", "gain", "delay"), [("drive_gain_error", 1.02, 0.0), ("torque_delay", 1.0, 0.02)])
def test_errors_of_the_sensors_do_not_move_the_robot(effect: str, gain: float, delay: float) -> None:
    recordings = []
    for seed in (3, 4):
        motion = fourier_motion(ROBOT, 10.0, 200.0, seed)
        tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
        shown = np.column_stack([np.interp(motion.t - delay, motion.t, column) for column in tau.T])
        shown[:, 1] *= gain
        recordings.append(record(ROBOT, motion, shown, f"run{seed}"))
    joints = (ROBOT.joint_names[1],) if effect == "drive_gain_error" else ()
    choices = replace(LINKS, effects=(*LINKS.effects, EffectChoice(effect, joints)))
    right, wrong = (compute_open_loop_drift(identify(ROBOT, recordings[:1], choices=how), recordings[1:])
                    for how in (choices, LINKS))  # fmt: skip
    assert np.linalg.norm(right.share[1]) < 0.3 * np.linalg.norm(wrong.share[1])


def _record_links(factor: float, duration: float, seed: int) -> Recording:
    motion = fourier_motion(ROBOT, duration, 200.0, seed)
    return record(ROBOT, motion, factor * pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq), f"run{seed}")


@pytest.fixture(scope="module")
def heavier() -> Identification:
    """A model of links that are a twentieth too heavy: its drift is large enough to be compared."""
    return identify(ROBOT, [_record_links(1.05, 10.0, 3)], choices=LINKS)


def _move_in_mujoco(simulated: mujoco.MjModel, motion: RecordedMotion, after: float) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity a time after the first sample, under the measured torque."""
    data, reference = mujoco.MjData(simulated), motion.reference
    data.qpos, data.qvel = reference.q[0], reference.dq[0]
    for step in range(round(after / simulated.opt.timestep)):
        # The engine holds the torque over a step; that of its middle is right to second order.
        now = reference.t[0] + (step + 0.5) * simulated.opt.timestep
        data.qfrc_applied = [np.interp(now, reference.t, column) for column in motion.tau.T]
        mujoco.mj_step(simulated, data)
    return data.qpos.copy(), data.qvel.copy()


def test_drift_is_that_of_the_exported_model_in_mujoco(heavier: Identification) -> None:
    # Each run is so short that it has one start, at its first used sample.
    recordings = [_record_links(1.0, 0.9, seed) for seed in (5, 6, 7)]
    drift = compute_open_loop_drift(heavier, recordings, (0.1, 0.5))
    assert drift.starts == 3
    simulated = mujoco.MjModel.from_xml_string(export_model(heavier, "mjcf").content.decode())
    simulated.opt.timestep, simulated.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_RK4
    pieces = [piece for recording in recordings for piece in read_pieces(recording, heavier.preprocessing)]
    for row, after in enumerate(drift.after):
        off = []
        for piece in pieces:
            t, end = piece.reference.t, piece.reference.t[0] + after
            for moved, signal in zip(
                _move_in_mujoco(simulated, piece, after), (piece.reference.q, piece.reference.dq), strict=True
            ):
                off.append(moved - [np.interp(end, t, column) for column in signal.T])
        position, speed = (np.sqrt(np.mean(np.square(off[kind::2]), axis=0)) for kind in (0, 1))
        assert drift.distance[row] == pytest.approx(position, rel=0.02, abs=0.01 * position.max())
        assert drift.speed[row] == pytest.approx(speed, rel=0.02, abs=0.01 * speed.max())


def test_starts_are_spread_over_all_segments_and_the_times_are_the_callers(heavier: Identification) -> None:
    trial = build_trial("drift", {"horizons": (1.0, 0.2)})
    assert trial == DriftTrial(horizons=(1.0, 0.2))
    recordings = [_record_links(1.0, duration, seed) for duration, seed in ((3.0, 5), (1.4, 6), (0.9, 7), (0.4, 8))]
    outcome = validate_drift(heavier, recordings, (1.0, 0.2))
    assert outcome.drift is not None
    assert outcome.drift.after == (0.2, 1.0)
    # Half a second apart: four in the first run, one in each of the next two; of the last the filters leave too little.
    assert outcome.drift.starts == 6
    assert outcome.judged.verdict == "pass"
    assert "after 1 s" in outcome.judged.reason
    # The last start is a sample from which the only time, which ends between samples, still fits into the run.
    alone = compute_open_loop_drift(heavier, recordings, (0.503,))
    assert alone.starts > outcome.drift.starts
    assert np.isfinite(alone.distance).all()
    with pytest.raises(DynidentError, match="is 2 s long"):
        compute_open_loop_drift(heavier, recordings[1:], (2.0,))


def _record_without_torque_of(joint: int) -> Recording:
    """A recording as it is stored where the torque of a joint was not recorded."""
    motion = fourier_motion(ROBOT, 10.0, 200.0, 4)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    tau[:, joint] = 0.0
    return replace(record(ROBOT, motion, tau, "silent"), joints_without_torque=(ROBOT.joint_names[joint],))


def test_torque_that_was_not_recorded_drives_no_simulation(heavier: Identification) -> None:
    whole = _record_links(1.0, 10.0, 5)
    silent = _record_without_torque_of(1)
    alone = compute_open_loop_drift(heavier, [whole])
    both = compute_open_loop_drift(heavier, [silent, whole])
    assert both.starts == alone.starts
    assert both.share == pytest.approx(alone.share)
    outcome = validate_drift(heavier, [silent])
    assert (outcome.drift, outcome.judged.verdict) == (None, "not_evaluated")
    assert ROBOT.joint_names[1] in outcome.judged.reason
    # The joints whose torque is known are followed under control all the same.
    response = validate_simulation(heavier, silent, 0.9)
    assert (response.drift, response.judged.verdict) == (None, "not_evaluated")
    assert f"has the torque of {ROBOT.joint_names[1]}" in response.judged.reason
    evidence = HeldOutEvidence.from_identification(heavier, heavier.fit, [silent], [])
    findings = judge_simulation(evidence, compute_drift(evidence))
    (unjudged,) = (finding for finding in findings if finding.state == "not_judged")
    assert ROBOT.joint_names[1] in unjudged.sentence
    assert unjudged.next is not None
    assert "Record the torque" in unjudged.next.sentence
    assert not any("fails at the first step" in finding.sentence for finding in findings)


def test_a_model_of_joints_without_torque_is_not_simulated() -> None:
    model = identify(ROBOT, [_record_without_torque_of(2)], choices=replace(LINKS, estimator="wls"))
    judged = validate_drift(model, [_record_links(1.0, 3.0, 5)]).judged
    assert judged.verdict == "not_evaluated"
    assert ROBOT.joint_names[2] in judged.reason


@pytest.mark.parametrize("horizons", [(), (-1.0,), (0.0, 0.5), (float("nan"),), (float("inf"),)])
def test_times_that_no_simulation_has_are_refused(heavier: Identification, horizons: tuple[float, ...]) -> None:
    with pytest.raises(DynidentError, match="above 0"):
        compute_open_loop_drift(heavier, [_record_links(1.0, 3.0, 5)], horizons)


def test_the_drift_after_each_time_is_given_in_the_order_of_the_times(heavier: Identification) -> None:
    simulator = build_simulator(heavier.model, heavier.values)
    motions = read_pieces(_record_links(1.0, 3.0, 5), heavier.preprocessing)
    ascending = simulate_from_many_starts(simulator, motions, (0.1, 0.5, 8.0))
    mixed = simulate_from_many_starts(simulator, motions, (8.0, 0.1, 0.5))
    assert ascending is not None
    assert mixed is not None
    assert mixed.share == pytest.approx(ascending.share[[2, 0, 1]], nan_ok=True)
