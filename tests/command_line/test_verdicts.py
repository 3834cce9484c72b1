"""`dynident identify` ends with a verdict; what is grossly wrong has an exit code of its own and is not exported."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from support.running_commands import ROBOT, dynident, write_run

import dynident as dynident_package
from dynident.robot import urdf_from_robot
from dynident.verdict.fitness_by_use import _PRESLIDING, CURE, DIAGNOSE, GAINS
from dynident.verdict.model_verdict import _WHEN_GOOD


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


def test_every_command_that_a_verdict_names_is_there_with_its_options() -> None:
    rooms = sorted((Path(dynident_package.__file__).parent / "verdict").glob("*.py"))
    text = re.sub(r'"\s*\n\s*"', "", "".join(path.read_text(encoding="utf-8") for path in rooms))
    named = set(re.findall(r"dynident (identify|diagnose|validate|export|design|gains)\b([^.`\"]*)", text))
    assert {verb for verb, _ in named} == {"identify", "diagnose", "validate", "export", "design", "gains"}
    for verb, rest in named:
        explained = dynident(verb, "--help").out
        for option in re.findall(r"(?<!\S)--?[a-z]+", rest):
            assert option in explained, (verb, option)


def test_the_next_steps_of_a_verdict_run_as_they_are_printed(desk: Path, tmp_path: Path) -> None:
    model, loaded = tmp_path / "model.npz", write_run(tmp_path / "loaded.csv", 3)
    assert dynident("identify", desk / "arm.urdf", desk / "run1.csv", "-v", desk / "run2.csv", "-o", model).code == 0
    given = {
        "ROBOT": ["scara"],
        "MODEL": [str(model)],
        "RUN": [str(desk / "run1.csv")],
        "LOADED": [str(loaded)],
        "KG": ["2"],
        "…": [str(desk / "arm.urdf"), str(desk / "run1.csv")],
    }
    # What takes minutes, or needs a file to write to.
    also = {"design": ["--kind", "random", "--duration", "3", "--rate", "50"], "export": ["-o", str(tmp_path / "file")]}
    also["design"] += ["-o", str(tmp_path / "trajectory.csv")]
    steps = [DIAGNOSE, CURE, GAINS, _PRESLIDING, *_WHEN_GOOD.values(), "dynident design ROBOT."]
    # The observer of contacts is a class of the library.
    steps = [step for step in steps if "dynident.verdict.MomentumObserver" not in step]
    commands = [command for step in steps for command in re.findall(r"(dynident [a-z].*?)[.,](?:\s|$)", step)]
    assert len(commands) == len(steps)
    for command in commands:
        words = [part for word in shlex.split(command)[1:] for part in given.get(word, [word])]
        if words[0] == "validate" and "--mass" not in words:
            words += ["--unloaded", str(desk / "run1.csv"), "--mass", "2", str(loaded)]
        answer = dynident(*words, *also.get(words[0], []))
        # A validation may fail, and a model may have to be completed: that is about the data.
        assert answer.code in (0, 1), f"{command}\n{answer.err}"
