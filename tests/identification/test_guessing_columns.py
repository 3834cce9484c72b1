"""Columns of foreign files are told by names, units and content, and asked about where that is not sure."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter
from support.drawn_recordings import guess, log
from support.oracles import arm, fourier_motion, pinocchio_torque

from dynident.api.robot_files import set_drive_gains
from dynident.identification.column_inference.column_names import read_name
from dynident.identification.column_inference.column_statistics import Sample, find_clock_columns
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.column_inference.metadata_proposal import Proposal
from dynident.identification.column_inference.torque_or_current import CANNOT_TELL
from dynident.identification.column_inference.unnamed_columns import identify_unnamed_columns
from dynident.recordings.signal_spectra import find_rate_by_slopes
from dynident.robot import Robot, robot_from_urdf
from dynident.robot.description_and_json import robot_from_description
from dynident.robot.pseudo_inertia import find_description_units

ROBOT = arm("ur10")
GAINS = (15.0, 13.0, 11.0, 10.6, 11.0, 11.5)
JOINTS = range(6)


@cache
def signals() -> dict[str, np.ndarray]:
    motion = fourier_motion(ROBOT, 20.0, 100.0, 3)
    bare = pinocchio_torque(ROBOT, motion.q, np.zeros_like(motion.q), np.zeros_like(motion.q))
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    friction = 4.0 * np.sign(motion.dq) + 3.0 * motion.dq
    noise = np.random.default_rng(1).normal(0.0, 0.3, tau.shape)
    return {"t": motion.t, "q": motion.q, "dq": motion.dq, "tau": tau + friction + noise, "gravity": bare}


def sample(time: str, named: dict[str, np.ndarray], t_factor: float = 1.0, shuffle: bool = False) -> Sample:
    columns = {time: signals()["t"] * t_factor}
    for pattern, values in named.items():
        columns |= {pattern.format(j=j + 1, z=j, n=ROBOT.joint_names[j]): values[:, j] for j in JOINTS}
    names = list(columns)
    if shuffle:
        np.random.default_rng(2).shuffle(names)
    return Sample(tuple(names), np.column_stack([columns[name] for name in names]), {})


def wanted(pattern: str, signal: str) -> dict[str, str]:
    return {f"{signal}{j + 1}": pattern.format(j=j + 1, z=j, n=ROBOT.joint_names[j]) for j in JOINTS}


@pytest.mark.parametrize(
    ("position", "torque"),
    [
        ("q[{z}]", "tau[{z}]"),
        ("{n}_pos", "{n}_torque"),
        ("JointAngle{j}", "JointTorque{j} [Nm]"),
        ("A{j}_Winkel", "A{j}_Drehmoment"),
        ("joint_states/position_{n}", "joint_states/torque_{n}"),
    ],
)
def test_columns_are_told_by_their_names_in_any_order(position, torque):
    s = signals()
    found = propose(sample("stamp", {torque: s["tau"], position: s["q"]}, shuffle=True), ROBOT)
    assert found.questions == ()
    assert found.columns == {"t": "stamp"} | wanted(position, "q") | wanted(torque, "tau")
    assert found.units == {}
    assert found.effort_kind == "joint_torque"


def test_positions_that_are_called_nothing_are_told_beside_torques_by_what_they_explain():
    s = signals()
    found = propose(sample("t", {"$AXIS_ACT.A{j}": s["q"], "$TORQUE.A{j}": s["tau"]}, shuffle=True), ROBOT)
    assert found.questions == ()
    assert {**wanted("$AXIS_ACT.A{j}", "q"), **wanted("$TORQUE.A{j}", "tau")}.items() <= found.columns.items()
    other = np.random.default_rng(3).normal(size=s["q"].shape).cumsum(axis=0)
    asked = propose(sample("t", {"$AXIS_ACT.A{j}": other, "$TORQUE.A{j}": s["tau"]}), ROBOT)
    assert "columns/q" in {one.field for one in asked.questions}


@pytest.mark.parametrize(
    ("t", "q", "dq", "tau"),
    [("ms", "deg", "deg/s", "mN m"), ("us", "rad", "rpm", "kN m"), ("ns", "deg", "rad/s", "N m")],
)
def test_units_are_told_from_the_numbers(t, q, dq, tau):
    s = signals()
    scale = {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9, "rad": 1, "deg": 180 / np.pi, "rad/s": 1, "deg/s": 180 / np.pi}
    scale |= {"rpm": 30 / np.pi, "N m": 1, "mN m": 1e3, "kN m": 1e-3}
    named = {"pos{j}": s["q"] * scale[q], "vel{j}": s["dq"] * scale[dq], "trq{j}": s["tau"] * scale[tau]}
    found = propose(sample("time", named, t_factor=scale[t]), ROBOT)
    usual = {"q": "rad", "dq": "rad/s", "tau": "N m", "t": "s"}
    assert found.questions == ()
    assert {**usual, **found.units} == {"t": t, "q": q, "dq": dq, "tau": tau}


def test_columns_without_names_are_told_by_what_is_in_them():
    s = signals()
    columns = np.column_stack([s["t"], s["tau"], np.rad2deg(s["q"])])
    names = tuple(f"column{k + 1}" for k in range(columns.shape[1]))
    found = propose(Sample(names, columns, {}), ROBOT)
    assert found.columns["q1"] == "column8"
    assert found.columns["t"] == "column1"
    assert found.units["q"] == "deg"
    assert found.effort_kind == "joint_torque"
    assert found.questions == ()


def test_columns_of_joints_that_stand_still_are_told_without_names_by_the_one_that_moves():
    s = signals()
    q, dq = (np.where(np.arange(6) == 1, s[name], 0.0) for name in ("q", "dq"))
    names = tuple(f"column{k + 1}" for k in range(19))
    found = propose(Sample(names, np.column_stack([s["t"], q, dq, s["tau"]]), {}), ROBOT)
    assert found.columns["q2"] == "column3"
    assert {found.columns["tau2"], found.columns["tau6"]} == {"column15", "column19"}


def test_shuffled_columns_without_names_are_asked_about():
    s = signals()
    columns = np.column_stack([s["t"], s["tau"], s["q"]])
    order = np.random.default_rng(4).permutation(columns.shape[1])
    names = tuple(f"column{k + 1}" for k in range(columns.shape[1]))
    found = propose(Sample(names, columns[:, order], {}), ROBOT)
    assert "columns" in {one.field for one in found.questions}


def test_columns_that_are_counted_stand_in_the_order_of_their_numbers():
    s = signals()
    columns = np.column_stack([s["t"], s["tau"], s["q"]])
    order = np.random.default_rng(4).permutation(columns.shape[1])
    names = tuple(f"column{k + 1}" for k in order)
    found = propose(Sample(names, columns[:, order], {}), ROBOT)
    assert found.questions == ()
    assert found.columns == {"t": "column1"} | {f"tau{j + 1}": f"column{j + 2}" for j in JOINTS} | {
        f"q{j + 1}": f"column{j + 8}" for j in JOINTS
    }


def test_joints_that_stand_in_one_order_by_number_and_in_another_in_the_file_are_asked_about():
    s = signals()
    # By their numbers the joints run backwards, in the file forwards.
    names = ("t", *(f"column{6 - j}" for j in JOINTS), *(f"column{12 - j}" for j in JOINTS))
    found = propose(Sample(names, np.column_stack([s["t"], s["q"], s["tau"]]), {}), ROBOT)
    assert "columns" in {one.field for one in found.questions}


def test_joints_that_stand_in_each_others_place_are_asked_about():
    s = signals()
    swapped = s["tau"][:, [1, 0, 2, 3, 4, 5]]
    found = propose(sample("t", {"q{j}": s["q"], "tau{j}": swapped}), ROBOT)
    assert any("are exchanged" in one.detail for one in found.questions)


def test_measured_torque_goes_before_commanded_and_external_torque():
    s = signals()
    named = {"tau_ext{j}": 0.1 * s["tau"], "tau_cmd{j}": s["tau"], "tau{j}": s["tau"] * 1.01, "q_cmd{j}": s["q"]}
    found = propose(sample("t", {**named, "q{j}": s["q"]}), ROBOT)
    assert found.columns["tau3"] == "tau3"
    assert found.columns["q3"] == "q3"


@pytest.mark.parametrize(("word", "kind"), [("tau_ext{j}", "external"), ("tau_cmd{j}", "commanded")])
def test_torque_that_is_no_measurement_is_asked_about_by_that_word(word, kind):
    s = signals()
    found = propose(sample("t", {"q{j}": s["q"], word: s["tau"]}), ROBOT)
    assert found.effort_kind == kind
    assert any(one.field == "effort_kind" and kind in one.detail for one in found.questions)


def test_gravity_compensated_torque_is_seen_in_the_data():
    s = signals()
    found = propose(sample("t", {"q{j}": s["q"], "tau{j}": s["tau"] - s["gravity"]}), ROBOT)
    assert found.effort_kind == "gravity_compensated"
    assert any("gravity-compensated" in one.detail for one in found.questions)


def test_efforts_are_currents_where_the_drive_gains_say_so_and_asked_about_otherwise():
    s = signals()
    efforts = sample("t", {"position_{n}": s["q"], "effort_{n}": s["tau"] / GAINS})
    found = propose(efforts, set_drive_gains(ROBOT, GAINS))
    assert found.effort_kind == "motor_current"
    assert found.columns["current2"] == f"effort_{ROBOT.joint_names[1]}"
    assert found.questions == ()
    unknown = propose(efforts, ROBOT)
    assert unknown.effort_kind == "unknown"
    assert "effort_kind" in {one.field for one in unknown.questions}


def test_permille_of_a_rated_torque_asks_for_gains_alone():
    s = signals()
    named = {"q{j}": s["q"], "ActTorque_{j} [permille]": s["tau"] / 0.3}
    found = propose(sample("t", named), ROBOT)
    assert {one.field for one in found.questions} == {"drives"}
    assert found.columns["current6"] == "ActTorque_6 [permille]"


def test_a_file_without_time_says_so():
    s = signals()
    columns = np.column_stack([s["q"], s["tau"]])
    found = propose(Sample(tuple(f"c{k}" for k in range(12)), columns, {}), ROBOT)
    assert [one.field for one in found.questions] == ["columns/t"]


@pytest.mark.parametrize(("factor", "kind"), [(1e-3, "joint_torque"), (1.0, "unknown"), (0.01, "unknown")])
def test_without_masses_efforts_are_told_only_where_they_are_too_small_for_any_motor(factor, kind):
    s = signals()
    small = np.clip(s["tau"] * 8.0 / np.abs(s["tau"]).max(), -8.0, 8.0) * factor
    bare = replace(ROBOT, inertias=None)
    found = propose(sample("t", {"position_{n}": s["q"], "effort_{n}": small}), bare)
    assert found.effort_kind == kind
    asked = any(one.field == "effort_kind" for one in found.questions)
    assert asked == (kind == "unknown")


def test_efforts_that_could_be_torques_and_currents_by_the_drive_gains_are_asked_about():
    s = signals()
    found = propose(sample("t", {"position_{n}": s["q"], "effort_{n}": s["tau"]}), set_drive_gains(ROBOT, (2.5,) * 6))
    assert found.effort_kind == "unknown"
    assert "effort_kind" in {one.field for one in found.questions}


def controlled(noise: float) -> Proposal:
    """Of a robot whose torque is a controller's output, from positions of an encoder, with a sensor's noise added."""
    s = signals()
    step = 1e-4
    q = np.round(s["q"] / step) * step
    off = s["q"] - q
    torque = s["tau"] + 4000.0 * off + 20.0 * np.diff(off, axis=0, prepend=off[:1]) * 100.0
    smooth = s["gravity"] + 4.0 * np.tanh(s["dq"] / 0.1)
    command = smooth + (torque - s["tau"])
    command += noise * np.random.default_rng(2).normal(size=command.shape)
    return propose(sample("t", {"q{j}": q, "tau{j}": command}), ROBOT)


def test_a_torque_whose_noise_is_all_a_controllers_is_commanded_and_one_with_noise_of_a_sensor_is_not():
    found = controlled(0.0)
    assert found.effort_kind == "commanded"
    assert any(one.field == "effort_kind" and "commanded" in one.detail for one in found.questions)
    assert controlled(0.1).effort_kind == "joint_torque"


def test_where_positions_are_smooth_it_is_said_that_nothing_tells_a_command_from_a_measurement():
    def reason(q: np.ndarray) -> str:
        found = propose(sample("t", {"q{j}": q, "tau{j}": signals()["tau"]}), ROBOT)
        return next(one.reason for one in found.guesses if one.field == "effort_kind")

    smooth = signals()["q"]
    assert CANNOT_TELL in reason(smooth)
    assert CANNOT_TELL not in reason(np.round(smooth, 4))


def test_columns_that_are_called_as_they_are_read_are_known_whatever_the_joints_are_called():
    names = ("rev", "current 2", "q", "T-3", "deg/s", "é")
    odd = replace(ROBOT, joints=tuple(replace(one, name=new) for one, new in zip(ROBOT.joints, names, strict=True)))
    s = signals()
    columns = [f"{signal}_{name}" for signal in ("q", "tau") for name in names]
    found = propose(Sample(("t", *columns), np.column_stack([s["t"], s["q"], s["tau"]]), {}), odd)
    assert [found.columns[f"q{j + 1}"] for j in JOINTS] == columns[:6]
    assert [found.columns[f"tau{j + 1}"] for j in JOINTS] == columns[6:]
    assert found.is_sure


def test_velocities_of_joints_that_turn_and_slide_are_taken() -> None:
    """Each in the unit of its kind; in a unit that is not known they are not called anything else."""
    robot = arm("scara")
    motion = fourier_motion(robot, 20.0, 100.0, 3)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + np.sign(motion.dq) + motion.dq
    names = ["t", *(f"{signal}{k + 1}" for signal in ("q", "dq", "tau") for k in range(robot.n))]
    values = np.column_stack([motion.t, motion.q, motion.dq, tau])
    assert propose(Sample(tuple(names), values, {}), robot).columns["dq3"] == "dq3"
    values = np.column_stack([motion.t, motion.q, 7.3 * motion.dq, tau])
    proposal = propose(Sample(tuple(names), values, {}), robot)
    assert "dq3" not in proposal.columns
    reasons = [one.reason for one in proposal.guesses if one.reason.startswith("not used")]
    assert reasons == ["not used: its unit is not known"]


@pytest.mark.parametrize("locked", [0, 2, 5])
def test_columns_of_joints_that_are_locked_are_counted_with_the_others(locked: int) -> None:
    name = ROBOT.joint_names[locked]
    robot = robot_from_description(ROBOT.name, ROBOT.description, locked_joints={name: 0.0})
    motion = fourier_motion(ROBOT, 20.0, 100.0, 4)
    q, dq, ddq = (np.where(np.arange(6) == locked, 0.0, signal) for signal in (motion.q, motion.dq, motion.ddq))
    tau = pinocchio_torque(ROBOT, q, dq, ddq) + 4.0 * np.sign(dq) + 3.0 * dq
    names = ["t", *(f"{signal}{k + 1}" for signal in ("position", "effort") for k in range(6))]
    tau += np.random.default_rng(4).normal(0.0, 0.3, tau.shape)
    recorded = Sample(tuple(names), np.column_stack([motion.t, q, tau]), {})
    (still,) = (guess for guess in propose(recorded, ROBOT).guesses if guess.field == "robot")
    assert [remedy.value for remedy in still.remedies] == [{name: 0.0}]
    proposal = propose(recorded, robot)
    assert proposal.questions == ()
    kept = [k + 1 for k in range(6) if k != locked]
    assert [proposal.columns[f"q{k + 1}"] for k in range(5)] == [f"position{k}" for k in kept]
    assert [proposal.columns[f"tau{k + 1}"] for k in range(5)] == [f"effort{k}" for k in kept]


def drawn(seed: int, rate: float = 100.0) -> dict[str, np.ndarray]:
    """Positions, velocities and torques of a drawn arm, named as the columns of a file without names."""
    given = log("ur10", seed, rate=rate)
    slopes = np.gradient(given.q, given.t, axis=0)
    values = np.column_stack([given.q, slopes, given.tau])
    return {f"column{k + 1}": values[:, k] for k in range(values.shape[1])}


@pytest.mark.parametrize(("seed", "rate"), [(1, 125.0), (2, 40.0), (3, 500.0)])
def test_the_rate_of_rows_without_time_follows_from_their_velocities(seed: int, rate: float) -> None:
    (question,) = guess(ROBOT, drawn(seed, rate)).questions
    assert (question.field, [one.value for one in question.remedies]) == ("columns/t", [rate])
    # Torques are no slopes, and without velocities no rate is known.
    bare = [name for k, name in enumerate(drawn(seed)) if not 6 <= k < 12]
    (question,) = guess(ROBOT, {name: drawn(seed, rate)[name] for name in bare}).questions
    assert question.remedies == ()


@pytest.mark.parametrize(("seed", "stated"), [(1, 250.0), (2, 40.0)])
def test_a_rate_that_the_velocities_refute_is_doubted_before_torques_and_units_are(seed: int, stated: float) -> None:
    columns = drawn(seed, 100.0)
    t = np.arange(len(columns["column1"])) / stated
    values = np.column_stack([t, *columns.values()])
    given = Sample(("t", *columns), values, {}, has_stated_rate=True)
    (question,) = propose(given, ROBOT).questions
    assert (question.check, question.remedies[0].value) == ("clock_rate", 100.0)
    right = np.column_stack([np.arange(len(t)) / 100.0, *columns.values()])
    assert {one.field for one in propose(replace(given, values=right), ROBOT).questions} <= {"effort_kind"}


def swing(rate: float, fastest: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact positions, velocities and accelerations (m, 6), each of three waves up to the fastest (Hz)."""
    t = np.arange(0.0, 20.0, 1.0 / rate)[:, None, None]
    random = np.random.default_rng(seed)
    speed = 2.0 * np.pi * fastest * np.array([1 / 3, 2 / 3, 1.0])[:, None] * random.uniform(0.9, 1.0, (3, 6))
    phase = speed * t + random.uniform(0.0, 2.0 * np.pi, (3, 6))
    waves = np.sin(phase) / speed, np.cos(phase), -speed * np.sin(phase)
    q, dq, ddq = (wave.sum(axis=1) for wave in waves)
    return q + random.uniform(0.5, 1.0, 6), dq, ddq


@pytest.mark.parametrize(("rate", "fastest"), [(20.0, 1.0), (20.0, 2.0), (50.0, 2.0), (100.0, 3.0)])
def test_the_rate_that_velocities_say_does_not_depend_on_how_fast_the_motion_is(rate: float, fastest: float) -> None:
    q, dq, _ = swing(rate, fastest)
    assert find_rate_by_slopes(np.column_stack([q, dq])) == rate


def test_velocities_that_a_filter_delays_say_no_rate() -> None:
    q, dq, _ = swing(200.0, 1.0)
    assert find_rate_by_slopes(np.column_stack([q, lfilter([0.06], [1.0, -0.94], dq, axis=0)])) == 0.0


def test_a_second_clock_and_a_constant_do_not_hide_the_rate() -> None:
    q, dq, _ = swing(100.0, 1.0)
    rows = np.arange(len(q))
    values = np.column_stack([q[:, :2], dq[:, :2], np.full(len(q), 3.0), 5.0 + rows * 0.01])
    assert find_rate_by_slopes(values) == 100.0
    assert find_rate_by_slopes(np.empty((100, 0))) == 0.0


def ask_at_rate(q: np.ndarray, dq: np.ndarray, rate: float) -> list[float]:
    names = [f"{name}{j + 1}" for name in ("q", "dq", "tau") for j in JOINTS]
    tau = np.random.default_rng(3).normal(size=q.shape)
    values = np.column_stack([np.arange(len(q)) / rate, q, dq, tau])
    found = propose(Sample(("t", *names), values, {}, has_stated_rate=True), ROBOT)
    return [one.remedies[0].value for one in found.questions if one.check == "clock_rate"]


def test_a_stated_rate_is_doubted_where_it_is_wrong_by_ten_and_not_for_units() -> None:
    q, dq, _ = swing(100.0, 1.0)
    assert ask_at_rate(q, dq, 1000.0) == ask_at_rate(q, dq, 10.0) == [100.0]
    units = [(1.0, 1.0), (1.0, 30.0 / np.pi), (0.5 / np.pi, 1.0), (1.0, 0.5 / np.pi)]
    assert not any(ask_at_rate(of_q * q, of_dq * dq, 100.0) for of_q, of_dq in units)


def test_torques_of_most_joints_like_velocities_are_no_velocities() -> None:
    q, dq, ddq = (values[:, :3] for values in swing(100.0, 1.0))
    t = np.arange(len(q)) / 100.0

    def has_rates(others: np.ndarray) -> bool:
        found = identify_unnamed_columns(t, np.column_stack([q, others]), range(6), 3, lambda *_: 1.0)
        return found is not None and len(found.rates) == 3

    assert has_rates(dq)
    assert not has_rates(np.column_stack([5.0 * dq[:, :2], ddq[:, 2]]))


@pytest.mark.parametrize(("seed", "rate"), [(1, 100.0), (2, 300.0)])
def test_velocities_without_torques_are_no_torques(seed: int, rate: float) -> None:
    """Also where the rate is not that of the rows."""
    columns = dict(list(drawn(seed, 100.0).items())[:12])
    t = np.arange(len(columns["column1"])) / rate
    found = guess(ROBOT, {"t": t} | columns)
    assert [one.field for one in found.questions if one.field != "units/t"] == ["columns/tau"]
    assert "was the torque recorded?" in found.questions[0].detail
    assert found.columns["q1"] == "column1"


def test_a_joint_that_sweeps_through_a_grid_of_poses_is_no_clock() -> None:
    grid = np.tile(np.linspace(-0.6, 0.6, 5), 300) + np.random.default_rng(4).normal(0.0, 0.01, 1500)
    assert find_clock_columns(grid[:, None]) == []
    runs = np.tile(np.arange(300) * 0.004, 5)
    assert find_clock_columns(runs[:, None]) == [0]


def draw_pendulum(mass: float, length: float) -> Robot:
    """One link at the base, such as a balanced wheel: no distance between joints says how large the robot is."""
    inertia = (
        f'<inertia ixx="{mass * length**2 / 50}" ixy="0" ixz="0" iyy="{mass * length**2 / 50}" iyz="0" izz="1e-3"/>'
    )
    return robot_from_urdf(
        "pendulum",
        '<robot name="pendulum"><link name="base"/><link name="rod"><inertial>'
        f'<origin xyz="0.01 0 -{length}"/><mass value="{mass}"/>{inertia}</inertial></link>'
        '<joint name="pivot" type="revolute"><origin xyz="-0.0004 0 0"/><axis xyz="0 1 0"/><parent link="base"/>'
        '<child link="rod"/><limit lower="0" upper="0" effort="0" velocity="0"/></joint></robot>',
    )


@pytest.mark.parametrize(("mass", "length"), [(0.6, 0.45), (2.5, 0.9), (5.0, 0.03), (150.0, 0.3)])
def test_the_masses_of_a_pendulum_are_not_said_to_be_in_grams(mass: float, length: float) -> None:
    assert find_description_units(draw_pendulum(mass, length)) is None


@pytest.mark.parametrize("seed", [1, 2])
def test_a_torque_that_is_called_measured_goes_before_the_feedback_of_a_controller(seed: int) -> None:
    given = log("ur10", seed)
    share = np.random.default_rng(seed).uniform(0.2, 0.6, 6)
    columns = {"time": given.t}
    for name, values in {"q": given.q, "tau_feedback": share * given.tau, "tau_measured": given.tau}.items():
        columns |= {f"{name}{j + 1}": values[:, j] for j in JOINTS}
    found = guess(ROBOT, columns)
    assert (found.questions, found.columns["tau2"]) == ((), "tau_measured2")


def test_angles_of_the_joints_are_taken_where_those_of_their_motors_stand_before_them() -> None:
    given = log("ur10", 3)
    theta = given.q + given.tau / np.array([2e5, 2e5, 1e5, 5e4, 5e4, 5e4])
    columns, signals = {"t": given.t}, {"theta": theta, "q": given.q}
    signals |= {f"d{name}": np.gradient(values, given.t, axis=0) for name, values in signals.items()}
    for name, values in (signals | {"tau_J": given.tau}).items():
        columns |= {f"{name}_{j + 1}": values[:, j] for j in JOINTS}
    found = guess(ROBOT, columns)
    assert (found.columns["q2"], found.columns["dq2"], found.questions) == ("q_2", "dq_2", ())
    (unused,) = (one for one in found.guesses if "not used" in one.reason)
    assert unused.value.startswith("theta_1, ")
    assert "a second set" in unused.reason


def test_a_raw_measurement_beside_a_torque_is_asked_about() -> None:
    given = log("ur10", 3)
    columns = {"time": given.t}
    for name, values in {"q": given.q, "tau_actual": given.tau, "tau_measured_raw": np.round(32.0 * given.tau)}.items():
        columns |= {f"{name}{j + 1}": values[:, j] for j in JOINTS}
    assert any("Several sets" in one.detail for one in guess(ROBOT, columns).questions)


def test_a_joint_may_be_called_ee() -> None:
    given = log("ur10", 4)
    names = ("base", "shoulder", "elbow", "wrist1", "wrist2", "ee")
    columns = {"time": given.t}
    for signal, values in {"position": given.q, "torque": given.tau}.items():
        columns |= {f"{name}_{signal}": values[:, j] for j, name in enumerate(names)}
    found = guess(ROBOT, columns)
    assert (found.columns["q6"], found.columns["tau6"]) == ("ee_position", "ee_torque")


@pytest.mark.parametrize("prefix", ["ee_pos", "eef_position"])
def test_the_place_of_the_end_effector_is_no_position_of_three_joints(prefix: str) -> None:
    robot = arm("ur10")
    motion = fourier_motion(robot, 12.0, 100.0, 5)
    n = robot.n
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    columns = {"time": motion.t}
    place = np.cumsum(np.random.default_rng(2).normal(0.0, 1e-3, (len(motion.t), n)), axis=0)
    for name, values in {"q": motion.q, "tau": tau, prefix: place}.items():
        columns |= {f"{name}{j + 1}": values[:, j] for j in range(n)}
    assert [one.field for one in guess(robot, columns).questions if one.field == "columns/q"] == []


@pytest.mark.parametrize("kept", [1, 3])
def test_columns_of_locked_joints_are_no_other_signals_of_the_only_joint_that_is_left(kept: int) -> None:
    t = np.arange(0.0, 20.0, 0.01)
    q, slopes, pushes = np.zeros((len(t), 6)), np.zeros((len(t), 6)), np.zeros((len(t), 6))
    phase = 2.0 * np.pi * (0.2 * t + 0.02 * t**2)
    q[:, kept], slopes[:, kept] = 0.6 * np.sin(phase), np.gradient(0.6 * np.sin(phase), t)
    pushes[:, kept] = np.gradient(slopes[:, kept], t)
    tau = pinocchio_torque(ROBOT, q, slopes, pushes) + 3.0 * np.sign(slopes)
    locked = {name: 0.0 for j, name in enumerate(ROBOT.joint_names) if j != kept}
    robot = robot_from_description(ROBOT.name, ROBOT.description, locked_joints=locked)
    noise = np.random.default_rng(kept).normal(0.0, 0.05, tau.shape)
    columns = {"time": t}
    for name, values in {"q": q, "tau": tau + noise}.items():
        columns |= {f"{name}{j + 1}": values[:, j] for j in JOINTS}
    found = guess(robot, columns)
    assert (found.columns["q1"], found.columns["tau1"]) == (f"q{kept + 1}", f"tau{kept + 1}")
    assert [one.detail for one in found.questions if "Several sets" in one.detail] == []


@pytest.mark.parametrize(("largest", "turns"), [(16.0, 1.0), (9.0, 2.6)])
def test_a_pendulum_is_as_long_as_its_link_and_may_turn_over(largest: float, turns: float) -> None:
    robot = draw_pendulum(0.7, 0.45)
    t = np.arange(0.0, 20.0, 0.005)
    q = np.pi * turns * np.sin(2.0 * np.pi * (0.1 * t + 0.01 * t**2))
    tau = np.random.default_rng(3).normal(0.0, 1.0, len(t))
    tau *= largest / np.abs(tau).max()
    found = guess(robot, {"time": t, "position": q, "torque": tau})
    assert found.units.get("tau") is None
    assert found.units.get("q") is None


def test_times_that_begin_anew_are_no_speed() -> None:
    robot = draw_pendulum(0.7, 0.45)
    t = np.tile(np.arange(0.0, 3.0, 0.01), 8)
    q = np.pi * 2.6 * np.sin(2.0 * np.pi * 0.3 * t + np.repeat(np.arange(8.0), 300))
    tau = 4.0 * np.sin(q) + np.random.default_rng(3).normal(0.0, 0.05, len(t))
    found = guess(robot, {"time": t, "position": q, "torque": tau})
    assert found.units.get("q") is None
    assert "units/q" not in [question.field for question in found.questions]


def test_noisy_accelerations_are_told_from_torques_at_any_rate() -> None:
    for rate in (25.0, 100.0):
        q, dq, ddq = swing(rate, 1.0)
        random = np.random.default_rng(4)
        rise = ddq + random.normal(size=q.shape) * 0.9 * ddq.std(axis=0)
        tau = 5.0 * np.sin(q) + np.sign(dq)
        found = identify_unnamed_columns(
            np.arange(len(q)) / rate, np.column_stack([q, dq, rise, tau]), range(24), 6, lambda *_: 1.0
        )
        assert found is not None
        assert (found.positions, found.efforts) == (tuple(range(6)), tuple(range(18, 24)))


@pytest.mark.parametrize(
    ("name", "signal", "commanded"),
    [
        ("qDot1", "dq", False),
        ("dataDotQ_2", "dq", False),
        ("theta_dot_1", "dq", False),
        ("qDDot3", "ddq", False),
        ("dDotQ1", "ddq", False),
        ("q_1", "q", False),
        ("q_dot_dot_1", "ddq", False),
        ("q_d_dot_1", "dq", True),
        ("qd_dot_1", "dq", False),
        ("velocity_dot_1", "ddq", False),
    ],
)
def test_dots_and_letters_d_say_how_often_a_position_is_derived(name: str, signal: str, commanded: bool) -> None:
    column = read_name(name)
    assert (column.signal, column.commanded) == (signal, commanded)


@pytest.mark.parametrize("torque", ["t_{j}", "t_{j:02d}"])
def test_counted_letters_t_beside_a_time_may_be_torques(torque: str) -> None:
    s = signals()
    found = propose(sample("time", {"q_{j:02d}": s["q"], torque: s["tau"]}), ROBOT)
    assert {"t": "time", **wanted(torque, "tau")}.items() <= found.columns.items()


def test_other_positions_without_efforts_do_not_hide_counted_joints() -> None:
    s = signals()
    still = np.zeros((len(s["t"]), 1))
    others = np.random.default_rng(2).normal(size=s["q"].shape).cumsum(axis=0)
    counted = [f"{signal}_{j}" for signal in ("q", "tau") for j in range(7)]
    names = ("time", *counted, *(f"{word}_position" for word in ("head", "lift", "pelvis", "neck", "rack", "door")))
    values = np.column_stack([s["t"], s["q"], still, s["tau"], still, others])
    found = propose(Sample(names, values, {}), ROBOT)
    assert {**wanted("q_{z}", "q"), **wanted("tau_{z}", "tau")}.items() <= found.columns.items()


def test_counted_joints_of_a_hand_are_not_those_of_the_arm_beside_it() -> None:
    q, _, ddq = swing(100.0, 1.0)
    joints = ("SP", "SR", "WP", "WR", "ELBOW", "BASE")
    arm_names = [f"{signal}_{joint}" for signal in ("q", "tau") for joint in joints]
    hand_names = [f"{signal}_hand{j + 1}" for signal in ("q", "tau") for j in range(8)]
    still = np.zeros((len(q), 2))
    values = np.column_stack([np.arange(len(q)) / 100.0, q, ddq, 0.5 * q, still, 0.5 * ddq, still])
    found = propose(Sample(("t", *arm_names, *hand_names), values, {}), ROBOT)
    assert not any("hand" in column for column in found.columns.values())
    assert {"columns/q", "columns/tau"} <= {question.field for question in found.questions}


def test_the_only_position_and_torque_of_a_robot_with_several_joints_say_so() -> None:
    q, _, ddq = swing(100.0, 1.0)
    values = np.column_stack([np.arange(len(q)) / 100.0, q[:, 0], q[:, 0], ddq[:, 0]])
    found = propose(Sample(("time", "q_des", "q_act", "torque"), values, {}), ROBOT)
    details = {question.field: question.detail for question in found.questions}
    assert "q_act is of one joint, but the robot has 6" in details["columns/q"]
    assert "torque is of one joint, but the robot has 6" in details["columns/tau"]


def make_nameless(t: np.ndarray, *blocks: np.ndarray) -> Sample:
    values = np.column_stack([t, *blocks])
    return Sample(tuple(f"column{k + 1}" for k in range(values.shape[1])), values, {})


@pytest.mark.parametrize("seed", [1, 2])
def test_of_several_blocks_without_names_that_may_be_torques_one_is_asked_for(seed: int) -> None:
    given = log("ur10", seed)
    dq = np.gradient(given.q, given.t, axis=0)
    smooth = lfilter([0.1], [1.0, -0.9], given.tau, axis=0)
    pose = np.cumsum(np.random.default_rng(seed).normal(0.0, 1e-3, given.q.shape), axis=0)
    found = propose(make_nameless(given.t, given.q, dq, 0.1 * given.tau, pose, smooth), ROBOT)
    assert [found.columns[name] for name in ("q1", "dq1")] == ["column2", "column8"]
    (question,) = [one for one in found.questions if one.field == "columns/tau"]
    assert question.choices == ("column14 … column19", "column26 … column31")


@pytest.mark.parametrize("further", ["temperatures", "command and error", "accelerations"])
def test_torques_without_names_that_resemble_accelerations_are_the_torques(further: str) -> None:
    robot, given = arm("scara"), fourier_motion(arm("scara"), 20.0, 100.0, 1)
    tau = pinocchio_torque(robot, given.q, given.dq, given.ddq) + np.array([8.0, 4.0, 90.0, 0.5]) * given.ddq
    warm = 30.0 + np.random.default_rng(1).normal(0.0, 0.05, given.q.shape) + 0.1 * given.t[:, None]
    late = np.roll(given.q, -3, axis=0)
    others = {
        "temperatures": (tau, warm, 2.0 * warm + np.roll(warm, 7, axis=0)),
        "command and error": (tau, late, late - given.q),
        "accelerations": (given.ddq, tau, warm),
    }
    found = propose(make_nameless(given.t, given.q, given.dq, *others[further]), robot)
    offered = [question.choices for question in found.questions if question.field == "columns/tau"]
    torque = "column14" if further == "accelerations" else "column10"
    assert found.columns["tau1"] == torque
    assert all(torque in choices[0] for choices in offered)


def test_more_blocks_without_names_than_drives_write_are_not_tried() -> None:
    random = np.random.default_rng(1).normal(size=(2000, 60)).cumsum(axis=0)
    t, tried = np.arange(2000) / 200.0, []

    def measure(*columns: tuple[int, ...]) -> float:
        tried.append(columns)
        return 1.0

    q = np.sin(3.0 * t[:, None] + np.arange(3.0))
    values = np.column_stack([q, np.gradient(q, t, axis=0), random])
    assert identify_unnamed_columns(t, values, range(66), 3, measure) is None
    found = identify_unnamed_columns(t, values, range(48), 3, measure)
    assert found is not None
    assert found.positions == (0, 1, 2)
    assert len(tried) == 14


def test_positions_without_names_beside_those_that_were_commanded_are_asked_about() -> None:
    given = log("ur10", 3)
    late = lfilter([0.2], [1.0, -0.8], given.q - given.q[0], axis=0) + given.q[0]
    rates = (np.gradient(values, given.t, axis=0) for values in (given.q, late))
    commanded, measured = rates
    found = propose(make_nameless(given.t, given.q, commanded, late, measured, given.tau), ROBOT)
    choices = {question.field: question.choices for question in found.questions}
    assert choices["columns/q"] == ("column2 … column7", "column14 … column19")
    assert found.columns["tau1"] == "column26"


@pytest.mark.parametrize("own", [1, 2])
def test_of_several_drives_the_one_that_moves_is_read_and_another_one_with_its_own_current(own: int) -> None:
    robot = draw_pendulum(2.0, 0.3)
    q, dq, ddq = (values[:, 0] for values in swing(100.0, 1.0, own))
    current = 0.2 * ddq + 1.5 * np.sin(q) + 0.1 * np.sign(dq)
    stands = np.random.default_rng(own).normal(0.0, 1e-7, (len(q), 2))
    columns = {"time": np.arange(len(q)) / 100.0}
    for drive in range(3):
        columns[f"ODrive {drive} Position"] = q if drive == own else 5.0 + stands[:, 0]
    for drive in range(3):
        columns[f"ODrive {drive} Current"] = current if drive == own else 0.3 + stands[:, 1]
    names, values = tuple(columns), np.column_stack(list(columns.values()))
    found = propose(Sample(names, values, {}), robot)
    assert (found.columns["q1"], found.columns["current1"]) == (f"ODrive {own} Position", f"ODrive {own} Current")
    stated = propose(Sample(names, values, {}, stated={"ODrive 0 Position": "q_pivot"}), robot)
    assert stated.columns["q1"] == "ODrive 0 Position"
    assert stated.columns.get("current1", "ODrive 0 Current") == "ODrive 0 Current"


def test_efforts_that_never_change_are_said_to() -> None:
    given = log("ur10", 4)
    columns = {"time": given.t} | {f"q{j + 1}": given.q[:, j] for j in JOINTS}
    columns |= {f"effort{j + 1}": np.full(len(given.t), 2.5 + j) for j in JOINTS}
    (question,) = guess(ROBOT, columns).questions
    assert question.detail.startswith(
        "effort1 … effort6 have one value each in all rows. If they are in another file, "
    )
    columns |= {f"effort{j + 1}": np.full(len(given.t), np.nan) for j in JOINTS}
    (question,) = guess(ROBOT, columns).questions
    assert question.detail.startswith("effort1 … effort6 have no number in any row. If they are in another file, ")


@pytest.mark.parametrize(("size", "is_asked"), [(np.nan, False), (0.0, False), (1e-4, True), (1e4, True)])
def test_drives_are_chosen_by_whether_they_move_and_not_by_how_far_in_units_that_may_differ(
    size: float, is_asked: bool
) -> None:
    q, _, ddq = (values[:, 0] for values in swing(100.0, 1.0, 1))
    t = np.arange(len(q)) / 100.0
    columns = {"time": t, "Drive 0 Position": size * np.sin(t), "Drive 1 Position": q}
    columns |= {"Drive 0 Current": size * np.cos(t), "Drive 1 Current": 0.2 * ddq + 1.5 * np.sin(q)}
    found = propose(Sample(tuple(columns), np.column_stack(list(columns.values())), {}), draw_pendulum(2.0, 0.3))
    assert ("columns/q" in {question.field for question in found.questions}) is is_asked
    assert is_asked or found.columns["current1"] == "Drive 1 Current"


def test_counted_columns_that_may_be_of_anything_say_nothing_of_joints_that_are_missing() -> None:
    given = log("franka_panda", 1)
    for names in ([f"joint_{j}" for j in range(6)], [f"temperature_{j}" for j in range(8)]):
        columns = {"time": given.t} | {name: given.q[:, j % 6] + 0.1 * j for j, name in enumerate(names)}
        details = {question.field: question.detail for question in guess(arm("franka_panda"), columns).questions}
        assert "but the robot has" not in details["columns/q"]


@pytest.mark.parametrize("name", ["a1 q-axis [A]", "q1 (mA)"])
def test_what_is_in_amperes_is_no_position(name: str) -> None:
    assert read_name(name).signal == "current"


def test_the_current_of_the_whole_robot_is_not_that_of_one_joint() -> None:
    given = log("ur10", 5)
    columns = {"timestamp": given.t} | {f"actual_q_{j}": given.q[:, j] for j in JOINTS}
    columns["actual_robot_current"] = 1.0 + np.abs(given.tau).sum(axis=1) / 100.0
    (question,) = guess(ROBOT, columns).questions
    assert "is of one joint" not in question.detail
