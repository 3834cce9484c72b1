"""A verdict in words: fit for what, why not, and a stop with its cause where something is grossly wrong."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace
from typing import cast, get_args

import numpy as np
import pytest
from support.one_joint_robots import one_joint_run
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.api.model import Model
from dynident.diagnosis import DiagnosisChoices, diagnose
from dynident.effects import EffectChoice
from dynident.errors import Remedy, word_remedies, write_argument
from dynident.estimation import Errors, OutlyingSpan
from dynident.identification import Identification, IdentificationChoices, LadderStep, identify
from dynident.identification.identified_models.fit_model import _warn_of_misfit
from dynident.number_format import format_percent
from dynident.recordings import Check, Recording, Revision, recording_from_arrays
from dynident.recordings.raw_signals import SampleHashes
from dynident.recordings.recording_metadata import DELAY
from dynident.validation import ValidationOutcome
from dynident.validation.contact_detection import CollisionValidation, ContactDetection
from dynident.verdict import Action, NextStep, Outcome, find_overlaps, is_stopped, verdict
from dynident.verdict.fitness_by_use import combine_findings, judge_collision_detection, judge_feed_forward
from dynident.verdict.held_out_evidence import HeldOutEvidence
from dynident.verdict.model_verdict import _CALLS, _list_next_steps
from dynident.verdict.stop_cause import find_stop_cause

ROBOT = arm("ur10")
EFFORT = np.array([joint.limits.effort for joint in ROBOT.joints])


def measured(seed: int, noise: float = 0.005, draw: int = 0, seconds: float = 20.0) -> tuple[Motion, np.ndarray]:
    motion = fourier_motion(ROBOT, seconds, 200.0, seed)
    friction = 0.04 * EFFORT * np.sign(motion.dq) + 0.03 * EFFORT * motion.dq
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + friction
    return motion, tau + noise * EFFORT * np.random.default_rng([seed, draw]).normal(size=tau.shape)


def run(name: str, motion: Motion, tau: np.ndarray) -> Recording:
    return replace(record(ROBOT, motion, tau), name=name)


FITTED = run("fitted", *measured(3))
OTHER = run("other", *measured(4))


@pytest.fixture(scope="module")
def model() -> Identification:
    return identify(ROBOT, [FITTED], [OTHER])


def test_a_good_model_is_fit_for_prediction_and_says_so(model: Identification) -> None:
    found = verdict(model, [FITTED], [OTHER])
    fit = {one.use: one.fit for one in found.uses}
    assert fit["feed_forward"]
    assert fit["collision_detection"]
    assert found.stop is None
    assert found.common == ()
    assert not is_stopped(model)
    (feed_forward,) = (one for one in found.uses if one.use == "feed_forward")
    assert feed_forward.state == "yes"
    assert format_percent(model.held_out_moving.relative_total, decimals=1) in feed_forward.reason
    assert all(one.next_step for one in found.uses)


def test_seconds_in_which_something_else_acted_limit_every_use(model: Identification) -> None:
    motion, tau = measured(3)
    push = ((motion.t > 8.0) & (motion.t < 11.0))[:, None] * 0.2 * EFFORT * (np.arange(6) == 0)
    pushed = run("pushed", motion, tau + push)
    found = verdict(identify(ROBOT, [pushed], [OTHER]), [pushed], [OTHER])
    (step,) = [step for step in found.next_steps if "identify with the windows pushed=" in step]
    (_, end), (start, _) = [map(float, window.split(":")) for window in step.rstrip(".").split("=")[1].split(",")]
    assert 6.5 < end <= 8.1 < 10.9 <= start < 12.5
    for use in found.uses:
        assert use.state != "yes", use
    (feed_forward,) = (one for one in found.uses if one.use == "feed_forward")
    assert "something else acted on the robot" in feed_forward.reason
    assert not any("something else" in one.reason for one in verdict(model, [FITTED], [OTHER]).uses)


def test_a_diagnosis_of_the_model_does_not_change_its_verdict() -> None:
    def slides(seed: int) -> Recording:
        """Return a recording whose first joint's friction grows over 0.1 rad after a reversal."""
        motion, tau = measured(seed)
        way = np.cumsum(np.abs(np.diff(motion.q[:, 0], prepend=motion.q[0, 0])))
        since = way - np.maximum.accumulate(np.where(np.diff(np.sign(motion.dq[:, 0]), prepend=0.0) != 0.0, way, 0.0))
        tau[:, 0] -= 0.2 * EFFORT[0] * np.sign(motion.dq[:, 0]) * np.exp(-since / 0.1)
        return run(f"slides {seed}", motion, tau)

    fitted, other = slides(3), slides(4)
    model = identify(ROBOT, [fitted], [other])
    evidence = HeldOutEvidence.from_identification(model, model.held_out, [other], ())
    before = judge_feed_forward(evidence)
    step = NextStep("Find the missing effect, most often presliding friction.", "diagnose")
    assert step in [finding.next for finding in before]
    diagnose(model, [fitted], DiagnosisChoices(("presliding",)))
    assert model.model.signals.memory_signals
    assert judge_feed_forward(evidence) == before


def test_advised_windows_keep_what_was_left_out_and_the_digits_of_the_time() -> None:
    start = 1.7e9
    motion, tau = measured(3)
    push = ((motion.t > 12.0) & (motion.t < 14.0))[:, None] * 0.2 * EFFORT * (np.arange(6) == 0)
    given = ((start, start + 7.0), (start + 8.0, start + 19.5))
    pushed = run("pushed", replace(motion, t=motion.t + start), tau + push).with_windows(given)

    def advised(recording: Recording) -> list[str]:
        steps = verdict(identify(ROBOT, [recording], [OTHER]), [recording], [OTHER]).next_steps
        return [step for step in steps if "identify with the windows" in step]

    (step,) = advised(pushed)
    windows = [tuple(map(float, text.split(":"))) for text in step.rstrip(".").split("=")[1].split(",")]
    assert windows[0] == given[0]
    assert (len(windows), windows[1][0], windows[2][1]) == (3, given[1][0], given[1][1])
    assert 10.5 < windows[1][1] - start <= 12.1 < 13.9 <= windows[2][0] - start < 15.5
    # The option separates windows by commas, so that it cannot name this recording.
    assert advised(replace(pushed, name="a,b")) == []


def test_every_next_step_has_its_call_in_python() -> None:
    assert set(_CALLS) == set(get_args(Action))
    for call in _CALLS.values():
        path, *rest = call.split("(")[0].split(".")
        place = Model if path == "model" else import_module(path)
        for name in rest:
            place = getattr(place, name)
        assert callable(place)


def test_without_held_out_data_nothing_is_judged() -> None:
    found = verdict(identify(ROBOT, [FITTED]), [FITTED])
    assert {one.state for one in found.uses} == {"not_judged"}
    assert found.next_steps == ("Record another motion, and hold it out.",)


def test_what_a_check_names_is_a_next_step_without_held_out_data_too() -> None:
    model = identify(ROBOT, [FITTED])
    steps = _list_next_steps(model, [FITTED], None, (), (), NextStep("State the gravity."))
    assert steps == ["State the gravity.", "Record another motion, and hold it out."]


def with_error(model: Identification, error: float, **changes: object) -> Identification:
    """The model with this relative error of every joint on all kinds of rows, in the fit and held out."""
    names = ("fit", "held_out", "fit_moving", "held_out_moving")
    errors = [getattr(model, name) for name in names]
    scaled = {name: replace(one, squares=one.measured * error**2) for name, one in zip(names, errors, strict=True)}
    worse = replace(model, fit=scaled["fit"], held_out=scaled["held_out"], **changes)
    # Computed from the data when they are first asked for.
    worse.__dict__.update(fit_moving=scaled["fit_moving"], held_out_moving=scaled["held_out_moving"])
    return worse


def test_a_model_that_was_extended_is_not_told_to_be_until_its_error_is_unusual(model: Identification) -> None:
    def steps(error: float, parent: Identification | None) -> str:
        return " ".join(verdict(with_error(model, error, step=LadderStep(parent))).next_steps)

    assert "Diagnose which effects are missing" in steps(0.05, None)
    assert steps(0.05, model) == ""
    assert "Diagnose this model, too" in steps(0.08, model)
    assert steps(0.01, None) == ""


def test_a_failed_validation_revises_the_verdict_of_its_use_alone(model: Identification) -> None:
    failed = Outcome("simulation", ValidationOutcome("fail", "It leaves the motion."))
    before, after = (verdict(model, [FITTED], [OTHER], outcomes=some).uses for some in ([], [failed]))
    changed = [new for old, new in zip(before, after, strict=True) if old.state != new.state]
    assert [(one.use, one.state) for one in changed] == [("simulation", "no")]
    assert "The validation simulation failed: It leaves the motion." in changed[0].reason
    passed = verdict(
        model, [FITTED], [OTHER], outcomes=[Outcome("payload", ValidationOutcome("pass", "The load weighs 3 kg."))]
    )
    states = {one.use: one.state for one in passed.uses}
    assert states["payload"] == states["collision_detection"] == "yes"


@pytest.mark.parametrize(
    ("force", "state", "example"), [(200.0, "no", "140 N"), (100.0, "limited", "65 N"), (40.0, "yes", "")]
)
def test_limits_of_forces_on_people_are_called_examples(
    model: Identification, force: float, state: str, example: str
) -> None:
    evidence = HeldOutEvidence.from_identification(
        model, model.held_out, [OTHER], [Outcome("payload", ValidationOutcome("pass", "The load weighs 3 kg."))]
    )
    contact = ContactDetection(
        force, 1 / 15, 1.0, 30.0, np.ones((ROBOT.n, 2)), np.ones((ROBOT.n, 4)), 200.0, force_at_rest=3 * force
    )
    findings = judge_collision_detection(evidence, CollisionValidation(contact, 0, 0.0, ValidationOutcome("pass", "")))
    use = combine_findings("collision_detection", findings, NextStep("Export it."))
    assert use.state == state
    if example:
        assert f"above {example}, an example of what" in use.reason
        assert "The limit that counts is that of your risk assessment." in use.reason


def test_a_model_without_its_recordings_is_judged_by_its_errors_where_these_suffice(model: Identification) -> None:
    states = {one.use: one.state for one in verdict(model).uses}
    assert states == {
        "simulation": "not_judged",
        "feed_forward": "limited",
        "collision_detection": "not_judged",
        "payload": "not_judged",
    }


def test_plain_least_squares_that_no_robot_has_say_what_cures_them() -> None:
    plain = identify(ROBOT, [FITTED], [OTHER], IdentificationChoices(estimator="wls"))
    (simulation,) = (one for one in verdict(plain, [FITTED], [OTHER]).uses if one.use == "simulation")
    assert simulation.state == "no"
    assert "These parameters are not physically feasible" in simulation.reason
    assert simulation.next_action == "identify_feasible"


def test_friction_that_drives_at_recorded_speeds_is_not_feasible() -> None:
    bent = EffectChoice("viscous_nonlinear", shape=(("p", 2.0),))
    effects = (*(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous")), bent)
    model = identify(ROBOT, [FITTED], [OTHER], IdentificationChoices(effects))
    values = model.values.copy()
    places = {column.name: k for k, column in enumerate(model.model.kept)}
    # The friction of the first joint falls below zero before its largest recorded speed.
    speed = float(model.estimate.speeds[0])
    values[places["Fvn1"]] = -(values[places["Fc1"]] + values[places["Fv1"]] * speed) / (0.5 * speed) ** 2
    solution = replace(model.estimate.solution, values=values)
    assert model.estimate.standard is not None
    driving = replace(model, estimate=replace(model.estimate, solution=solution))
    (simulation,) = (one for one in verdict(driving, [FITTED], [OTHER]).uses if one.use == "simulation")
    assert simulation.state == "no"
    assert "These parameters are not physically feasible" in simulation.reason


def test_an_error_between_the_limits_is_fit_for_some_uses_alone(model: Identification) -> None:
    worse = with_error(model, 0.12)
    fit = {one.use: one.fit for one in verdict(worse).uses}
    assert fit["feed_forward"]
    assert not fit["collision_detection"]
    assert not fit["payload"]


def test_columns_in_another_order_are_the_cause_of_a_stop(model: Identification) -> None:
    motion, tau = measured(4)
    wrong = run("wrong", motion, tau[:, [1, 0, 2, 3, 4, 5]])
    stopped = identify(ROBOT, [FITTED], [wrong])
    assert is_stopped(stopped)
    found = verdict(stopped, [FITTED], [wrong])
    assert found.stop is not None
    assert found.stop.recording == "wrong"
    assert found.stop.apply == Revision(permutation={"tau": (2, 1, 3, 4, 5, 6)})
    assert not any(one.fit for one in found.uses)
    assert found.summary.startswith("Stop: In wrong")
    # Each front end words what is to be done in its own syntax.
    assert found.stop.remedies
    for remedy in found.stop.remedies:
        assert str(remedy) in found.summary
        for text in (repr(found), found._repr_html_()):
            assert str(remedy) not in text
            assert write_argument(remedy).split("{")[0] in text


def test_a_check_against_every_use_is_worded_in_python() -> None:
    remedy = Remedy("columns", {"tau1": "none"})
    check = Check("torque_sign", "warning", f"tau1 looks wrong. Say {remedy}.", remedies=(remedy,))
    found = verdict(identify(ROBOT, [FITTED], [OTHER]), [FITTED], [OTHER], {"fitted": [check]})
    assert str(remedy) in found.uses[0].reason
    assert 'Say columns={"tau1": "none"}.' in repr(found)
    assert str(remedy) not in repr(found)


def test_a_cause_that_a_check_names_comes_before_a_diagnosis(model: Identification) -> None:
    worse = with_error(model, 0.2)
    delay = Check(DELAY, "warning", "The torque is late.")
    without, named = verdict(worse), verdict(worse, checks={"fitted": [delay]})
    assert {use.next.action for use in without.uses} == {"diagnose"}
    assert all(use.next.sentence.startswith("First correct what the check torque delay") for use in named.uses)
    assert "Diagnose" in str(without.next_steps)
    assert ("Diagnose" in str(named.next_steps), "First correct" in str(named.next_steps)) == (False, True)
    accepted = verdict(worse, checks={"fitted": [replace(delay, is_accepted=True)]})
    assert accepted.next_steps == without.next_steps


def test_a_diagnosis_is_next_only_where_nothing_comes_before_it(model: Identification) -> None:
    checks = {"fitted": [Check(DELAY, "warning", "The torque is late.")]}
    for error in (0.05, 0.2):
        worse = with_error(model, error)
        assert verdict(worse).calls_for_diagnosis
        named = verdict(worse, checks=checks)
        assert ("First correct" in str(named.next_steps), named.calls_for_diagnosis) == (True, False)
    # Other actions, such as to weigh a load, are no diagnosis.
    assert any(use.next.action for use in verdict(with_error(model, 0.05), checks=checks).uses)
    assert not verdict(with_error(model, 0.001)).calls_for_diagnosis


def test_a_disturbed_span_hides_no_other_step(model: Identification, monkeypatch: pytest.MonkeyPatch) -> None:
    spans = SimpleNamespace(spans=(OutlyingSpan(0, 1, 1.0, 2.0, 9.0),))
    monkeypatch.setattr("dynident.verdict.model_verdict.find_outlying_spans", lambda _: spans)
    worse = with_error(model, 0.2)
    assert not any("First correct" in step for step in verdict(worse).next_steps)
    named = verdict(worse, checks={"fitted": [Check(DELAY, "warning", "The torque is late.")]})
    assert [step.split(" ")[0] for step in named.next_steps] == ["Leave", "First"]
    commanded = verdict(worse, [replace(FITTED, torque_from_commands=True)])
    assert any(step.startswith("Record the currents of the servos") for step in commanded.next_steps)


def test_rows_at_rest_of_drives_that_are_off_are_no_misfit(model: Identification) -> None:
    worse = with_error(model, 0.4)
    assert "Even in the fit" in str(_warn_of_misfit(worse))
    worse.__dict__.update(fit_moving=with_error(model, 0.01).fit_moving)
    assert _warn_of_misfit(worse) == []


def test_a_remedy_that_was_worded_is_not_worded_again() -> None:
    remedy = Remedy("scale", {"tau1": 10})
    once = word_remedies(f"Say {remedy}.", [remedy], "{} in --metadata".format)
    assert once.count("--metadata") == 1
    assert word_remedies(once, [remedy], "{} in --metadata".format) == once


def test_a_joint_alone_that_is_not_explained_is_named(model: Identification) -> None:
    motion, tau = measured(4)
    off = run("off", motion, tau * np.where(np.arange(6) == 1, 10.0, 1.0))
    found = verdict(identify(ROBOT, [FITTED], [off]), [FITTED], [off])
    assert found.stop is not None
    assert ROBOT.joint_names[1] in found.stop.cause
    assert found.stop.apply is not None
    assert found.stop.apply.scale == {"tau2": pytest.approx(0.1)}


def test_the_data_of_the_fit_held_out_are_told_and_judge_nothing() -> None:
    same = replace(FITTED, name="same")
    found = verdict(identify(ROBOT, [FITTED], [same]), [FITTED], [same])
    assert found.stop is not None
    assert "same samples" in found.stop.cause
    assert not any(one.fit for one in found.uses)


def test_a_shifted_part_and_one_sampled_anew_are_copies_and_another_run_is_none() -> None:
    motion, tau = measured(3)
    part = slice(1000, 3000)
    cut = recording_from_arrays(motion.t[part] + 70.0, motion.q[part], tau[part], joint_names=ROBOT.joint_names)
    t = np.arange(motion.t[0], motion.t[-1], 0.004) + 0.0011
    t = t[t < motion.t[-1]]
    q, torque = (np.stack([np.interp(t, motion.t, c) for c in x.T], axis=1) for x in (motion.q, tau))
    anew = recording_from_arrays(t, q, torque, joint_names=ROBOT.joint_names)
    repeated = run("repeated", *measured(3, draw=1))
    kinds = [[one.kind for one in find_overlaps([FITTED], [other])] for other in (cut, anew, repeated, OTHER)]
    assert kinds[0] == ["copied"]
    assert kinds[1] in (["copied"], ["repeated"])
    assert kinds[2:] == [["repeated"], []]


@pytest.mark.parametrize("seconds", [0.05, 0.3, 0.9])
def test_windows_of_the_fit_s_own_samples_judge_nothing_however_short_they_are(seconds: float) -> None:
    motion, tau = measured(3, seconds=30.0)
    whole = run("whole", motion, tau)
    starts = np.arange(2.0, 28.0, 2.0)
    pieces = replace(whole, name="pieces").with_windows([(start, start + seconds) for start in starts])
    found = verdict(identify(ROBOT, [whole], [pieces]), [whole], [pieces])
    assert [(one.kind, one.held_out) for one in found.common] == [("copied", "pieces")]
    assert found.common[0].share > 0.99
    assert "same samples" in found.summary
    assert not any(one.fit for one in found.uses)


def test_a_part_of_the_samples_is_told_and_windows_that_touch_are_apart() -> None:
    motion, tau = measured(3, seconds=9.0)
    whole = run("whole", motion, tau)
    fit, beside = whole.with_windows(((0.0, 5.0),)), whole.with_windows(((5.0, 9.0),))
    assert find_overlaps([fit], [beside]) == ()
    [found] = find_overlaps([fit], [whole.with_windows(((4.4, 9.0),))])
    assert found.kind == "copied"
    assert found.share == pytest.approx(0.6 / 4.6, abs=0.02)
    assert "partly the error of the fit" in str(found)


def test_counts_that_are_coarse_and_repeat_singly_are_no_copy() -> None:
    def coarse(seed: int) -> Recording:
        rows = next(iter(one_joint_run("pendulum", seed).source.rows(0, 2000, 2000)))
        q, tau = np.round(rows.q, 2), np.round(rows.tau)
        return recording_from_arrays(0.01 * np.arange(2000), q, tau, joint_names=("axis",))

    one, other = coarse(1), coarse(2)
    singly = [
        {tuple(row) for row in np.hstack([r.q, r.tau])}
        for r in (next(iter(x.source.rows(0, 2000, 2000))) for x in (one, other))
    ]
    assert len(singly[0] & singly[1]) > 0.05 * len(singly[0])
    assert SampleHashes.from_recording(one).measure_share_in(SampleHashes.from_recording(other)) < 0.01
    assert SampleHashes.from_recording(one).measure_share_in(SampleHashes.from_recording(one)) == 1.0


def test_another_part_of_the_same_file_is_no_copy() -> None:
    motion, tau = measured(3, seconds=40.0)
    whole = run("whole", motion, tau)
    halves = whole.with_windows(((0.0, 15.0),)), whole.with_windows(((25.0, 40.0),))
    # The motion has a period of 10 s.
    assert [one.kind for one in find_overlaps([halves[0]], [halves[1]])] == ["repeated"]


def test_a_repeated_motion_is_said_to_be_one() -> None:
    repeated = run("repeated", *measured(3, draw=1))
    found = verdict(identify(ROBOT, [FITTED], [repeated]), [FITTED], [repeated])
    assert found.stop is None
    good = [one for one in found.uses if one.fit]
    assert good
    assert all("this motion only" in one.reason for one in good)
    assert "Hold out another motion" in found.next_steps[0]


@pytest.mark.parametrize(("condition", "records_more"), [(3000.0, True), (60.0, False)])
def test_held_out_joints_that_the_motion_does_not_determine_have_no_wrong_column(
    condition: float, records_more: bool
) -> None:
    """Two of six joints fail on held-out data: their columns were right in the fit, if its motion says enough."""
    counts, measured = np.full(6, 500.0), np.full(6, 40.0)
    fit = Errors((0.03 * measured) ** 2, measured**2, counts)
    shares = np.array([0.2, 0.3, 1.8, 0.1, 9.0, 0.2])
    held_out = Errors((shares * measured) ** 2, measured**2, counts)
    identification = SimpleNamespace(
        fit=fit,
        held_out=held_out,
        fit_moving=fit,
        held_out_moving=held_out,
        model=SimpleNamespace(robot=arm("ur10")),
        equilibrated_condition_number=condition,
    )
    stop = find_stop_cause(cast("Identification", identification), (), (), ())
    assert stop is not None
    assert stop.records_more == records_more
    assert ("check the unit" in stop.cause) != records_more
