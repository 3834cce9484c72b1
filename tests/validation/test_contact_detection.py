"""Contact thresholds keep their rate of false alarms, say which rate the data can state, and are tried in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support.models_with_chosen_parameters import drives, from_standard, made_up, measured
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.errors import DynidentError
from dynident.estimation.residual_errors import compute_threshold
from dynident.export import export_model
from dynident.identification import Identification
from dynident.recordings import Recording
from dynident.robot import Robot
from dynident.validation import MomentumObserver, contact_detection, validate_collision
from dynident.validation.contact_detection import (
    ContactDetection,
    compute_contact_forces,
    explain_no_detection,
    fit_contact_detection,
)
from dynident.validation.momentum_observer import Run, observe_recording
from dynident.verdict.fitness_by_use import judge_collision_detection
from dynident.verdict.held_out_evidence import HeldOutEvidence

ROBOT = arm("ur10")
RATE = 200.0


@pytest.mark.parametrize("count", [25, 120])
def test_a_threshold_is_met_as_often_as_stated_whatever_few_values_say_of_the_tail(count: int) -> None:
    share, rng = 2e-4, np.random.default_rng(4)
    # Of exponential values one is above x with the probability exp(-x).
    met = np.exp([-compute_threshold([rng.exponential(size=count)], share) for _ in range(3000)])
    assert 0.6 * share < met.mean() < 1.6 * share


def test_a_motion_that_is_repeated_says_less_than_as_much_motion_that_is_not() -> None:
    rng = np.random.default_rng(5)
    once, other = rng.exponential(size=(2, 20))
    repeated = compute_threshold([np.tile(once, 8)], 1e-4)
    different = compute_threshold([rng.permutation(np.tile(once, 8))], 1e-4)
    assert repeated > 1.2 * different
    assert compute_threshold([np.ones(30)], 1e-4) == pytest.approx(1.0)
    assert compute_threshold([other], 0.5) == pytest.approx(np.median(other), rel=0.3)


def known() -> Identification:
    return from_standard(ROBOT, drives(ROBOT))


def move(seed: int, noise: float, duration: float = 20.0) -> Recording:
    """A motion of the known arm, whose torque has noise of a tenth of a second's memory."""
    motion, values = fourier_motion(ROBOT, duration, RATE, seed), drives(ROBOT)
    rotor, dry, viscous = (np.array([values[f"{name}{j + 1}"] for j in range(ROBOT.n)]) for name in ("Ia", "Fc", "Fv"))
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    tau += rotor * motion.ddq + dry * np.sign(motion.dq) + viscous * motion.dq
    white = np.random.default_rng(seed).normal(size=tau.shape)
    smooth = np.apply_along_axis(np.convolve, 0, white, np.ones(20) / 20, "same")
    return record(ROBOT, motion, tau + noise * smooth, f"run{seed}")


def test_short_recordings_state_the_rate_that_they_can_state() -> None:
    runs = observe_recording(known(), move(1, 1.0))
    detection = fit_contact_detection(ROBOT, runs, 1.0)
    assert detection is not None
    assert detection.requested == 1.0
    assert detection.false_alarms_an_hour == pytest.approx(180.0 / detection.seconds)
    assert "To state 1 false alarm an hour, hold out 180 s." in detection.describe()
    often = fit_contact_detection(ROBOT, runs, 100.0)
    assert often is not None
    assert often.false_alarms_an_hour == 100.0
    assert often.force < detection.force
    assert "hold out" not in often.describe()
    assert fit_contact_detection(ROBOT, observe_recording(known(), move(1, 1.0, 5.0)), 1.0) is None


def test_a_header_says_whether_it_has_thresholds() -> None:
    long, short = ([move(1, 1.0, duration)] for duration in (20.0, 5.0))
    file = export_model(known(), "c_header", held_out=long, false_alarms_per_hour=100.0)
    assert b"_find_contacts(" in file.content
    assert any("100 false alarms an hour" in note for note in file.notes)
    file = export_model(known(), "c_header", held_out=short)
    assert b"_find_contacts(" not in file.content
    assert any("no thresholds for contacts" in note and "less than 15 s" in note for note in file.notes)
    mute = [replace(recording, joints_without_torque=(ROBOT.joint_names[2],)) for recording in long]
    [note] = export_model(known(), "c_header", held_out=mute).notes
    assert f"No recording has the torque of {ROBOT.joint_names[2]}" in note
    with pytest.raises(DynidentError, match="false_alarms_per_hour"):
        export_model(known(), "c_header", held_out=long, false_alarms_per_hour=0.0)


@pytest.mark.parametrize("effect", ["temperature_friction", "warm_up_friction"])
def test_a_model_that_no_observer_can_use_has_a_header_all_the_same(effect: str) -> None:
    model = made_up(ROBOT, ("rigid_body", "coulomb", effect))
    for format in ("c_header", "cpp_header"):
        file = export_model(model, format, held_out=[move(1, 1.0)])
        assert [note for note in file.notes if "contacts" in note] == [file.notes[-1]]
        assert file.notes[-1].startswith("There is no observer of contacts: effects of this model depend on ")


def test_a_recording_that_cannot_be_observed_is_no_reason_to_have_no_header() -> None:
    other = arm("scara")
    motion = fourier_motion(other, 20.0, RATE, 1)
    file = export_model(known(), "c_header", held_out=[record(other, motion, np.zeros_like(motion.q))])
    assert file.notes[-1].startswith("There are no thresholds for contacts: ")


def test_what_keeps_thresholds_from_being_found_is_named() -> None:
    recordings = [move(1, 1.0)]
    assert "15 s of unbroken motion" in explain_no_detection(known(), [move(1, 1.0, 5.0)])
    mute = replace(recordings[0], joints_without_torque=(ROBOT.joint_names[0],))
    assert f"torque of {ROBOT.joint_names[0]}" in explain_no_detection(known(), [mute])
    assert f"torque of {ROBOT.joint_names[0]}" in validate_collision(known(), [mute]).judged.reason
    assert "does not show at the joints" in explain_no_detection(known(), recordings)


def test_a_recording_that_the_others_do_not_speak_for_disproves_the_rate() -> None:
    alike = validate_collision(known(), [move(seed, 1.0) for seed in (1, 2, 3)], 60.0)
    assert alike.judged.verdict == "pass", alike.judged.reason
    assert alike.expected > 0.5
    other = validate_collision(known(), [move(1, 1.0), move(2, 1.0), move(3, 8.0)], 60.0)
    assert other.is_disproved
    assert other.judged.verdict == "fail"
    assert f"{other.alarms} false alarms came up where" in other.judged.reason
    findings = judge_collision_detection(evidence(), other)
    (limit,) = (finding for finding in findings if "in some of the recordings" in finding.sentence)
    assert limit.state == "limited"


def evidence() -> HeldOutEvidence:
    model, robot = measured(), arm("scara")
    motion = fourier_motion(robot, 5.0, RATE, 1)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    return HeldOutEvidence.from_identification(model, model.fit, [record(robot, motion, tau)], [])


def test_what_follows_an_alarm_within_a_second_belongs_to_it() -> None:
    ((observed, period),) = observe_recording(known(), move(1, 0.0, 8.0))
    quiet = replace(observed, residual=np.zeros_like(observed.residual))
    detection = ContactDetection(10.0, 1 / 15, 1.0, 30.0, np.ones((ROBOT.n, 2)), np.full((ROBOT.n, 4), 5.0), 8.0)
    assert detection.count_alarms(quiet, period) == 0
    for second, joint in ((1.0, 0), (1.4, 3), (1.9, 0), (2.5, 1), (4.0, 5)):
        quiet.residual[round(second / period), joint] = -6.0
    assert detection.count_alarms(quiet, period) == 3
    # An alarm that never ends is one a second.
    quiet.residual[:, 0] = 7.0
    assert abs(detection.count_alarms(quiet, period) - len(quiet.residual) * period) <= 1


def test_static_friction_hides_a_contact_whichever_way_it_holds_the_joint() -> None:
    ((observed, period),) = observe_recording(known(), move(1, 0.0, 8.0))
    detection = ContactDetection(10.0, 1 / 15, 1.0, 30.0, np.ones((ROBOT.n, 2)), np.full((ROBOT.n, 4), 10.0), 8.0)
    at_rest = []
    for held in (0.0, 5.0, -5.0):
        residual = np.full_like(observed.residual, held)
        still = replace(observed, residual=residual, slow=np.ones_like(observed.slow))
        moving, force = compute_contact_forces(ROBOT, [(still, period)], detection)
        assert moving is None
        at_rest.append(force)
    assert at_rest[1:] == pytest.approx([1.5 * at_rest[0]] * 2)


def test_what_no_observer_can_know_is_said() -> None:
    with pytest.raises(DynidentError, match="above 0"):
        validate_collision(known(), [], 0.0)
    with pytest.raises(DynidentError, match="temperature") as caught:
        MomentumObserver(made_up(arm("scara"), ("rigid_body", "temperature_friction")), 1e-3)
    findings = judge_collision_detection(evidence(), None, caught.value.detail)
    (reason,) = (finding.sentence for finding in findings if finding.state == "not_judged")
    assert "temperature" in reason
    assert validate_collision(known(), []).judged.verdict == "not_evaluated"


def test_torque_that_was_not_recorded_is_no_contact() -> None:
    whole = [move(seed, 1.0) for seed in (1, 2)]
    quiet = move(3, 1.0)
    silent = replace(quiet, joints_without_torque=(ROBOT.joint_names[1],))
    fractions: list[float] = []
    both = validate_collision(known(), [*whole, silent], 60.0, progress=lambda done, _: fractions.append(done))
    alone = validate_collision(known(), whole, 60.0)
    assert (both.contact is None, alone.contact is None) == (False, False)
    np.testing.assert_array_equal(both.contact.thresholds, alone.contact.thresholds)
    assert (both.alarms, both.expected) == (alone.alarms, alone.expected)
    # A fit without each of the recordings takes time, too.
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(5 / 6)
    judged = validate_collision(known(), [silent]).judged
    assert judged.verdict == "not_evaluated"
    assert f"torque of {ROBOT.joint_names[1]}" in judged.reason
    findings = judge_collision_detection(evidence(), validate_collision(known(), [silent]))
    assert any(ROBOT.joint_names[1] in finding.sentence for finding in findings if finding.state == "not_judged")


def test_the_force_is_searched_for_once_whatever_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    fits: list[int] = []

    def count(robot: Robot, runs: Sequence[Run], detection: ContactDetection) -> tuple[float, None]:
        fits.append(len(runs))
        return 10.0, None

    monkeypatch.setattr(contact_detection, "compute_contact_forces", count)
    outcome = validate_collision(known(), [move(seed, 1.0) for seed in (1, 2, 3)], 60.0)
    assert fits == [3]
    assert outcome.expected > 0.5
