"""What is printed is short, what is shown is HTML, what is drawn is one SVG, and tables become frames."""

from __future__ import annotations

import sys
from html import escape
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest

import dynident as dy

SHORT, SCREEN = 500, 4000


@pytest.fixture(scope="module")
def shown(
    desk: Path,
    robot: dy.Robot,
    runs: dy.Recordings,
    model: dy.Model,
    found: dy.DiagnosedModel,
    better: dy.Model,
) -> dict[str, Any]:
    """Everything public, by what it is."""
    compared = dy.compare(better, runs)
    today = dy.read_recordings(desk / "today.csv", robot=robot)
    campaign = dy.Campaign(robot)
    campaign.tell(runs[:1])
    return {
        "campaign": campaign,
        "robot": robot,
        "recordings": runs,
        "recording": runs[0],
        "model": model,
        "extended model": better,
        "ladder": better.ladder,
        "parameters": better.parameters,
        "labelled values": better.params,
        "errors": better.errors,
        "diagnosis": found,
        "changes": dy.changes(better, before=runs, after=today),
        "comparisons": compared,
        "comparison": compared[0],
        "design": dy.design(robot, kind="random", duration=5.0, sampling_rate=50.0),
        "validations": dy.validate(better),
        "report": dy.report(better, diagnosis=found),
        "inspected file": dy.inspect(desk / "run1.csv", robot),
        "inspected file of an unknown robot": dy.inspect(desk / "run1.csv"),
        "verdict": better.verdict(),
        "series": dy.series(better, {"monday": runs, "tuesday": today}),
        "figure": runs[0].plot(),
    }


THINGS = (
    "campaign",
    "robot",
    "recordings",
    "recording",
    "model",
    "extended model",
    "ladder",
    "parameters",
    "labelled values",
    "errors",
    "diagnosis",
    "changes",
    "comparisons",
    "comparison",
    "design",
    "validations",
    "inspected file",
    "inspected file of an unknown robot",
    "verdict",
)
LARGE = ("report", "series", "figure")
"""What shows itself as a page, or as a drawing."""  # fmt: skip
DRAWN = ("recordings", "recording", "extended model", "ladder", "diagnosis", "changes", "comparisons", "comparison",
         "design", "model")  # fmt: skip


@pytest.mark.parametrize("what", THINGS)
def test_everything_prints_less_than_a_screen_and_shows_itself_as_html(what: str, shown: dict[str, Any]) -> None:
    text, html = repr(shown[what]), shown[what]._repr_html_()
    assert len(text) < SCREEN
    assert "array(" not in text
    assert "0x" not in text
    assert len(html) < 40_000
    ElementTree.fromstring(html)


@pytest.mark.parametrize("what", LARGE)
def test_pages_and_drawings_print_less_than_a_screen_too(what: str, shown: dict[str, Any]) -> None:
    text = repr(shown[what])
    assert len(text) < SCREEN
    assert "array(" not in text
    assert "0x" not in text
    assert shown[what]._repr_html_().startswith("<")


def test_no_class_that_the_front_door_gives_is_left_out(shown: dict[str, Any]) -> None:
    public = {name for name in dy.__all__ if name[0].isupper()}
    ours = {name for name in public if getattr(dy, name).__module__.startswith("dynident.api")}
    # One row of a table each: its table is what is shown.
    rows = {"JointError", "Validation"}
    assert ours - rows == ours & {type(one).__name__ for one in shown.values()}


def test_an_inspected_file_shows_what_is_proposed_and_what_is_asked(
    desk: Path, tmp_path: Path, robot: dy.Robot, shown: dict[str, Any]
) -> None:
    html = shown["inspected file"]._repr_html_()
    assert "<table" in html
    assert all(escape(one.reason) in html for one in shown["inspected file"].guesses)
    lines = (desk / "run1.csv").read_text(encoding="utf-8").replace("tau", "<b>").splitlines()
    without = "\n".join(line.rpartition(",")[0] for line in lines)
    (tmp_path / "asked.csv").write_text(without, encoding="utf-8")
    asked = dy.inspect(tmp_path / "asked.csv", robot)
    assert asked.questions
    assert "Questions to answer" in asked._repr_html_()
    assert "<b>" not in asked._repr_html_()
    assert "t, q1" in shown["inspected file of an unknown robot"]._repr_html_()


def test_a_verdict_shows_every_use_with_its_reason(better: dy.Model) -> None:
    verdict = better.verdict()
    for text in (repr(verdict), verdict._repr_html_()):
        assert verdict.summary in text
        assert all(f"{one.use.replace('_', ' ')}: " in text for one in verdict.uses)


def test_what_lies_below_prints_a_line(better: dy.Model, found: dy.DiagnosedModel, shown: dict[str, Any]) -> None:
    below = better.identification
    for thing in (
        shown["robot"].description,
        below,
        below.model,
        below.model.base,
        below.estimate,
        below.step,
        below.data,
        below.data.training,
        below.data.training.equations[0],
        below.in_memory,
        below.in_memory.training,
        found.diagnosis,
        found.evidence[0],
        shown["recording"].recording,
        shown["comparison"].comparison,
        shown["design"].design,
        better.fit,
    ):
        assert len(repr(thing)) < SHORT
        assert "array(" not in repr(thing)


def test_what_is_printed_says_what_matters(shown: dict[str, Any]) -> None:
    assert "Stribeck friction on shoulder" in repr(shown["diagnosis"])
    assert "held out 0." in repr(shown["extended model"])
    assert "run2: 4 joints, 2000 samples at 100 Hz, 20 s" in repr(shown["recordings"])
    assert "Fst1" in repr(shown["parameters"])
    assert "✓ best" in repr(shown["ladder"])
    assert "Coulomb friction" in repr(shown["changes"])
    assert "condition number" in repr(shown["design"])


def test_many_parameters_and_many_recordings_are_cut_short(shown: dict[str, Any]) -> None:
    many = dy.Parameters(shown["parameters"].items * 20)
    assert len(repr(many)) < SCREEN
    assert "… and 370 more" in repr(many)
    runs = dy.Recordings(shown["recordings"].items * 50)
    assert len(repr(runs)) < SCREEN
    assert "… and 92 more" in repr(runs)


def test_names_of_a_user_are_text_and_no_markup(shown: dict[str, Any]) -> None:
    from dataclasses import replace

    robot = replace(shown["robot"], name="<script>alert(1)</script>")
    assert "<script>" not in robot._repr_html_()


@pytest.mark.parametrize("what", DRAWN)
def test_a_figure_is_one_svg_on_white_for_the_notebook_and_for_a_file(
    what: str, shown: dict[str, Any], tmp_path: Path
) -> None:
    figure = shown[what].plot()
    assert figure._repr_html_().count("background:#fff") == 1
    figure.save(tmp_path / "figure.svg")
    root = ElementTree.parse(tmp_path / "figure.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 5
    assert len(repr(figure)) < 200


def test_figures_of_several_recordings_have_their_names_above_them(shown: dict[str, Any]) -> None:
    for what in ("recordings", "comparisons"):
        texts = [one.text for one in ElementTree.fromstring(shown[what].plot().svg).iter() if one.tag.endswith("text")]
        assert {"run1", "run2"} <= set(texts)


def test_chosen_joints_alone_are_drawn(shown: dict[str, Any]) -> None:
    drawn = shown["comparison"].plot(["elbow"]).svg
    assert "elbow, torque" in drawn
    assert "shoulder, torque" not in drawn
    with pytest.raises(dy.DynidentError, match=r"no joint 'wrist'\. The joints are: shoulder"):
        shown["comparison"].plot(["wrist"])


def test_units_in_a_drawn_recording_are_those_of_the_joint(shown: dict[str, Any]) -> None:
    drawn = shown["recording"].plot().svg
    assert "quill, position (m)" in drawn
    assert "elbow, torque (N m)" in drawn


def test_figures_go_to_svg_files_alone(shown: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(dy.DynidentError, match=r"figure\.jpg; the file name must end in \.svg"):
        shown["model"].plot().save(tmp_path / "figure.jpg")


def test_parameters_come_by_number_by_slice_and_by_name(better: dy.Model, model: dy.Model) -> None:
    assert better.parameters["Fst1"] is better.parameters[-1]
    assert [one.name for one in better.parameters[:2]] == ["ZZ1", "ZZ2"]
    assert "Fst1" in better.parameters
    assert "Fst1" not in model.parameters
    with pytest.raises(KeyError, match="no parameter 'Fst9'; did you mean 'Fst1'\\? There are: ZZ1"):
        better.parameters["Fst9"]


def test_windows_are_printed_with_the_recording(desk: Path, robot: dy.Robot) -> None:
    made = dy.read_recordings(desk / "run1.csv", robot=robot, windows=[(2, 9.5), (12, 18)])
    assert "used: 2 to 9.5 s, 12 to 18 s" in repr(made)
    assert "2 to 9.5 s, 12 to 18 s" in made._repr_html_()


def test_parameters_become_a_frame_of_pandas(better: dy.Model) -> None:
    pandas = pytest.importorskip("pandas")
    frame = better.parameters.to_frame()
    assert isinstance(frame, pandas.DataFrame)
    assert len(frame) == len(better.parameters)
    last = better.parameters["Fst1"]
    row = frame[frame.name == "Fst1"].iloc[0]
    assert (row.value, row.unit, row.joint, row.interval_low) == (last.value, "N m", "shoulder", last.interval[0])
    assert list(better.errors.to_frame("pandas").joint) == list(better.robot.joint_names)


class Frame:
    """Stands for a data frame of a library that need not be installed."""

    def __init__(self, columns: dict[str, list[object]]) -> None:
        self.columns = columns


def test_without_pandas_polars_is_taken(better: dy.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in = ModuleType("polars")
    stand_in.DataFrame = Frame  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "polars", stand_in)
    frame = better.parameters.to_frame()
    assert isinstance(frame, Frame)
    assert frame.columns["name"] == [one.name for one in better.parameters]
    assert isinstance(better.errors.to_frame("polars"), Frame)


def test_without_any_of_them_both_are_named(better: dy.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(
        dy.DynidentError, match=r"needs pandas or polars, which is not installed; .*dynident\[frames\].*to_table\(\)"
    ):
        better.parameters.to_frame()
    with pytest.raises(dy.DynidentError, match="needs polars, which is not installed"):
        better.parameters.to_frame("polars")
    with pytest.raises(dy.DynidentError, match="data frames of 'arrow' are not supported; choose pandas or polars"):
        better.parameters.to_frame("arrow")  # type: ignore[arg-type]


def test_errors_tell_each_joint_where_it_moves_and_on_all_rows(better: dy.Model) -> None:
    one = better.errors[0]
    assert one.joint == "shoulder"
    assert one.fit == better.fit.relative[0]
    assert one.held_out_moving == better.identification.held_out_moving.relative[0]  # type: ignore[union-attr]
    assert better.ladder[0].errors[0].fit > 10 * one.fit


def test_the_summary_is_a_few_sentences(better: dy.Model) -> None:
    assert "held out" in better.summary()
    assert "of 20 base parameters" in better.summary()
