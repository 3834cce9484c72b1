"""Eight lines from files to a better model, and each of them the same as the library's own."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from support.small_arm_files import write_run

import dynident as dy
from dynident import diagnosis, identification
from dynident.advice import advise
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.simulation import ActingEffect, Sensors, Simulated

EIGHT_LINES = """
import dynident as dy
robot = dy.load_robot("arm.urdf")
runs = dy.read_recordings("run1.csv", "run2.csv", robot=robot)
model = dy.identify(robot, runs[:1], validation=runs[1:])
found = dy.diagnose(model, runs[:1]); better = model.extend(found)
better.plot(); better.parameters.to_frame(); better.save("arm.npz")
print(found.summary, model.held_out.relative_total > 4 * better.held_out.relative_total)
"""


def test_the_eight_lines_find_the_missing_effect_and_halve_the_error_twice(desk: Path) -> None:
    pytest.importorskip("pandas")
    ended = subprocess.run(
        [sys.executable, "-c", EIGHT_LINES], cwd=desk, env={**os.environ}, capture_output=True, text=True, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
    assert "Stribeck friction on shoulder" in ended.stdout
    assert ended.stdout.strip().endswith("True")
    assert (desk / "arm.npz").is_file()


def test_a_model_is_that_of_the_library(model: dy.Model, robot: dy.Robot, runs: dy.Recordings) -> None:
    same = identification.identify(robot, runs[:1].recordings, runs[1:].recordings)
    np.testing.assert_array_equal(model.identification.values, same.values)
    assert [one.name for one in model.parameters] == [one.name for one in same.parameters]
    assert model.held_out is not None
    assert same.held_out is not None
    assert model.held_out.relative_total == same.held_out.relative_total


def test_a_diagnosis_looks_at_what_the_model_was_identified_from(found: dy.DiagnosedModel, model: dy.Model) -> None:
    same = diagnosis.diagnose(model.identification, model.recordings.recordings)
    assert found.summary == same.summary
    assert found.recommended == same.recommended
    assert (found.unknown, found.not_visible) == (same.unknown, same.not_visible)
    assert found.recordings.names == ("run1",)


def test_extending_by_a_diagnosis_is_extending_by_what_it_recommends(
    better: dy.Model, model: dy.Model, found: dy.DiagnosedModel, runs: dy.Recordings
) -> None:
    same = identification.extend(model.identification, found.recommended, runs[:1].recordings, runs[1:].recordings)
    np.testing.assert_array_equal(better.identification.values, same.values)
    assert better.effects == same.choices.effects
    assert len(better.ladder) == 2
    assert better.ladder[0].identification is model.identification


@pytest.mark.parametrize("kind", ["library diagnosis", "ranked effect", "choice", "text"])
def test_a_model_takes_whatever_says_which_effect(
    kind: str, better: dy.Model, model: dy.Model, found: dy.DiagnosedModel
) -> None:
    choice = found.recommended[0]
    shape = ",".join(f"{name}={value!r}" for name, value in choice.shape)
    what = {
        "library diagnosis": found.diagnosis,
        "ranked effect": found.candidates[0],
        "choice": choice,
        "text": f"stribeck@shoulder:{shape}",
    }[kind]
    np.testing.assert_allclose(model.extend(what).identification.values, better.identification.values, rtol=1e-9)


def test_effects_that_were_added_can_be_removed_again(better: dy.Model, model: dy.Model) -> None:
    without = better.remove("stribeck@shoulder")
    assert without.effects == model.effects
    np.testing.assert_allclose(without.identification.values, model.identification.values, rtol=1e-6, atol=1e-6)
    assert [rung.identification.model.n_parameters for rung in without.ladder] == [19, 20, 19]


def test_effects_can_be_written_when_identifying(robot: dy.Robot, runs: dy.Recordings) -> None:
    made = dy.identify(robot, runs[0], effects=["default", "offset@elbow"], estimator="ols")
    assert made.effects[-1] == EffectChoice("offset", ("elbow",))
    assert made.identification.choices.estimator == "ols"
    assert made.held_out is None


def test_what_is_chosen_beside_the_choices_wins(robot: dy.Robot, runs: dy.Recordings) -> None:
    choices = dy.IdentificationChoices(estimator="ols", covariance="by_joint")
    made = dy.identify(robot, runs[0], choices=choices, estimator="irls").identification
    assert (made.choices.estimator, made.choices.covariance) == ("irls", "by_joint")


def test_a_saved_model_comes_back_the_same(better: dy.Model, runs: dy.Recordings, tmp_path: Path) -> None:
    better.save(tmp_path / "arm.npz")
    again = dy.load_model(tmp_path / "arm.npz")
    np.testing.assert_array_equal(again.identification.values, better.identification.values)
    assert [one.name for one in again.parameters] == [one.name for one in better.parameters]
    assert len(again.ladder) == 2
    assert not again.recordings
    assert again.with_data(runs[:1], runs[1:]).recordings.names == ("run1",)


def test_a_model_out_of_a_file_is_extended_once_it_has_its_data(
    model: dy.Model, better: dy.Model, found: dy.DiagnosedModel, runs: dy.Recordings, tmp_path: Path
) -> None:
    model.save(tmp_path / "arm.npz")
    again = dy.load_model(tmp_path / "arm.npz")
    with pytest.raises(dy.DynidentError, match=r"run1.*model\.with_data"):
        again.extend(found)
    with pytest.raises(dy.DynidentError, match=r"run1.*model\.with_data"):
        dy.diagnose(again)
    grown = again.with_data(runs[:1], runs[1:]).extend(found)
    np.testing.assert_allclose(grown.identification.values, better.identification.values, rtol=1e-7, atol=1e-9)


def test_the_data_that_a_model_is_given_are_those_that_it_was_identified_from(
    model: dy.Model, runs: dy.Recordings
) -> None:
    with pytest.raises(dy.DynidentError, match=r"identified from \(run1\): run2 holds other samples"):
        model.with_data(runs[1:])
    with pytest.raises(dy.DynidentError, match=r"validated on run2; these recordings are run1"):
        model.with_data(runs[:1], runs[:1])


def test_a_changed_joint_is_found_between_two_days(desk: Path, model: dy.Model, runs: dy.Recordings) -> None:
    today = dy.read_recordings(desk / "today.csv", robot=model.robot)
    found = dy.changes(model, before=runs, after=today)
    # Whatever changed, what the friction of each joint did is told.
    assert [one.joint for one in found.diagnosis.friction] == list(model.robot.joint_names)
    assert "friction of" in repr(found)
    assert "friction of" in found._repr_html_()
    first = found[0]
    assert (first.choice.effect, first.choice.joints) == ("coulomb", ("elbow",))
    assert first.main.interval[0] < 1.5 < first.main.interval[1]
    same = diagnosis.diagnose(model.identification, today.recordings, baseline=runs.recordings)
    assert found.items == same.changes
    assert "elbow" in repr(found)


def test_a_recording_on_both_sides_is_refused(model: dy.Model, runs: dy.Recordings) -> None:
    with pytest.raises(dy.DynidentError, match="run2 is among the earlier and the later recordings"):
        dy.changes(model, before=runs, after=runs[1:])


def test_a_comparison_is_that_of_the_library(better: dy.Model, runs: dy.Recordings) -> None:
    compared = dy.compare(better, runs)
    direct = diagnosis.compare(better.identification, runs["run2"].recording)
    assert compared["run2"].comparison.errors.relative_total == direct.errors.relative_total
    assert [item.name for item in compared[:1]] == ["run1"]


def test_a_comparison_tells_a_motion_that_only_repeats_what_was_learnt(
    desk: Path, better: dy.Model, runs: dy.Recordings, tmp_path: Path
) -> None:
    (tmp_path / "again.csv").write_bytes((desk / "run1.csv").read_bytes())
    again = dy.read_recordings(tmp_path / "again.csv", robot=better.robot)
    assert any("repeats the motion of run1" in note for note in dy.compare(better, again)[0].judgement.notes)
    for other in dy.compare(better, runs):
        assert not any("repeats the motion of" in note for note in other.judgement.notes)


def test_validations_say_which_of_them_was_not_possible(better: dy.Model) -> None:
    tried = dy.validate(better)
    assert [one.verdict for one in tried] == ["pass", "pass", "pass"]
    assert tried.verdict == "pass"
    alone = dy.validate(dy.Model(better.identification))
    assert [one.verdict for one in alone] == ["not_evaluated", "not_evaluated", "pass"]
    assert dy.validate(better, limit=1e-6).verdict == "fail"


def test_a_report_is_one_page_with_the_diagnosis_in_it(
    better: dy.Model, found: dy.DiagnosedModel, tmp_path: Path
) -> None:
    page = dy.report(better, diagnosis=found, validations=dy.validate(better), title="My arm")
    page.save(tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.count("My arm") >= 1
    assert "Stribeck friction" in text
    assert "cross: on held-out data" in text
    page.save(tmp_path / "report.pdf")
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(DynidentError, match=r"report\.txt; the file name must end in \.html, \.htm or \.pdf"):
        page.save(tmp_path / "report.txt")


def test_a_design_is_the_one_asked_for_and_goes_to_a_file(robot: dy.Robot, tmp_path: Path) -> None:
    made = dy.design(
        robot, dy.DesignRequest(seed=3), kind="random", duration=5.0, sampling_rate=50.0, effects="default,offset"
    )
    assert made.design.request.trajectory.duration == 5.0
    assert made.design.request.effects_or_default[-1].effect == "offset"
    for ending in ("csv", "parquet", "yaml"):
        made.save(tmp_path / f"motion.{ending}")
    head = (tmp_path / "motion.csv").read_text(encoding="utf-8").splitlines()[0]
    assert head.startswith("t,q_shoulder")
    assert "joint_names" in (tmp_path / "motion.yaml").read_text(encoding="utf-8")


def test_a_design_of_a_diagnosis_that_proposes_none_is_refused(robot: dy.Robot, found: dy.DiagnosedModel) -> None:
    assert found.next_experiment is None
    with pytest.raises(dy.DynidentError, match="proposes no experiment"):
        dy.design(robot, found)


def test_the_next_experiment_is_computed_when_it_is_asked_for(model: dy.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    examined: list[diagnosis.Examination] = []
    monkeypatch.setattr(
        "dynident.api.model_diagnosis.advise",
        lambda examination: (examined.append(examination), advise(examination))[1],
    )
    found = dy.diagnose(model, candidates=["stribeck", "viscous_nonlinear"])
    repr(found), found._repr_html_()
    assert not examined
    assert found.next_experiment is found.next_experiment
    assert examined == [found.examination]


def test_a_diagnosis_says_how_many_questions_are_open(found: dy.DiagnosedModel) -> None:
    examination = replace(found.examination, doubts=())
    assert "open" not in repr(replace(found, examination=examination))
    doubt = diagnosis.Doubt(EffectChoice("stribeck"))
    for doubts, sentence in (((doubt,), "1 question is open"), ((doubt, doubt), "2 questions are open")):
        shown = replace(found, examination=replace(examination, doubts=doubts))
        assert sentence in repr(shown)
        assert sentence in shown._repr_html_()


def test_a_robot_is_followed_over_days_and_one_more_day_is_added_to_those_before(
    desk: Path, model: dy.Model, runs: dy.Recordings
) -> None:
    today = dy.read_recordings(desk / "today.csv", robot=model.robot)
    both = dy.series(model, {"monday": runs["run1"], "tuesday": runs["run2"]})
    assert list(both) == []
    three = both.and_then([today])
    assert three.series.days == ("monday", "tuesday", "today")
    coulomb = next(one for one in three if one.change.choice.effect == "coulomb")
    assert (coulomb.change.choice.joints, coulomb.since) == (("elbow",), 2)
    low, high = coulomb.change.main.interval
    assert low <= 1.5 <= high
    once = dy.series(model, [runs[0], runs[1], today])
    for one, other in zip(once.series.courses, three.series.courses, strict=True):
        np.testing.assert_allclose(one.values, other.values)
    frame = three.to_frame()
    assert set(frame["day"]) == {"monday", "tuesday", "today"}
    assert "<svg" in three.plot().svg
    assert "today" in repr(three)


def test_days_without_recordings_are_refused(model: dy.Model, runs: dy.Recordings) -> None:
    with pytest.raises(dy.DynidentError, match="at least two days"):
        dy.series(model, [runs])
    with pytest.raises(dy.DynidentError, match="at least one recording") as refused:
        dy.series(model, {"monday": runs, "tuesday": runs[:0]})
    assert "tuesday" in refused.value.pointer


def test_what_is_no_change_of_the_catalogue_is_not_told_as_one_that_may_be_nothing(
    desk: Path, robot: dy.Robot, runs: dy.Recordings
) -> None:
    write_run(desk / "worn.csv", 4, stribeck=12.0)
    worn = dy.read_recordings(desk / "worn.csv", robot=robot)
    model = dy.identify(robot, runs[:1], validation=runs[1:], effects="default,stribeck@shoulder:vs=0.2")
    for change in dy.changes(model, before=runs, after=worn):
        low, high = change.main.interval
        assert low * high > 0


def test_the_torque_of_a_design_is_that_of_an_identified_model(robot: dy.Robot, model: dy.Model) -> None:
    quick = {"kind": "random", "duration": 3.0, "sampling_rate": 50.0}
    plain, known = dy.design(robot, **quick), dy.design(model, **quick)
    assert any("without rotor inertia and friction" in note for note in plain.design.notes)
    assert any("by the identified model" in note for note in known.design.notes)


def test_a_designed_motion_is_simulated_with_true_parameters_and_identified(robot: dy.Robot) -> None:
    motion = dy.design(robot, kind="random", duration=8.0, sampling_rate=100.0)
    assert motion.condition_number == motion.design.criterion_values.condition_number
    truth = {"Fc1": 7.0, "Fv2": 5.0, "M2": 4.0}
    quiet = Simulated(noise=Sensors(torque_noise=1e-4), seed=3)
    run = motion.simulate(truth, request=quiet, name="virtual")
    assert run.names == ("virtual",)
    model = dy.identify(robot, run)
    true = model.true_params(truth)
    assert (true["Fc1"], true["Fv2"]) == (7.0, 5.0)
    assert list(true) == list(model.params)
    errors = (np.asarray(model.params) - np.asarray(true)) / np.asarray(model.bse)
    assert float(np.sqrt(np.mean(errors**2))) < 2.0
    assert model.true_params()["Fc1"] != 7.0
    for parameters, words in (({"Fc9": 1.0}, "no standard parameter 'Fc9'"), ([3.0], "give true values by name")):
        with pytest.raises(dy.DynidentError, match=words):
            motion.simulate(parameters)


def test_true_parameters_are_those_of_the_same_shape_constants(robot: dy.Robot, runs: dy.Recordings) -> None:
    joint = robot.joint_names[0]
    orders, sizes = (3.0, 7.0), (1.0, 0.2)
    ripples = [dy.EffectChoice("torque_ripple", (joint,), {"k": order}) for order in orders]
    model = dy.identify(robot, runs, effects=["default", *ripples, f"stribeck@{joint}:vs=0.5,delta=2"])
    acting = [
        ActingEffect("torque_ripple", (joint,), {"Ac": size}, {"k": order})
        for order, size in zip(orders, sizes, strict=True)
    ]
    acting.append(ActingEffect("stribeck", (joint,), {"Fst": 8.0}, {"vs": 0.05, "delta": 2.0}))
    true = model.true_params(request=Simulated(effects=tuple(acting)))
    of_names = list(zip(true.labels, np.asarray(true), strict=True))
    assert [value for name, value in of_names if name == "Ac1"] == [1.0, 0.2]
    assert [value for name, value in of_names if name != "Fst1" and np.isnan(value)] == []
    assert np.isnan(true["Fst1"])


def test_empty_slices_are_shown_and_say_what_they_lack(model: dy.Model, runs: dy.Recordings) -> None:
    assert repr(model.ladder[:0]).startswith("Ladder(0)")
    for draw in (model.ladder[:0].plot, dy.compare(model, runs)[:0].plot):
        with pytest.raises(dy.DynidentError, match="nothing to draw"):
            draw()
    with pytest.raises(dy.DynidentError, match=r"no panel 1\.0"):
        model.plot().draw(Figure().subplots(), panel=1.0)


def test_every_panel_is_drawn_on_axes_of_ones_own(model: dy.Model, runs: dy.Recordings) -> None:
    axes = Figure().subplots()
    axes.plot([0.0, 1.0], [2.0, 3.0], label="my own")
    figure = dy.compare(model, runs[0]).plot("elbow")
    before = [line.get_xydata().copy() for line in figure.axes[1].lines]
    assert figure.draw(axes, 1) is axes
    for line, values in zip(axes.lines[1:], before, strict=True):
        np.testing.assert_array_equal(line.get_xydata(), values)
        assert line.axes is axes
    assert axes.get_title(loc="left") == figure.axes[1].get_title(loc="left")
    assert {"my own", "residual", "95 % band of the model"} <= set(axes.get_legend_handles_labels()[1])
    # The figure itself is as it was, and each of its panels can be rendered elsewhere, whatever is drawn in it.
    assert len(figure.axes[1].lines) == len(before)
    for drawn in (figure, model.plot(), runs[0].plot(), model.extend("offset").plot()):
        for panel, source in enumerate(drawn.axes):
            target = Figure()
            FigureCanvasAgg(target)
            drawn.draw(target.subplots(), panel)
            target.canvas.draw()
            (own,) = target.axes
            assert own.get_xlim() == source.get_xlim()
            kinds = ("lines", "patches", "collections", "images", "texts")
            assert [len(getattr(own, kind)) for kind in kinds] == [len(getattr(source, kind)) for kind in kinds]
    for slip, words in ((lambda: figure.draw("here"), "give matplotlib's"), (lambda: figure.draw(axes, 9), "0: elbow")):
        with pytest.raises(dy.DynidentError, match=words):
            slip()
