"""Columns of foreign files are told by names, units and content, and asked about where that is not sure."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from oracles import arm, fourier_motion, pinocchio_torque

from dynident.desk.robots import with_gains
from dynident.identification.imports.facts import Sample
from dynident.identification.imports.guess import propose

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


def test_shuffled_columns_without_names_are_asked_about():
    s = signals()
    columns = np.column_stack([s["t"], s["tau"], s["q"]])
    order = np.random.default_rng(4).permutation(columns.shape[1])
    names = tuple(f"column{k + 1}" for k in range(columns.shape[1]))
    found = propose(Sample(names, columns[:, order], {}), ROBOT)
    assert "columns" in {one.field for one in found.questions}


def test_joints_that_stand_in_each_others_place_are_asked_about():
    s = signals()
    swapped = s["tau"][:, [1, 0, 2, 3, 4, 5]]
    found = propose(sample("t", {"q{j}": s["q"], "tau{j}": swapped}), ROBOT)
    assert any("torques swapped" in one.detail for one in found.questions)


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
    found = propose(efforts, with_gains(ROBOT, GAINS))
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
