"""A virtual arm makes designed motions: do its parameters come out as well as every design promised?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.excitation import CriterionChoice, Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.identification import IdentificationChoices, identify_model
from dynident.progress import ignore_progress
from dynident.recordings import Recording, choose_preprocessing, recording_from_arrays
from dynident.regressors.model_structure import Model, build_model
from dynident.robot import Robot
from dynident.simulation import Reference, Sensors, SimulationRequest, simulate, spread_over_joints

pytestmark = pytest.mark.slow

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
RATE, SEEDS = 200.0, 5
COUNTS = 2**19


@dataclass(frozen=True, eq=False)
class Outcome:
    """Of one design: the standard deviations (b,) that it promised, and the errors (b,), root mean square."""

    design: Design
    promised: np.ndarray
    achieved: np.ndarray


class Arm:
    """The virtual arm: friction, torque noise of 1 % of the limits, encoders."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        effort = np.array([joint.limits.effort for joint in robot.joints])
        velocity = np.array([joint.limits.velocity for joint in robot.joints])
        self.noise = 0.01 * effort
        self.coulomb, self.viscous = 0.02 * effort, 0.02 * effort / velocity
        self.model: Model = build_model(robot, EFFECTS)
        assert robot.inertias is not None
        standard = np.concatenate([robot.inertias.ravel(), self.coulomb, self.viscous])
        self.truth = self.model.base.grouping @ standard

    def design(self, kind: str, random_trajectories: int, **trajectory: object) -> Design:
        wanted = TrajectoryRequest(**{"duration": 10.0, "sampling_rate": RATE, **trajectory})
        noise = dict(zip(self.robot.joint_names, self.noise.tolist(), strict=True))
        request = DesignRequest(
            kind=kind,
            effects=EFFECTS,
            criterion=CriterionChoice("a_optimal"),
            trajectory=wanted,
            starts=1,
            random_trajectories=random_trajectories,
            noise=noise,
        )
        return design_experiment(self.robot, request)

    def recorded(self, design: Design, seed: int) -> list[Recording]:
        """Every run by itself; of a motion of all joints the exciting part."""
        friction = (
            *spread_over_joints(self.robot, "coulomb", "Fc", self.coulomb),
            *spread_over_joints(self.robot, "viscous", "Fv", self.viscous),
        )
        sensors = Sensors(sampling_rate=RATE, torque_noise_absolute=tuple(self.noise), encoder_counts=COUNTS)
        motion = Reference(design.t, design.q, design.dq, design.ddq)
        measured = simulate(self.robot, SimulationRequest(motion, friction, sensors=sensors, seed=seed))
        made = []
        for number, (start, end) in enumerate([(run.start, run.end) for run in design.runs] or [design.exciting]):
            part = (measured.t >= start) & (measured.t <= end)
            made.append(
                recording_from_arrays(
                    measured.t[part],
                    measured.q[part],
                    measured.tau[part],
                    joint_names=self.robot.joint_names,
                    name=f"run {number + 1}",
                )
            )
        return made

    def errors(self, design: Design, seed: int) -> np.ndarray:
        recordings = self.recorded(design, seed)
        filters = choose_preprocessing(recordings)
        choices = IdentificationChoices(effects=EFFECTS, preprocessing=filters)
        reference = ReferenceParameters.massless(self.robot)
        found = identify_model(self.model, recordings, [], choices, filters, reference, ignore_progress)
        return found.values - self.truth


@pytest.fixture(scope="module")
def outcomes(scara: Robot) -> dict[str, Outcome]:
    arm = Arm(scara)
    designs = {
        "random": arm.design("random", 1),
        "optimized": arm.design("optimized", 30),
        "link by link": arm.design("sequential", 30, sets="link_by_link", duration=2.5),
        "vandanjon": arm.design("sequential", 30, sets="vandanjon", duration=1.0, points=6),
    }
    made = {}
    for name, design in designs.items():
        assert design.parameter_names == arm.model.base.kept_names
        promised = np.array([one.standard_deviation for one in design.expected])
        errors = np.array([arm.errors(design, seed) for seed in range(SEEDS)])
        made[name] = Outcome(design, promised, np.sqrt(np.mean(errors**2, axis=0)))
    return made


def typical(deviations: np.ndarray, scale: np.ndarray) -> float:
    """Geometric mean over the parameters, each relative to its scale."""
    return float(np.exp(np.mean(np.log(deviations / scale))))


def test_errors_fall_in_the_order_that_the_predicted_standard_deviations_promised(outcomes):
    scale = np.exp(np.mean([np.log(one.promised) for one in outcomes.values()], axis=0))
    promised = {name: typical(one.promised, scale) for name, one in outcomes.items()}
    achieved = {name: typical(one.achieved, scale) for name, one in outcomes.items()}
    assert sorted(promised, key=promised.__getitem__) == sorted(achieved, key=achieved.__getitem__)
    assert promised["optimized"] < promised["random"]


@pytest.mark.parametrize("name", ["random", "optimized", "link by link", "vandanjon"])
def test_errors_are_as_large_as_promised(outcomes, name):
    """Torque noise alone is promised; encoder noise, which no design knows of, adds to it."""
    share = outcomes[name].achieved / outcomes[name].promised
    assert 0.6 < np.exp(np.mean(np.log(share))) < 1.7
    assert share.max() < 6
