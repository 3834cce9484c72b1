"""Samples a second of the joint-torque regressor: LLVM's machine code, CasADi's virtual machine, a Pinocchio loop.

    python benchmarks/regressor_throughput.py

All give the same numbers: the ten inertial parameters of every link, for a 6-joint and a 7-joint arm. Ours evaluates
the structural non-zeros alone, compiled by LLVM, four samples at once. All samples in one array (134 MB for 7 joints)
are written to memory that the system has to find first; what a reduction does, a part at a time, stays in the cache.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio
from common import FloatArray, median_time, show
from compared import compared

from dynident.effects import EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.regressors.observation_matrix import Observation
from dynident.robot import robot_from_library, to_pinocchio
from dynident.robot.pinocchio_conversion import to_dynamic_parameters

N_BLOCK, N_LOOP, REPEATS = 65536, 2000, 7
N_PART = 2048
"""Samples whose entries stay in the processor's cache, as in the reductions."""


def main() -> None:
    for name in ("ur10", "franka_panda"):
        measure(name)


def measure(name: str) -> None:
    robot = robot_from_library(name)
    signals = Signals(robot)
    observation = Observation.from_columns(robot, build_columns([EffectChoice("rigid_body")], signals), signals)
    function = whole_matrix(observation, signals)
    model = to_pinocchio(robot)
    data = model.createData()
    q, dq, ddq = np.random.default_rng(0).uniform(-2, 2, (3, N_BLOCK, robot.n))
    few = (q[:N_LOOP], dq[:N_LOOP], ddq[:N_LOOP])
    reference, memory = ReferenceParameters.massless(robot), np.zeros((N_BLOCK, 0))

    def compiled() -> FloatArray:
        return observation.evaluate(q, dq, ddq, reference=reference, memory=memory)

    def compiled_in_parts() -> None:
        for k in range(0, N_BLOCK, N_PART):
            part = slice(k, k + N_PART)
            observation.evaluate(q[part], dq[part], ddq[part], reference=reference, memory=memory[part])

    def virtual_machine() -> list[ca.DM]:
        return [function(*rows) for rows in zip(*few, strict=True)]

    def many_at_once() -> ca.DM:
        return function(*(rows.T for rows in few))

    def pinocchio_loop() -> FloatArray:
        found = np.empty((N_LOOP, robot.n, 10 * robot.n))
        for k, rows in enumerate(zip(*few, strict=True)):
            found[k] = pinocchio.computeJointTorqueRegressor(model, data, *rows)
        return found

    difference = agreement(observation, compiled()[:N_LOOP], pinocchio_loop())
    ours = N_BLOCK / median_time(compiled, REPEATS)
    in_parts = N_BLOCK / median_time(compiled_in_parts, REPEATS)
    rows = [("", "samples/s", "ours is faster by"), ("machine code by LLVM", f"{ours:,.0f}", "")]
    rows.append((f"the same, {N_PART:,} samples at a time", f"{in_parts:,.0f}", ""))
    for label, loop in (
        ("Pinocchio, Python loop", pinocchio_loop),
        ("CasADi, one call for many samples", many_at_once),
        ("CasADi, one call a sample", virtual_machine),
    ):
        rate = N_LOOP / median_time(loop, REPEATS)
        rows.append((label, f"{rate:,.0f}", f"{ours / rate:.1f}"))
        compared(f"regressor, {robot.n} joints", ours, label, rate, "samples a second")
    instructions = observation.program.n_instructions
    show(f"{name}: {robot.n} joints, {instructions} instructions; difference to Pinocchio {difference:.1e}", rows)


def whole_matrix(observation: Observation, signals: Signals) -> ca.Function:
    """W as a CasADi function."""
    matrix = ca.densify(ca.horzcat(*(column.torque for column in observation.columns)))
    return ca.Function("w", [signals.q, signals.dq, signals.ddq], [matrix], {"cse": True})


def agreement(observation: Observation, entries: FloatArray, expected: FloatArray) -> float:
    """Largest difference to Pinocchio's torque for random parameters, relative to the largest torque."""
    values = np.random.default_rng(1).uniform(-1, 1, observation.n_columns)
    ours = observation.compute_torque(entries, values)
    theirs = expected @ to_dynamic_parameters(values.reshape(-1, 10)).reshape(-1)
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


if __name__ == "__main__":
    main()
