"""`dynident identify` ends with a verdict; what is grossly wrong has an exit code of its own and is not exported."""

from __future__ import annotations

import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import cast, get_args

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from rich.console import Console
from support.running_commands import ROBOT, dynident, write_run

from dynident.effects import DEFAULT_EFFECTS, EffectChoice
from dynident.effects.effect_text_format import parse_effects
from dynident.robot import urdf_from_robot
from dynident.verdict import Action, ModelVerdict, Use
from dynident.verdict.fitness_by_use import CURE, DIAGNOSE
from dynident_cli.printed_results import COMMANDS_OF_NEXT_STEPS, show_next_command, show_verdict
from dynident_cli.shared_options import Reading


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("verdicts")
    (folder / "arm.urdf").write_text(urdf_from_robot(ROBOT), encoding="utf-8")
    write_run(folder / "run1.csv", 1)
    table = pacsv.read_csv(write_run(folder / "run2.csv", 2))
    columns = {name: table[name].to_numpy() for name in table.column_names}
    pacsv.write_csv(pa.table(columns | {"tau1": columns["tau1"] * 10}), folder / "scaled.csv")
    return folder


def test_a_model_of_good_data_says_what_it_is_fit_for(desk: Path) -> None:
    answer = dynident("identify", desk / "arm.urdf", desk / "run1.csv", "-v", desk / "run2.csv")
    assert answer.code == 0
    assert "feed forward:" in answer.out
    assert "held-out error is" in answer.out


def test_an_error_above_the_stop_has_an_exit_code_of_its_own_and_no_export(desk: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.npz"
    accept = ["--accept", "torque_order", "--accept", "torque_sign"]
    answer = dynident(
        "identify", desk / "arm.urdf", desk / "run1.csv", "-v", desk / "scaled.csv", "-o", model, "--json", *accept
    )
    assert answer.code == 3, answer.err
    told = answer.document["verdict"]
    assert ROBOT.joint_names[0] in told["stop"]["cause"]
    assert not any(one["fit"] for one in told["uses"])
    refused = dynident("export", model, "-f", "json", "-o", tmp_path / "model.json")
    assert refused.code == 2
    assert "--anyway" in refused.err
    assert not (tmp_path / "model.json").exists()
    assert dynident("export", model, "-f", "json", "-o", tmp_path / "model.json", "--anyway").code == 0


def test_the_same_file_held_out_is_a_stop(desk: Path) -> None:
    answer = dynident("identify", desk / "arm.urdf", desk / "run1.csv", "-v", desk / "run1.csv")
    assert answer.code == 3
    assert "same samples" in " ".join(answer.out.split())


def test_a_model_that_was_tried_on_its_own_samples_is_not_exported(desk: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.npz"
    dynident("identify", desk / "arm.urdf", desk / "run1.csv", "-v", desk / "run1.csv", "-o", model)
    refused = dynident("export", model, "-f", "json", "-o", tmp_path / "model.json")
    assert refused.code == 2
    assert "samples of the fit" in " ".join(refused.err.split())
    assert dynident("export", model, "-f", "json", "-o", tmp_path / "model.json", "--anyway").code == 0


def test_an_extended_model_ends_with_a_verdict_too(desk: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.npz"
    held_out = ("-v", desk / "run2.csv")
    dynident("identify", desk / "arm.urdf", desk / "run1.csv", *held_out, "-o", model)
    more = ("extend", model, desk / "run1.csv", *held_out, "--effects", "offset", "-o", tmp_path / "more.npz")
    told = dynident(*more)
    assert told.code == 0, told.err
    assert "feed forward:" in told.out
    uses = dynident(*more, "--json").document["verdict"]["uses"]
    assert {one["state"] for one in uses} <= {"yes", "limited", "no", "not_judged"}
    assert all(one["next_step"] for one in uses)


def test_no_diagnosis_is_proposed_before_a_check_is_heeded(desk: Path, tmp_path: Path) -> None:
    for name in ("run1", "run2"):
        table = pacsv.read_csv(desk / f"{name}.csv")
        columns = {column: table[column].to_numpy() for column in table.column_names}
        late = {column: np.roll(values, 3) for column, values in columns.items() if column.startswith("tau")}
        pacsv.write_csv(pa.table(columns | late).slice(3), tmp_path / f"{name}.csv")
    for folder, proposed in ((desk, True), (tmp_path, False)):
        files = (folder / "run1.csv", "-v", folder / "run2.csv")
        answer = dynident("identify", desk / "arm.urdf", *files, "-o", tmp_path / "model.npz")
        assert answer.code == 0, answer.err
        assert ("Next, find what is missing" in answer.out, "First correct" in answer.out) == (proposed, not proposed)
        named = dynident("diagnose", tmp_path / "model.npz", *files)
        assert named.out.startswith("First correct what the check torque delay of run1 names") == (not proposed)


def test_the_next_steps_of_a_verdict_run_as_they_are_printed(desk: Path, tmp_path: Path) -> None:
    model, loaded = tmp_path / "model.npz", write_run(tmp_path / "loaded.csv", 3)
    assert dynident("identify", desk / "arm.urdf", desk / "run1.csv", "-v", desk / "run2.csv", "-o", model).code == 0
    given = {
        "ROBOT": ["scara"],
        "MODEL": [str(model)],
        "RUN": [str(desk / "run1.csv")],
        "LOADED": [str(loaded)],
        "KG": ["2"],
        "EFFECTS": ["default,offset"],
        "…": [str(desk / "arm.urdf"), str(desk / "run1.csv")],
    }
    # What takes minutes, or needs a file to write to.
    also = {"design": ["--kind", "random", "--duration", "3", "--rate", "50"], "export": ["-o", str(tmp_path / "file")]}
    also["design"] += ["-o", str(tmp_path / "trajectory.csv")]
    commands = [command for text in COMMANDS_OF_NEXT_STEPS.values() for command in text.split(", or ")]
    commands = [
        command if command.startswith("dynident ") else f"dynident export MODEL {command}" for command in commands
    ]
    # The gains of motors cannot be told from recordings of torques: that its options are there is enough.
    commands.remove("dynident gains")
    assert "--help" in dynident("gains", "--help").out
    assert set(COMMANDS_OF_NEXT_STEPS) == set(get_args(Action))
    for command in commands:
        words = [part for word in shlex.split(command)[1:] for part in given.get(word, [word])]
        if "payload" in words and "--mass" not in words:
            words += ["--mass", "2"]
        answer = dynident(*words, *also.get(words[0], []))
        # A validation may fail, and a model may have to be completed: that is about the data.
        assert answer.code in (0, 1), f"{command}\n{answer.err}"


def test_the_command_for_bodies_that_can_exist_keeps_the_effects_of_the_model(
    capsys: pytest.CaptureFixture[str],
) -> None:
    effects = (*DEFAULT_EFFECTS, EffectChoice("torque_ripple", ("joint4",), (("k", 20.0),)))
    verdict = SimpleNamespace(stop=None, uses=[Use("simulation", "no", "No.", CURE)], next_steps=(), drift=None)
    show_verdict(Console(width=300), cast("ModelVerdict", verdict), effects)
    (command,) = (line.partition(": ")[2] for line in capsys.readouterr().out.splitlines() if "dynident" in line)
    words = shlex.split(command)
    assert parse_effects([words[words.index("--effects") + 1]]) == effects
    assert words[-2:] == ["--estimator", "feasible"]


def test_a_next_command_names_no_option_of_files_that_it_leaves_out(capsys: pytest.CaptureFixture[str]) -> None:
    def show(files: list[str], **options: list[str]) -> str:
        paths = [Path(name) for name in files]
        show_next_command(Console(width=300), "look", ["compare", "m.npz"], paths, Reading(**options))
        return capsys.readouterr().out

    told = show(["a run.csv"], metadata=["a run=one.json", "other=two.json", "all.json"], windows=["a run=0:4"])
    words = shlex.split(told.partition(": ")[2])
    assert [word for word in words if "json" in word] == ["a run=one.json", "all.json"]
    assert "a run=0:4" in words
    # Two files of one name are told apart by numbers, which would be others in the next command.
    assert show(["day1/run.csv", "day2/run.csv"], windows=["run=0:4"]) == ""
    assert "compare" in show(["day1/run.csv", "day2/run.csv"], windows=["0:4"])


def test_what_several_uses_lack_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    uses = [Use("simulation", "no", "It drifts.", DIAGNOSE)]
    uses += [Use(name, "no", "Its error is large.", DIAGNOSE) for name in ("collision_detection", "payload")]
    verdict = SimpleNamespace(stop=None, uses=uses, next_steps=(), drift=None)
    show_verdict(Console(width=100), cast("ModelVerdict", verdict), ())
    told = capsys.readouterr().out
    assert "✕ collision detection, payload: Its error is large." in told
    assert told.count("dynident diagnose") == 2
