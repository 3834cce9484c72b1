"""Parameters in units of current, where no drive gain is known."""

from __future__ import annotations

import numpy as np
import pytest
from support.drawn_recordings import log
from support.noise_free_data import drawn_standard, torque_of
from support.oracles import arm, crooked_urdf, fourier_motion, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.loads.current_models import identify_currents
from dynident.identification.loads.payloads_of_recordings import PLAIN_EFFECTS
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import build_model
from dynident.robot import robot_from_urdf

UR10 = arm("ur10")
CROOKED = robot_from_urdf("crooked", crooked_urdf(4, 3, (2,)))
WIDE = Preprocessing(None, None, 4)
RATE = 400.0


def current_of(robot, gains, seed: int = 3, duration: float = 25.0):
    standard = drawn_standard(robot)
    motion = fourier_motion(robot, duration, RATE, seed, base_frequency=0.08, amplitude=2.5)
    return record(robot, motion, torque_of(robot, motion, standard) / gains, f"run{seed}")


@pytest.mark.parametrize("robot", [UR10, CROOKED], ids=["ur10", "crooked"])
def test_every_joint_tells_its_parameters_over_its_own_gain(robot):
    gains = np.linspace(8.0, 15.0, robot.n)
    found = identify_currents(robot, [current_of(robot, gains)], [current_of(robot, gains, 4)], preprocessing=WIDE)
    base = build_model(robot, PLAIN_EFFECTS).base.grouping @ drawn_standard(robot)
    for joint, one in enumerate(found):
        truth = one.base.grouping @ base / gains[joint]
        assert np.abs(one.solution.values - truth).max() < 1e-4 * np.abs(truth).max()
        # The current of another motion is predicted without any gain.
        assert one.held_out.relative[joint] < 1e-4
        assert [p.value for p in one.parameters] == one.solution.values.tolist()
        effort = "A/(N)" if robot.joints[joint].kind == "prismatic" else "A/(N m)"
        assert all(p.unit.endswith(effort) for p in one.parameters)


def test_two_joints_that_feel_the_same_parameter_tell_the_ratio_of_their_gains():
    gains = np.array([14.0, 13.0, 11.0, 10.0, 9.0, 12.0])
    found = identify_currents(UR10, [current_of(UR10, gains)], preprocessing=WIDE)
    shared = [
        (one.solution.values[a], other.solution.values[b], gains[j] / gains[i])
        for i, one in enumerate(found)
        for j, other in enumerate(found[:i])
        for a in range(len(one.parameters))
        for b in range(len(other.parameters))
        if np.abs(one.base.grouping[a] - other.base.grouping[b]).max() < 1e-9
    ]
    assert len(shared) >= 3
    for value, other, ratio in shared:
        assert value == pytest.approx(other * ratio, rel=1e-3, abs=1e-4)


def test_effects_that_need_the_torque_are_refused():
    effects = (*PLAIN_EFFECTS, EffectChoice("load_dependent_friction"))
    with pytest.raises(DynidentError, match="without the gains") as caught:
        identify_currents(UR10, [current_of(UR10, np.ones(6), duration=10.0)], effects=effects)
    assert caught.value.pointer == "/effects/5"


def test_a_joint_without_current_is_named():
    dead = np.array([1.0, 1.0, np.inf, 1.0, 1.0, 1.0])
    with pytest.raises(DynidentError, match="elbow_joint"):
        identify_currents(UR10, [current_of(UR10, dead, duration=10.0)], preprocessing=WIDE)


@pytest.mark.parametrize("name", ["present_pwm_{}", "duty_{} [%]"])
def test_the_duty_of_a_motor_is_no_torque(name: str) -> None:
    drawn = log()
    names = [name.format(joint + 1) for joint in range(6)]
    values = np.column_stack([drawn.t, drawn.q, drawn.tau])
    found = propose(Sample(("t", *(f"q{joint + 1}" for joint in range(6)), *names), values, {}), drawn.robot)
    (question,) = [each for each in found.questions if each.field == "effort_kind"]
    assert question.choices == ("motor_current",)
    assert "back-EMF" in question.detail
