"""Physically feasible parameters of a 7-joint arm from reduced data, against the same problem stated in cvxpy.

    python benchmarks/feasible_estimator.py

Both start from the weighted triangular factor of the data and end with parameters; ours re-weights the joints three
times and gives standard deviations beside. The rival states one weighting in cvxpy, as papers do, with the same solver.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np
from common import median_time, show, simulated_samples
from compared import compared

from dynident.effects import EffectChoice
from dynident.estimation import build_weighted_factor
from dynident.identification import Identification, IdentificationChoices, identify, reidentify
from dynident.recordings import Preprocessing, recording_from_arrays
from dynident.robot import robot_from_library, to_pinocchio
from dynident.robot.pseudo_inertia import PSEUDO_INERTIA_PARTS, smallest_pseudo_inertia

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
N_SAMPLES, RATE, REPEATS = 5_000, 250.0, 5


def main() -> None:
    robot = robot_from_library("franka_panda")
    samples = simulated_samples(to_pinocchio(robot), N_SAMPLES, RATE)
    recording = recording_from_arrays(samples.t, samples.q, samples.tau, joint_names=robot.joint_names)
    choices = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(10.0, 10.0, 5))
    plain = identify(robot, [recording], [], choices)

    def ours() -> Identification:
        return reidentify(plain, IdentificationChoices(EFFECTS, estimator="feasible"))

    found = ours()
    assert found.estimate.standard is not None
    assert smallest_pseudo_inertia(found.estimate.standard.to_inertias(found.model)).min() > 0
    ours_time = median_time(ours, REPEATS)
    theirs_time = median_time(lambda: in_cvxpy(found), REPEATS)
    ours_cost, theirs_cost = cost(found, found.values), cost(found, in_cvxpy(found))
    what = "feasible parameters of 7 joints from reduced data, three weightings with statistics"
    compared(what, ours_time, "cvxpy, one weighting", theirs_time)
    print(f"{robot.name}: {robot.n} joints, {found.model.n_parameters} parameters; median of {REPEATS} runs")
    show(
        "Reduced data to physically feasible parameters",
        [
            ("", "time", "weighted sum of squares"),
            ("cvxpy, one weighting", f"{1e3 * theirs_time:.0f} ms", f"{theirs_cost:.6g}"),
            ("dynident, three weightings, with statistics", f"{1e3 * ours_time:.0f} ms", f"{ours_cost:.6g}"),
            ("ratio", f"{ours_time / theirs_time:.2f}", f"{ours_cost / theirs_cost:.6f}"),
        ],
    )


def cost(found: Identification, values: np.ndarray) -> float:
    factor = build_weighted_factor(found.data.equations, found.estimate.solution.noise)
    return float(np.sum((factor[:, :-1] @ values - factor[:, -1]) ** 2))


def in_cvxpy(found: Identification) -> np.ndarray:
    """Base parameters of the feasible standard parameters that fit best."""
    model = found.model
    factor = build_weighted_factor(found.data.equations, found.estimate.solution.noise)
    standard = cp.Variable(len(model.columns))
    not_negative = ("rotor_inertia", "coulomb", "viscous")
    constraints = [standard[k] >= 0 for k, column in enumerate(model.columns) if column.effect in not_negative]
    for name in model.robot.joint_names:
        link = [k for k, column in enumerate(model.columns) if column.effect == "rigid_body" and column.link == name]
        constraints.append(sum(standard[k] * part for k, part in zip(link, PSEUDO_INERTIA_PARTS, strict=True)) >> 0)
    size = float(np.abs(factor).max())
    residual = (factor[:, :-1] / size) @ model.base.grouping @ standard - factor[:, -1] / size
    cp.Problem(cp.Minimize(cp.sum_squares(residual)), constraints).solve(solver="CLARABEL")
    return np.asarray(model.base.grouping @ standard.value)


if __name__ == "__main__":
    main()
