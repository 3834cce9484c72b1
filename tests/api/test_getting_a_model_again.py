"""A report says how to get its model again: the files by their hashes, and commands that make the same one."""

from __future__ import annotations

import hashlib
import re
import shlex
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from support.page_commands import run_commands

import dynident as dy
from dynident.effects import EffectChoice
from dynident.effects.effect_text_format import format_effect, parse_effects
from dynident.identification import IdentificationChoices, extend, identify
from dynident.recordings import Preprocessing
from dynident.reports.sections.provenance import ROBOT, build_commands


def run_again(lines: tuple[str, ...] | list[str], desk: Path, folder: Path) -> list[dy.Model]:
    """The models that the commands make, with the files that their names stand for."""
    files = {ROBOT: str(desk / "arm.urdf"), **{name: str(desk / f"{name}.csv") for name in ("run1", "run2")}}
    for line in lines:
        run_commands(folder, shlex.join(files.get(word, word) for word in shlex.split(line)))
    return [dy.load_model(folder / f"model{number}.npz") for number, _ in enumerate(lines, 1)]


@pytest.mark.slow
def test_the_commands_of_a_report_make_its_ladder_again(desk: Path, better: dy.Model, tmp_path: Path) -> None:
    shorter = better.remove(better.effects[-1].effect)
    page = dy.report(shorter).html
    lines = [unescape(one) for one in re.findall(r"<li><code>(dynident .+?)</code></li>", page)]
    assert [shlex.split(line)[1] for line in lines] == ["identify", "extend", "remove"]
    for model, again in zip(shorter.identification.ladder(), run_again(lines, desk, tmp_path), strict=True):
        np.testing.assert_allclose(again.identification.values, model.values, rtol=1e-6, atol=1e-9)
        assert again.held_out.relative_total == pytest.approx(model.held_out.relative_total, rel=1e-6)


@pytest.mark.slow
def test_other_choices_are_among_the_commands(desk: Path, runs: dy.Recordings, robot: dy.Robot, tmp_path: Path) -> None:
    choices = IdentificationChoices(
        (*parse_effects(["default"]), EffectChoice("stribeck", ("elbow",), (("delta", 1.0), ("vs", 0.0987654321)))),
        strategy="sequential",
        steps="wrist_then_shoulder",
        estimator="ols",
        preprocessing=Preprocessing(7.5, None, 2),
    )
    found = identify(robot, [runs["run1"].recording], [], choices)
    (again,) = run_again(build_commands(found), desk, tmp_path)
    np.testing.assert_allclose(again.identification.values, found.values, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_gains_locked_joints_and_gravity_are_among_the_commands(desk: Path, tmp_path: Path) -> None:
    gains = {"shoulder": 14.9, "elbow": 13.3, "quill": 101.0}
    options = ["--gravity", "0,0,9.81", "--lock", "tool_roll=0.3"]
    drive_gains = ",".join(f"{joint}={gain}" for joint, gain in gains.items())
    simulate = ["dynident", "simulate", str(desk / "arm.urdf"), *options, "--drive-gains", drive_gains, "--current"]
    run_commands(tmp_path, shlex.join([*simulate, "--rate", "100", "-o", "hung.csv"]))
    robot = dy.load_robot(
        desk / "arm.urdf", gravity=(0.0, 0.0, 9.81), locked_joints={"tool_roll": 0.3}, drive_gains=gains
    )
    model = dy.identify(robot, dy.read_recordings(tmp_path / "hung.csv", robot=robot))
    (line,) = build_commands(model.identification, [model.recordings[0].recording])
    assert {"--gravity", "--lock", "--drive-gains"} <= set(shlex.split(line))
    (again,) = run_again([line.replace("hung", str(tmp_path / "hung.csv"), 1)], desk, tmp_path)
    np.testing.assert_allclose(again.identification.values, model.identification.values, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_the_windows_that_were_used_are_among_the_commands(
    desk: Path, runs: dy.Recordings, robot: dy.Robot, tmp_path: Path
) -> None:
    used = {"run1": ((0.5, 2.25), (3.0, 7.125)), "run2": ((1.0, 6.0),)}
    fit, tried = (runs[name].recording.with_windows(windows) for name, windows in used.items())
    found = identify(robot, [fit], [tried])
    (again,) = run_again(build_commands(found, [fit, tried]), desk, tmp_path)
    np.testing.assert_allclose(again.identification.values, found.values, rtol=1e-6, atol=1e-9)
    assert again.held_out.relative_total == pytest.approx(found.held_out.relative_total, rel=1e-6)


@pytest.mark.slow
def test_files_with_other_columns_and_units_are_read_again_by_what_the_report_says(
    desk: Path, robot: dy.Robot, tmp_path: Path
) -> None:
    lines = (desk / "run1.csv").read_text().splitlines()
    ours = lines[0].replace('"', "").split(",")
    place = next(index for index, name in enumerate(ours) if name.startswith("q"))
    theirs = ["stamp" if name == "t" else f"axis {name}" for name in ours]
    rows = [[float(value) for value in line.split(",")] for line in lines[1:]]
    for row in rows:
        row[place] = float(np.rad2deg(row[place]))
    text = "\n".join([",".join(theirs), *(",".join(map(repr, row)) for row in rows)])
    (tmp_path / "foreign.csv").write_text(text + "\n")
    columns = dict(zip(ours, theirs, strict=True))
    runs = dy.read_recordings(tmp_path / "foreign.csv", robot=robot, columns=columns, units={ours[place]: "deg"})
    assert_made_again(dy.identify(robot, runs), {"foreign": "foreign.csv"}, desk, tmp_path)


@pytest.mark.slow
def test_another_order_signs_factors_a_delay_and_what_was_left_out_are_among_what_the_report_says(
    desk: Path, robot: dy.Robot, tmp_path: Path
) -> None:
    lines = (desk / "run1.csv").read_text().splitlines()
    names = lines[0].replace('"', "").split(",")
    values = dict(zip(names, np.loadtxt(lines[1:], delimiter=",").T, strict=True))
    swapped = {**values, "tau1": -10.0 * values["tau2"], "tau2": values["tau1"]}
    np.savetxt(
        tmp_path / "wired.csv",
        np.column_stack(list(swapped.values())),
        delimiter=",",
        header=",".join(names),
        comments="",
    )
    doubtful = dy.RecordingMetadata(accept=("torque_sign", "torque_order", "torque_scale"))
    (raw,) = dy.read_recordings(tmp_path / "wired.csv", robot=robot, metadata=doubtful)
    order = (2, 1, *range(3, robot.n + 1))
    said = dy.Revision(
        permutation={"tau": order}, signs={"tau2": -1.0}, scale={"tau2": 0.1}, torque_delay=0.001, exclude=((4.0, 6.5),)
    )
    model = dy.identify(robot, dy.revise(raw, said, name="wired"))
    assert model.fit.relative_total == pytest.approx(0.1, abs=0.1), "the torques are where they belong"
    assert_made_again(model, {"wired": "wired.csv"}, desk, tmp_path)


def assert_made_again(model: dy.Model, files: dict[str, str], desk: Path, folder: Path) -> None:
    """The command of a model's report makes it from the files that stand in the folder and those that it says."""
    page = dy.report(model).html
    (line,) = (unescape(one) for one in re.findall(r"<li><code>(dynident .+?)</code></li>", page))
    for name, content in re.findall(r"<dt>(\S+\.json)</dt><dd><code>(.+?)</code></dd>", page):
        (folder / name).write_text(unescape(content))
    words = ({ROBOT: str(desk / "arm.urdf"), **files}.get(word, word) for word in shlex.split(line))
    run_commands(folder, shlex.join(words))
    again = dy.load_model(folder / "model1.npz")
    np.testing.assert_allclose(again.identification.values, model.identification.values, rtol=1e-6, atol=1e-9)


def test_what_only_one_run_has_is_said_behind_its_command_and_not_put_into_all(
    runs: dy.Recordings, robot: dy.Robot
) -> None:
    recordings = [runs[name].recording for name in ("run1", "run2")]
    loaded = EffectChoice("payload", ("elbow",), (), ("run2",))
    first, second = build_commands(extend(identify(robot, recordings), [loaded], recordings))
    assert "#" not in first
    command, remark = second.split("#")
    assert "payload in run2 alone" in remark
    assert shlex.split(command)[1] == "extend"


def test_the_report_has_the_hashes_of_the_files(desk: Path, model: dy.Model) -> None:
    page = dy.report(model).html
    for name in ("run1", "run2"):
        assert hashlib.sha256((desk / f"{name}.csv").read_bytes()).hexdigest() in page


@pytest.mark.parametrize("text", ["offset", "presliding@a+b:d0=0.001,law=dahl", "stribeck@a:delta=1,vs=0.05"])
def test_an_effect_is_written_as_it_is_read(text: str) -> None:
    assert format_effect(parse_effects([text])[0]) == text


@pytest.mark.slow
def test_gains_gravity_and_flags_that_are_switched_off_are_among_what_the_report_says(
    desk: Path, robot: dy.Robot, tmp_path: Path
) -> None:
    lines = (desk / "run1.csv").read_text().splitlines()
    names = [name.replace("tau", "current") for name in lines[0].replace('"', "").split(",")]
    values = np.loadtxt(lines[1:], delimiter=",")
    gains = {name: 2.5 + index for index, name in enumerate(robot.joint_names)}
    for index in range(robot.n):
        values[:, names.index(f"current{index + 1}")] /= 2.5 + index
    np.savetxt(tmp_path / "currents.csv", values, delimiter=",", header=",".join(names), comments="")
    driven = dy.load_robot(desk / "arm.urdf", drive_gains=gains, gravity=(0.0, 0.02, -9.81))
    runs = dy.read_recordings(
        tmp_path / "currents.csv", robot=driven, metadata=dy.RecordingMetadata(skip=("idle_drives",))
    )
    choices = dy.IdentificationChoices(weigh_turns=False)
    assert_made_again(dy.identify(driven, runs, choices=choices), {"currents": "currents.csv"}, desk, tmp_path)


@pytest.mark.slow
def test_locked_joints_and_windows_of_names_with_spaces_are_among_what_the_report_says(
    desk: Path, robot: dy.Robot, tmp_path: Path
) -> None:
    lines = (desk / "run1.csv").read_text().replace('"', "").splitlines()
    (tmp_path / "first run.csv").write_text("\n".join(lines) + "\n")
    last = robot.joint_names[-1]
    locked = dy.load_robot(desk / "arm.urdf", locked_joints={last: 0.25})
    runs = dy.read_recordings(tmp_path / "first run.csv", robot=locked, windows=[(0.5, 6.0), (7.0, 9.5)])
    model = dy.identify(locked, runs, effects=["default"])
    (line,) = (unescape(one) for one in re.findall(r"<li><code>(dynident .+?)</code></li>", dy.report(model).html))
    words = shlex.split(line)
    assert f"{last}=0.25" in words
    assert "first run=0.5:6.0,first run=7.0:9.5" in words
    assert_made_again(model, {"first run": "first run.csv"}, desk, tmp_path)
