"""A fast motion leaves two effects open; the motion that is proposed is made, measured, and decides between them."""

from __future__ import annotations

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, ROBOT, WITH_OFFSET, on_joint, recorded
from support.oracles import Motion, fourier_motion

from dynident.advice import advise, decide_doubts
from dynident.diagnosis import Diagnosis, Examination, RankedEffect, examine
from dynident.excitation import Design, design_experiment
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import Recording, recording_from_arrays
from dynident.simulation import Reference, Sensors, SimulationRequest, TrueEffect, list_drive_effects, simulate

pytestmark = pytest.mark.slow

JOINT = NAMES[0]


def examined(*runs: Recording) -> Examination:
    return examine(identify(ROBOT, runs, [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND)), runs)


def significant(found: Diagnosis) -> list[RankedEffect]:
    return [item for item in found.candidates if item.significant]


def made(run: Recording, examination: Examination) -> Design:
    """The design that the diagnosis of a run with an open pair proposes, to complement the run."""
    found = advise(examination)
    first = significant(found)[0]
    assert first.joints == (JOINT,)
    assert found.next_experiment is not None
    assert all(name in found.next_experiment.reason for name in ("Stribeck friction", "Nonlinear viscous friction"))
    assert found.next_experiment.kind == "constant_velocity"
    now, then = found.next_experiment.present_separation, found.next_experiment.expected_separation
    assert now.t_value < 4 < then.t_value
    # Where only the doubts were kept, the same is proposed from the recordings.
    model = identify(ROBOT, [run], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    assert decide_doubts(model, [run], examination.doubts) == found.next_experiment
    return design_experiment(ROBOT, found.next_experiment.design, earlier=[run])


def simulated(motion: Motion | Design, hidden: TrueEffect, seed: int, name: str) -> Recording:
    """What the virtual robot measures, under control and with the noise of its sensors."""
    request = SimulationRequest(
        Reference(motion.t, motion.q, motion.dq, motion.ddq),
        (*list_drive_effects(ROBOT), hidden),
        sensors=Sensors(sampling_rate=200.0),
        seed=seed,
    )
    run = simulate(ROBOT, request)
    return recording_from_arrays(run.t, run.q, run.tau, joint_names=NAMES, name=name)


def test_the_virtual_robot_makes_the_proposed_motion_and_of_the_two_the_right_one_stands_first():
    bend = TrueEffect("viscous_nonlinear", JOINT, (("Fvn", 0.03 * ROBOT.joints[0].limits.effort),), (("p", 0.5),))
    motion = fourier_motion(ROBOT, 20.0, 200.0, 7, harmonics=5, fastest=0.9, base_frequency=0.05)
    fast = simulated(motion, bend, 1, "fast")
    second = simulated(made(fast, examined(fast)), bend, 2, "proposed")
    first, *others = significant(examined(fast, second).diagnosis)
    assert (first.effect, first.joints) == ("viscous_nonlinear", (JOINT,))
    assert "stribeck" not in [item.effect for item in others]
    assert first.choice.shape_values["p"] == pytest.approx(0.5, abs=0.1)


def test_a_peak_at_low_speed_keeps_its_name_when_the_proposed_motion_is_made():
    peak = on_joint(0, lambda q, v, load: 6.0 * np.exp(-np.abs(v / 0.15)) * np.sign(v))
    fast = recorded(fourier_motion(ROBOT, 20.0, 200.0, 7, harmonics=3, fastest=0.9), peak, 3, "fast")
    examination = examined(fast)
    # A power of the velocity fits the same data, but only one that gains energy.
    assert significant(examination.diagnosis)[0].effect == "stribeck"
    design = made(fast, examination)
    second = recorded(Motion(design.t, design.q, design.dq, design.ddq), peak, 4, "proposed")
    first = significant(examined(fast, second).diagnosis)[0]
    assert (first.effect, first.joints) == ("stribeck", (JOINT,))
    assert first.choice.shape_values["vs"] == pytest.approx(0.15, rel=0.2)
