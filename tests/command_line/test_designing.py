"""`dynident design`: kinds, families and sets as options."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import pytest
from support.running_commands import dynident
from support.standing_robots import HOME, SOLE, SQUATTER, STANDER

from dynident.excitation import Design, DesignRequest, design_experiment
from dynident.progress import Progress, ignore_progress
from dynident.robot import Robot, robot_from_library, urdf_from_robot
from dynident_cli import design_and_simulation_files

QUICK = ("--duration", 3, "--harmonics", 3, "--rate", 50, "--time-budget", 1)


@pytest.mark.parametrize(
    "options",
    [
        ("--family", "b_spline", "--intervals", 5),
        ("--family", "point_to_point", "--points", 5),
        ("--kind", "sequential", "--sets", "link_by_link"),
        ("--joint", "elbow", "--joint", "tool_roll"),
    ],
)
def test_every_way_to_move_gives_a_trajectory(tmp_path: Path, options: tuple[object, ...]) -> None:
    answer = dynident("design", "scara", *QUICK, *options, "-o", tmp_path / "t.csv", "--json")
    assert answer.code == 0, answer.err
    with (tmp_path / "t.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == answer.document["n_samples"]
    assert ("segment" in rows[0]) == ("--sets" in options)
    moved = {
        name for name in ("shoulder", "elbow", "quill", "tool_roll") if len({row[f"q_{name}"] for row in rows}) > 1
    }
    assert moved == ({"elbow", "tool_roll"} if "--joint" in options else {"shoulder", "elbow", "quill", "tool_roll"})


def test_the_same_motion_is_written_slowly_for_a_first_run(tmp_path: Path) -> None:
    files = ("-o", tmp_path / "t.csv", "--slow", tmp_path / "slow.csv")
    assert dynident("design", "scara", "--kind", "random", *QUICK, *files).code == 0
    fast, slow = (list(csv.DictReader((tmp_path / name).open())) for name in ("t.csv", "slow.csv"))
    assert [row["q_elbow"] for row in slow] == [row["q_elbow"] for row in fast]
    assert float(slow[-1]["t"]) == pytest.approx(3 * float(fast[-1]["t"]))
    for slow_name, reason in (("slow.txt", ".csv"), ("t.csv", "the same file")):
        refused = dynident("design", "scara", *QUICK, "-o", tmp_path / "t.csv", "--slow", tmp_path / slow_name)
        assert refused.code == 2
        assert reason in refused.err


def test_feet_that_stand_are_options(tmp_path: Path) -> None:
    (tmp_path / "stander.urdf").write_text(STANDER)
    points = ";".join(f"{foot}_foot@{','.join(map(str, point))}" for foot in ("left", "right") for point in SOLE)
    home = ("--home", ",".join(map(str, HOME)))
    for feet in ("left_foot,right_foot", points):
        stand = ("--feet", feet, "--balance-margin", 0.01, "--foot-friction", 0.4, *home)
        files = ("-o", tmp_path / "t.csv", "--json")
        answer = dynident("design", tmp_path / "stander.urdf", "--kind", "random", *QUICK, *stand, *files)
        assert answer.code == 0, answer.err
        margins = {margin["limit"]: margin for margin in answer.document["margins"]}
        assert margins["balance"]["value"] >= margins["balance"]["bound"] == 0.01
        assert margins["friction"]["bound"] == 0.4
    falls = ("--feet", "left_foot,right_foot", "--home", "-0.35,0,-0.35,0,0", "-o", tmp_path / "t.csv")
    refused = dynident("design", tmp_path / "stander.urdf", *QUICK, *falls)
    assert refused.code == 2
    assert "outside of the support" in refused.err


def test_a_trunk_that_sways_is_an_option(tmp_path: Path) -> None:
    (tmp_path / "squatter.urdf").write_text(SQUATTER)
    leg = (0.0, 0.0, -0.4, 0.8, -0.4, 0.0)
    stand = ("--feet", "left_foot,right_foot", "--sway", 0.04, 0.1, f"--home={','.join(map(str, (*leg, *leg, 0, 0)))}")
    files = ("-o", tmp_path / "t.csv", "--json")
    answer = dynident("design", tmp_path / "squatter.urdf", "--kind", "random", *QUICK, *stand, *files)
    assert answer.code == 0, answer.err
    turn = next(row for row in answer.document["margins"] if row["joint"] == "base_yaw")
    assert turn["bound"] in (-0.1, 0.1)
    with (tmp_path / "t.csv").open() as file:
        knee = [float(row["q_left_shank_joint"]) for row in csv.DictReader(file)]
    assert max(knee) - min(knee) > 0.01


def test_an_unknown_set_or_family_is_refused_with_those_there_are(tmp_path: Path) -> None:
    for option, value, known in (("--family", "spiral", "b_spline"), ("--sets", "ballet", "vandanjon")):
        answer = dynident("design", "scara", "--kind", "sequential", option, value, "-o", tmp_path / "t.csv")
        assert answer.code != 0
        assert known in answer.err


def test_an_earlier_measurement_of_currents_counts_once_its_drive_gains_are_given(tmp_path: Path) -> None:
    run = tmp_path / "run.csv"
    assert dynident("simulate", "scara", "--rate", 100, "--out", run).code == 0
    run.write_text(run.read_text().replace("tau", "current"))
    asked = ("design", "scara", *QUICK, "--earlier", run, "-o", tmp_path / "t.csv")
    refused = dynident(*asked)
    assert refused.code == 2
    assert "--drive-gains" in refused.err
    assert dynident(*asked, "--drive-gains", "1,1,1,1").code == 0


def test_a_folder_of_meshes_that_is_not_there_is_refused(tmp_path: Path) -> None:
    answer = dynident("design", "scara", *QUICK, "--meshes", tmp_path / "nowhere", "-o", tmp_path / "t.csv")
    assert answer.code == 2
    assert "there is no folder" in answer.err


def test_a_mesh_that_is_not_found_is_warned_of_in_plain_sight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = urdf_from_robot(robot_from_library("scara"))
    path = f"package://scara/{'a_long_folder/' * 8}quill.stl"
    mesh = f'<collision><geometry><mesh filename="{path}"/></geometry></collision></link>'
    monkeypatch.setenv("COLUMNS", "80")
    (tmp_path / "arm.urdf").write_text(text.replace("</link>", mesh, 1))
    answer = dynident("design", tmp_path / "arm.urdf", *QUICK, "-o", tmp_path / "t.csv", "--json")
    assert answer.code == 0, answer.err
    assert "warning: COLLISION IS NOT CHECKED" in answer.err
    # No path is broken, though it is longer than a line.
    assert path in answer.err
    notes = answer.document["notes"]
    assert (
        "Self-collision is not checked: the robot's description has no collision geometry that could be read." in notes
    )
    assert "Give the meshes: --meshes FOLDER." in " ".join(answer.err.split())


def test_meshes_are_found_in_the_folders_above_the_file_and_a_floor_can_be_left_out(tmp_path: Path) -> None:
    folder = tmp_path / "scara" / "urdf"
    folder.mkdir(parents=True)
    (tmp_path / "scara" / "meshes").mkdir()
    (tmp_path / "scara" / "meshes" / "quill.stl").write_text(
        "solid\n"
        + "".join(
            f"facet normal 0 0 1\nouter loop\n{a}{b}{c}endloop\nendfacet\n"
            for a, b, c in [
                ["vertex 0 0 0\n", "vertex .1 0 0\n", "vertex 0 .1 0\n"],
                ["vertex 0 0 0\n", "vertex 0 .1 0\n", "vertex 0 0 .1\n"],
                ["vertex 0 0 0\n", "vertex 0 0 .1\n", "vertex .1 0 0\n"],
            ]
        )
        + "endsolid\n"
    )
    text = urdf_from_robot(robot_from_library("scara"))
    mesh = '<collision><geometry><mesh filename="package://scara/meshes/quill.stl"/></geometry></collision></link>'
    (folder / "arm.urdf").write_text(text.replace("</link>", mesh, 1))
    answer = dynident("design", folder / "arm.urdf", *QUICK, "-o", tmp_path / "t.csv")
    assert answer.code == 0, answer.err
    assert "COLLISION IS NOT CHECKED" not in answer.err
    assert "warning: NOTHING BUT A FLOOR THROUGH THE BASE IS CHECKED" in " ".join(answer.err.split())
    told = " ".join(answer.out.split())
    assert "that there is no floor: --no-floor." in told
    assert "assume_floor" not in told
    answer = dynident("design", folder / "arm.urdf", *QUICK, "--no-floor", "-o", tmp_path / "t.csv")
    assert "warning: NOTHING AROUND THE ROBOT IS CHECKED" in " ".join(answer.err.split())


def test_an_identified_model_predicts_the_torque_for_the_limits(tmp_path: Path) -> None:
    run, model = tmp_path / "run.csv", tmp_path / "model.npz"
    assert dynident("simulate", "scara", "--rate", 100, "--out", run).code == 0
    assert dynident("identify", "scara", run, "--out", model).code == 0
    asked = ("design", "scara", "--kind", "random", *QUICK, "-o", tmp_path / "t.csv", "--json")
    told = {known: dynident(*asked, *options) for known, options in ((False, ()), (True, ("--identified", model)))}
    assert all(answer.code == 0 for answer in told.values()), told
    torque = {
        known: [m["value"] for m in answer.document["margins"] if m["limit"] == "torque"]
        for known, answer in told.items()
    }
    assert torque[True] != torque[False]
    assert any("without rotor inertia and friction" in note for note in told[False].document["notes"])
    assert any("by the identified model" in note for note in told[True].document["notes"])
    refused = dynident("design", "ur10", *QUICK, "--identified", model, "-o", tmp_path / "t.csv")
    assert refused.code == 2
    assert "the model is of a robot with the joints" in refused.err


def test_the_values_of_a_simulated_effect_are_told_as_the_option_takes_them(tmp_path: Path) -> None:
    stated = ("--rate", 100, "--out", tmp_path / "run.csv")
    told = dynident("simulate", "scara", "--effects", "stribeck@elbow", *stated)
    assert told.code == 0, told.err
    (line,) = re.findall(r"in it: (stribeck@elbow:\S+)", told.out)
    again = dynident("simulate", "scara", "--effects", line, *stated)
    assert line in again.out


@pytest.mark.parametrize(("name", "most"), [("scara", 100), ("dual_arm", 60)])
def test_a_simulation_draws_fewer_motions_of_many_joints(monkeypatch: pytest.MonkeyPatch, name: str, most: int) -> None:
    requests: list[DesignRequest] = []

    def design(robot: Robot, request: DesignRequest, progress: Progress) -> Design:
        requests.append(request)
        return design_experiment(robot, replace(request, random_trajectories=1), progress)

    monkeypatch.setattr(design_and_simulation_files, "design_experiment", design)
    robot = robot_from_library(name)
    assert design_and_simulation_files.load_reference(None, robot, 1, ignore_progress).duration > 5.0
    # A hundred motions of a humanoid take seconds, and nothing is compared with them here.
    assert 0 < requests[0].random_trajectories <= most


def test_a_random_motion_is_not_compared_with_itself(tmp_path: Path) -> None:
    answer = dynident("design", "scara", "--kind", "random", "--seed", 1, "-o", tmp_path / "t.csv")
    assert answer.code == 0, answer.err
    said = " ".join(answer.out.split())
    assert "this motion, the best of 100 random motions" in said
    assert re.search(r"Scaled condition number [\d.]+, the best of 100 random motions, whose median is [\d ]+", said)
    assert said.count("best of 100 random motions") == 2
