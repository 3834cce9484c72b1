"""A mass was added to a link, and the loaded run does not tell which: the motion that is proposed decides it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.hidden_effects import BAND, NAMES, ROBOT, WITH_OFFSET
from support.oracles import Motion, fourier_motion

from dynident.advice import AdvisedDiagnosis, advise
from dynident.diagnosis import DiagnosisChoices, examine
from dynident.excitation import Design, design_experiment
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import Recording, recording_from_arrays
from dynident.simulation import Reference, Sensors, SimulationRequest, TrueEffect, list_drive_effects, simulate

pytestmark = pytest.mark.thorough

HELD = (ROBOT.n - 2, ROBOT.n - 1)
MASS, ASIDE, ALONG = 1.5, 0.08, 0.05
AT_HAND = 20.0


def measured(motion: Motion | Design, link: int | None, seed: int, name: str) -> Recording:
    """What the virtual robot measures, with the mass on a link or without it."""
    body = (("Mp", MASS), ("MXp", MASS * ASIDE), ("MYp", 0.0), ("MZp", MASS * ALONG))
    hidden = () if link is None else (TrueEffect("payload", NAMES[link], body),)
    request = SimulationRequest(
        Reference(motion.t, motion.q, motion.dq, motion.ddq),
        (*list_drive_effects(ROBOT), *hidden),
        sensors=Sensors(sampling_rate=200.0),
        seed=seed,
    )
    run = simulate(ROBOT, request)
    return recording_from_arrays(run.t, run.q, run.tau, joint_names=NAMES, name=name)


def wandering(seed: int) -> Motion:
    return fourier_motion(ROBOT, AT_HAND, 200.0, seed, harmonics=5, fastest=0.9, base_frequency=0.05)


def with_a_stiff_wrist(motion: Motion) -> Motion:
    q, dq, ddq = motion.q.copy(), motion.dq.copy(), motion.ddq.copy()
    for joint in HELD:
        q[:, joint], dq[:, joint], ddq[:, joint] = 0.3, 0.0, 0.0
    return replace(motion, q=q, dq=dq, ddq=ddq)


def diagnosed(*runs: Recording) -> AdvisedDiagnosis:
    found = identify(ROBOT, runs, [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    return advise(examine(found, runs, DiagnosisChoices(("payload",))))


@pytest.mark.parametrize(
    "link", [ROBOT.n - 2, *(pytest.param(ROBOT.n - k, marks=pytest.mark.thorough) for k in (1, 3))]
)
def test_of_links_that_a_stiff_wrist_makes_one_the_right_one_is_named_after_the_proposed_motion(link: int):
    runs = [measured(wandering(7), None, 1, "empty"), measured(with_a_stiff_wrist(wandering(8)), link, 2, "loaded")]
    before = diagnosed(*runs)
    (first,) = before.recommended
    # The outer one, since nothing speaks against it.
    assert (first.effect, first.joints) == ("payload", (NAMES[-1],))
    assert all(name in before.candidates[0].evidence for name in NAMES[-3:-1])
    proposed = before.next_experiment
    assert proposed is not None
    assert all(name in proposed.reason for name in NAMES[-3:])
    assert any("left" in line or "Leave" in line for line in proposed.instructions)
    now, then = proposed.present_separation, proposed.expected_separation
    assert now.t_value < 1 < 4 < then.t_value
    design = design_experiment(ROBOT, proposed.design, earlier=runs)
    after = diagnosed(*runs, measured(design, link, 3, "proposed"))
    (decided,) = after.recommended
    assert (decided.effect, decided.joints) == ("payload", (NAMES[link],))
    assert decided.runs == ("loaded", "proposed")
    assert after.next_experiment is None or "the same on" not in after.next_experiment.reason


def test_where_the_loaded_run_moves_the_wrist_nothing_is_asked():
    runs = [measured(wandering(7), None, 1, "empty"), measured(wandering(8), ROBOT.n - 2, 2, "loaded")]
    found = diagnosed(*runs)
    assert [choice.joints for choice in found.recommended] == [(NAMES[-2],)]
    assert found.next_experiment is None or "the same on" not in found.next_experiment.reason
