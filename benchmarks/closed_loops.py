"""Samples a second of the joint-torque regressor of machines with closed loops, and of their trees cut open.

    PYTHONPATH=tests python benchmarks/closed_loops.py

The machines are those of the tests. Entries of W are those of the ten inertial parameters of every link: with loops,
passive positions, velocities and accelerations have to be found for each sample, and torques are seen from the driven
joints. The last table is what the code of passive positions is chosen by: how many products a sine and a quotient take.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable

import casadi as ca
import numpy as np
from common import FloatArray, median_time, show
from support.closed_loop_robots import MACHINES, five_bar, machine, states

from dynident.effects import EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.expressions import Program
from dynident.regressors.observation_matrix import Observation
from dynident.robot import Robot
from dynident.robot.modified_dh import robot_from_modified_dh

M, REPEATS, ROUNDS = 40_000, 5, 15


def main() -> None:
    rows = [("", "driven, all joints", "with loops, samples/s", "tree, samples/s", "ratio", "gap, m")]
    for name, robot in [*((name, machine(name)) for name in MACHINES), ("five_bar, wider", wide_five_bar())]:
        rows.append(measure(name, robot))
    show("Machines with closed loops and their trees", rows)
    show("Nanoseconds a sample", [("", "ns"), *((name, f"{time:.3f}") for name, time in operations().items())])


def wide_five_bar() -> Robot:
    """The five-bar in all of its workspace but what is near singular postures."""
    table = five_bar()
    table["joints"][0]["limits"] = {"position": [1.3, 2.9]}
    table["joints"][2]["limits"] = {"position": [0.25, 1.85]}
    return robot_from_modified_dh("wide", table)


def measure(name: str, robot: Robot) -> tuple[str, ...]:
    q = robot.linkage.closure.draw_postures(np.random.default_rng(0), M)
    _, dq, ddq = states(robot, M)
    closed, tree = entries_of(robot), entries_of(robot.tree)
    whole = robot.linkage.compute_positions(q)
    speed, acceleration = np.random.default_rng(1).normal(size=(2, *whole.shape))
    with_loops, of_tree = samples_a_second(lambda: closed(q, dq, ddq), lambda: tree(whole, speed, acceleration))
    gap = robot.linkage.closure.compute_gaps_and_conditions(q)[0].max()
    joints = f"{robot.n}, {robot.tree.n}"
    return name, joints, f"{with_loops:,.0f}", f"{of_tree:,.0f}", f"{with_loops / of_tree:.2f}", f"{gap:.0e}"


def samples_a_second(*runs: Callable[[], object]) -> list[float]:
    """Of runs of M samples, in turn: what others do on the machine then counts for all of them alike."""
    times = [[median_time(run, 1) for run in runs] for _ in range(ROUNDS)]
    return [M / statistics.median(own) for own in zip(*times, strict=True)]


def entries_of(robot: Robot):
    signals = Signals(robot)
    observation = Observation.from_columns(robot, build_columns([EffectChoice("rigid_body")], signals), signals)
    given = {"reference": ReferenceParameters.massless(robot), "memory": np.zeros((M, 0))}
    return lambda q, dq, ddq: observation.evaluate(q, dq, ddq, **given)


def operations() -> dict[str, float]:
    """Time of one operation in ns a sample, in code of a hundred of them."""
    x = ca.SX.sym("x", 4)
    chains = {"product or sum": ca.SX(x), "quotient": ca.SX(x)}
    for name, chain in chains.items():
        for k in range(100):
            last = chain[k % 4] * chain[(k + 1) % 4] + chain[(k + 2) % 4]
            chain[k % 4] = chain[k % 4] / chain[(k + 1) % 4] if name == "quotient" else last
    chains["sine"] = ca.vertcat(*(ca.sin(x[k % 4] + k / 30) for k in range(100)))
    count = {"product or sum": 200, "quotient": 100, "sine": 100}
    q: FloatArray = np.random.default_rng(0).uniform(0.5, 1.0, (M, 4))
    found = {}
    for name, chain in chains.items():
        program = Program([x], chain)
        found[name] = 1e9 * median_time(lambda run=program: run(q), REPEATS) / M / count[name]
    return found


if __name__ == "__main__":
    main()
