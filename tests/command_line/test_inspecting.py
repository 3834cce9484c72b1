"""From a file that calls things otherwise to a model, by command line."""

from __future__ import annotations

import json
import re
import shlex
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from support.running_commands import dynident, write_run

from dynident.api.proposed_metadata import StatedAnswers, accept_proposal, describe_answer, describe_columns
from dynident.api.recording_files import read_recordings
from dynident.api.robot_files import load_robot
from dynident.errors import DynidentError, Remedy
from dynident.identification.column_inference import Inspection, Proposal, Question, inspect_file
from dynident.recordings import RecordingMetadata
from dynident.robot import urdf_from_robot
from dynident_cli.request_options import write_option


@pytest.fixture
def foreign(tmp_path):
    """Two runs of the small arm with other names, in degrees and ms."""
    paths = []
    for seed in (1, 2):
        table = pacsv.read_csv(write_run(tmp_path / f"run{seed}.csv", seed))
        columns = {"Time (ms)": table["t"].to_numpy() * 1e3}
        for j in range(1, sum(name.startswith("q") for name in table.column_names) + 1):
            sliding = j == 3  # of the SCARA
            columns[f"act_pos_{j}"] = table[f"q{j}"].to_numpy() * (1.0 if sliding else 180 / np.pi)
            columns[f"act_trq_{j}"] = table[f"tau{j}"].to_numpy()
        path = tmp_path / f"foreign{seed}.csv"
        np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
        paths.append(path)
    return paths


def test_a_foreign_file_is_identified_as_proposed(foreign, tmp_path):
    fit, other = foreign
    looked = dynident("inspect", fit, "--robot", "scara")
    assert looked.code == 0, looked.err
    assert "act_pos_1" in looked.out
    assert "?" not in looked.out.replace("why", "")
    known = dynident("identify", "scara", tmp_path / "run1.csv", "-v", tmp_path / "run2.csv", "--json").document
    found = dynident("identify", "scara", fit, "-v", other, "--as-proposed", "--json").document
    for kind in ("residual", "validation"):
        assert found[kind]["relative_total"] == pytest.approx(known[kind]["relative_total"], rel=0.02)


def test_a_foreign_file_needs_no_option_where_nothing_is_open(foreign, tmp_path):
    fit, other = foreign
    model = tmp_path / "model.npz"
    made = dynident("identify", "scara", fit, "-v", other, "-o", model)
    assert made.code == 0, made.err
    # Both files have the same columns, which are told once.
    assert made.err.count("Columns of foreign1, foreign2 as proposed: t: Time (ms) (ms); q: act_pos_1 …") == 1
    # The next command reads the files as this one did.
    (following,) = (line for line in made.out.splitlines() if line.startswith("Next"))
    answer = dynident(*shlex.split(following.partition("dynident ")[2]), "--max-effects", "1")
    assert answer.code == 0, answer.err
    refused = dynident("identify", "scara", fit, "--no-as-proposed")
    assert refused.code != 0
    assert "Unknown columns" in refused.err
    assert "--as-proposed" in refused.err


def test_joints_that_are_counted_from_zero_need_no_option(tmp_path):
    """Columns of the usual names are there, but they are those of other joints."""
    table = pacsv.read_csv(write_run(tmp_path / "run1.csv", 1))
    names = [f"{name[:-1]}{int(name[-1]) - 1}" if name[-1].isdigit() else name for name in table.column_names]
    pacsv.write_csv(table.rename_columns(names), tmp_path / "zero.csv")
    known = dynident("identify", "scara", tmp_path / "run1.csv", "--json").document
    found = dynident("identify", "scara", tmp_path / "zero.csv", "--json").document
    assert found["residual"] == known["residual"]


def test_many_files_of_one_recording_may_have_more_letters_than_the_name_of_a_file(tmp_path):
    names = [f"{kind}_of_the_joint_number_{joint}_of_the_scara.txt" for kind in ("q", "tau") for joint in range(1, 5)]
    assert len("+".join(names)) > 255
    assert "No such file" in dynident("inspect", tmp_path / "+".join(names), "--robot", "scara").err


@pytest.fixture
def efforts(foreign, tmp_path):
    """A run whose numbers called effort are 1/37 of the torque."""
    table = pacsv.read_csv(foreign[0])
    columns = {name.replace("act_trq_", "Effort"): table[name].to_numpy() for name in table.column_names}
    path = tmp_path / "efforts.csv"
    pacsv.write_csv(pa.table({k: v / 37.0 if k.startswith("Effort") else v for k, v in columns.items()}), path)
    return path


def test_drive_gains_answer_what_numbers_of_unknown_kind_are(foreign, efforts):
    """They are per unit of the numbers, whatever these are called."""
    refused = dynident("identify", "scara", efforts)
    assert "Open questions" in refused.err
    found = dynident("identify", "scara", efforts, "--drive-gains", "37,37,37,37", "--json").document
    known = dynident("identify", "scara", foreign[0], "--json").document
    for one, other in zip(found["parameters"], known["parameters"], strict=True):
        assert one["value"] == pytest.approx(other["value"], rel=1e-3, abs=1e-6)


def test_drive_gains_that_nothing_confirms_answer_nothing(efforts, tmp_path):
    """Gains of a wrong size, and any gains where a description has no masses, leave open what the numbers are."""
    bare = tmp_path / "bare.urdf"
    bare.write_text(re.sub(r"(?s)<inertial>.*?</inertial>", "", urdf_from_robot(load_robot("scara"))))
    stored = tmp_path / "stored.json"
    description = {"format": "urdf", "content": bare.read_text()}
    drives = {name: {"drive_gain": 37.0} for name in load_robot("scara").joint_names}
    stored.write_text(json.dumps({"name": "stored", "description": description, "drives": drives}))
    for said in (["scara", "--drive-gains", "0.2,0.2,0.2,0.2"], [bare, "--drive-gains", "37,37,37,37"], [stored]):
        refused = dynident("identify", said[0], efforts, *said[1:])
        assert (refused.code, "Open questions" in refused.err, "effort_kind" in refused.err) == (2, True, True)
    answer = tmp_path / "answer.json"
    answer.write_text('{"effort_kind": "motor_current"}')
    stated = dynident("identify", stored, efforts, "--metadata", answer)
    assert stated.code == 0, stated.err
    assert "current: Effort1 … Effort4" in stated.err


def test_a_proposal_with_an_open_question_is_not_written(efforts, tmp_path):
    target = tmp_path / "proposal.json"
    refused = dynident("inspect", efforts, "--robot", "scara", "--as-proposed", "--out", target)
    assert (refused.code, "effort_kind" in refused.err, target.exists()) == (2, True, False)


def test_gains_that_are_given_for_recorded_torques_are_not_silently_ignored(foreign, tmp_path):
    run = tmp_path / "run1.csv"
    for file in (run, foreign[0]):
        told = dynident("identify", "scara", file, "--drive-gains", "5,5,5,5").out
        assert "stated drive gains are not used" in " ".join(told.split())
    # Gains that a robot has do not mean that all its recordings are of currents.
    robot = load_robot("scara", drive_gains=(5.0,) * 4)
    assert not any("gains" in check.detail for check in read_recordings(run, robot=robot)[0].checks)
    stated = read_recordings(run, robot=robot, drive_gains=(5.0,) * 4)
    assert "drive gains are not used" in str(stated.findings)


@pytest.fixture
def separate(tmp_path):
    """A run with its signals in files of their own, without names and time."""
    table = pacsv.read_csv(write_run(tmp_path / "run1.csv", 1))
    for kind in ("q", "tau"):
        names = [name for name in table.column_names if name.rstrip("0123456789") == kind]
        np.savetxt(tmp_path / f"{kind}.txt", np.column_stack([table[name].to_numpy() for name in names]))
    return tmp_path / "q.txt+tau.txt"


def test_files_of_one_recording_are_given_together_with_the_rate_that_none_of_them_has(separate, tmp_path):
    alone = dynident("inspect", tmp_path / "q.txt", "--robot", "scara")
    assert "q.csv+dq.csv+tau.csv" in alone.out
    target = tmp_path / "both.json"
    looked = dynident("inspect", separate, "--robot", "scara", "--rate", 100, "--out", target)
    assert looked.code == 0, looked.err
    assert json.loads(target.read_text())["rate"] == 100.0
    known = dynident("identify", "scara", tmp_path / "run1.csv", "--json").document
    for how in (["--as-proposed", "--rate", 100], ["--metadata", target]):
        found = dynident("identify", "scara", separate, *how, "--json").document
        assert found["residual"]["relative_total"] == pytest.approx(known["residual"]["relative_total"], rel=0.02)
    missing = dynident("inspect", f"{separate}+dq.txt", "--robot", "scara")
    assert (missing.code != 0, "dq.txt" in missing.err) == (True, True)


def test_values_of_all_joints_one_below_another_are_counted(separate, tmp_path):
    positions = np.loadtxt(tmp_path / "q.txt")
    np.savetxt(tmp_path / "q.txt", positions.reshape(-1))
    refused = dynident("inspect", separate, "--robot", "scara", "--rate", 100)
    n_rows, n = positions.shape
    assert "q.txt has more: files without" in refused.err
    assert f"{n_rows * n} is {n} times {n_rows}" in refused.err


def test_rows_of_a_thousand_numbers_are_signals(separate, tmp_path):
    """As a matrix of MATLAB has them, whose columns are moments; without names."""
    plain = dynident("inspect", separate, "--robot", "scara", "--rate", 100, "--json").document
    for kind in ("q", "tau"):
        np.savetxt(tmp_path / f"{kind}.txt", np.loadtxt(tmp_path / f"{kind}.txt").T, delimiter=",")
    turned = dynident("inspect", separate, "--robot", "scara", "--rate", 100, "--json").document
    assert [one["value"] for one in turned["guesses"]][:6] == [one["value"] for one in plain["guesses"]][:6]


def test_many_long_rows_without_names_are_moments(tmp_path):
    """A logger writes what it has, such as an image beside the joints: a thousand columns and more."""
    rng = np.random.default_rng(1)
    for shape in ((100, 1010), (1200, 1100)):
        path = tmp_path / "log.csv"
        np.savetxt(path, np.column_stack([np.arange(shape[0]) * 0.01, rng.normal(size=shape)]), "%.4g", delimiter=",")
        assert len(inspect_file(path, None).columns) == shape[1] + 1
    # Few rows of unequal lengths are no matrix either.
    path.write_text("\n".join(",".join(map(str, range(n))) for n in (1100, 1100, 1099)))
    assert len(inspect_file(path, None).columns) >= 1099


def test_what_inspect_says_of_units_is_what_identify_needs(tmp_path):
    table = pacsv.read_csv(write_run(tmp_path / "run1.csv", 1))
    columns = {name: table[name].to_numpy() for name in table.column_names}
    columns |= {f"q{j}": np.degrees(columns[f"q{j}"]) for j in (1, 2, 4)}
    path = tmp_path / "degrees.csv"
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    looked = dynident("inspect", path, "--robot", "scara").out
    units = re.search(r"--units (\S+) or --as-proposed", looked)
    assert units, looked
    assert dynident("identify", "scara", path).code == 2
    assert dynident("identify", "scara", path, "--units", units[1]).code == 0


def test_a_folder_may_have_the_name_of_a_known_arm(tmp_path, monkeypatch):
    path = write_run(tmp_path / "run1.csv", 1)
    (tmp_path / "scara").mkdir()
    monkeypatch.chdir(tmp_path)
    assert dynident("inspect", path, "--robot", "scara").code == 0


def test_a_proposal_is_written_and_taken_as_metadata(foreign, tmp_path):
    fit, _ = foreign
    target = tmp_path / "fit.json"
    assert dynident("inspect", fit, "--robot", "scara", "--out", target).code == 0
    assert json.loads(target.read_text())["columns"]["q1"] == "act_pos_1"
    assert dynident("identify", "scara", fit, "--metadata", target).code == 0
    told = json.loads(target.read_text())
    told["questions"] = [{"field": "units/q", "detail": "In which unit is q?"}]
    target.write_text(json.dumps(told))
    refused = dynident("identify", "scara", fit, "--metadata", target)
    assert (refused.code != 0, "open question" in refused.err) == (True, True)
    for wrong, said in (
        ({"windows": [[1, "noon"]]}, "windows/0/1"),
        ({"signs": {"tau1": 0.5}}, "signs"),
        ({"permutation": {"tau": [1, 1, 3, 4]}}, "permutation"),
        ({"colums": {}}, "an object of columns"),
    ):
        target.write_text(json.dumps({**told, "questions": [], **wrong}))
        refused = dynident("identify", "scara", fit, "--metadata", target)
        assert refused.code == 2
        assert said in refused.err
    for kind, said in (("gravity_compensated", "gravity-compensated"), ("muscle", "effort_kind is 'muscle'")):
        target.write_text(json.dumps({**told, "questions": [], "effort_kind": kind}))
        refused = dynident("identify", "scara", fit, "--metadata", target)
        assert refused.code != 0
        assert said in refused.err


def test_what_has_to_be_answered_is_not_taken_as_proposed(foreign, tmp_path):
    bare = tmp_path / "bare.csv"
    lines = foreign[0].read_text().splitlines()
    names = lines[0].lstrip("# ").replace("act_trq_", "tau_ext_")
    bare.write_text("\n".join([names, *lines[1:]]))
    for option in ([], ["--as-proposed"]):
        refused = dynident("identify", "scara", bare, *option)
        assert refused.code != 0
        assert "external" in refused.err
    # Nothing proposes what would correct it.
    assert "--cure" not in refused.err


def test_the_remedy_of_a_repeated_torque_leads_to_a_model(foreign):
    fit, other = foreign
    names, values = fit.read_text().splitlines()[0].lstrip("# "), np.loadtxt(fit, delimiter=",", skiprows=1)
    own = [name.strip() for name in names.split(",")]
    values[:, own.index("act_trq_2")] = values[:, own.index("act_trq_1")]
    np.savetxt(fit, values, delimiter=",", header=names, comments="")
    refused = dynident("identify", "scara", fit)
    assert (refused.code != 0, "--columns tau2=none" in refused.err, "--cure" in refused.err) == (True, True, False)
    again = dynident("identify", "scara", fit, "--columns", "tau2=none")
    assert again.code == 0, again.err
    # One joint's column is stated: the others are proposed all the same.
    stated = dynident("identify", "scara", other, "--columns", "tau1=act_trq_1")
    assert stated.code == 0, stated.err


def test_only_files_with_other_names_are_proposed(foreign, tmp_path):
    """A file that states its columns, and one with the usual names, are read as they are."""
    usual = tmp_path / "run1.csv"
    together = dynident("identify", "scara", usual, "-v", foreign[1])
    assert together.code == 0, together.err
    assert "Columns of foreign2 as proposed: t: Time (ms)" in together.err
    partial = tmp_path / "partial.json"
    partial.write_text('{"columns": {"q1": "act_pos_1"}}')
    refused = dynident("identify", "scara", foreign[0], "--metadata", partial)
    assert (refused.code != 0, "as proposed" in refused.err) == (True, False)


def test_ticks_of_a_clock_are_asked_about_beside_the_torque(tmp_path):
    run = write_run(tmp_path / "run.csv", 2)
    names = run.read_text().splitlines()[0].replace('"', "").replace("t,", "TIMESTAMP,", 1)
    values = np.loadtxt(run, delimiter=",", skiprows=1)
    values[:, 0] = np.round(24e6 * values[:, 0]) + 8e12
    ticks = tmp_path / "ticks.csv"
    np.savetxt(ticks, values, delimiter=",", header=names, comments="", fmt="%.17g")
    proposal = inspect_file(ticks, load_robot("scara")).proposal
    assert proposal is not None
    asked = {question.field: question.choices for question in proposal.questions}
    assert "units/t" in asked
    assert asked.get("units/tau3", ("mN",)) == ("mN",)
    stated = dynident("identify", "scara", ticks, "--as-proposed", "--rate", 100)
    assert stated.code == 0, stated.err


def test_columns_are_told_by_their_kinds():
    columns = {"q_a": "p1", "q_b": "p2", "q_command_a": "c1", "q_command_b": "c2", "base_qx": "x"}
    told = describe_columns(RecordingMetadata(columns=columns, units={"q": "deg"}))
    assert told == "q: p1 … p2 (deg); q_command: c1 … c2; base_qx: x"


def test_an_option_that_answers_is_enough_beside_a_proposal(foreign):
    fit = foreign[0]
    names, values = fit.read_text().splitlines()[0], np.loadtxt(fit, delimiter=",", skiprows=1)
    reaction = np.where([name.startswith("act_trq") for name in names.split(",")], -1.0, 1.0)
    np.savetxt(fit, values * reaction, delimiter=",", header=names, comments="")
    refused = dynident("identify", "scara", fit, "--as-proposed")
    assert (refused.code != 0, "all torques" in refused.err, "--cure" in refused.err) == (True, True, False)
    # In a mirror this arm is the same: the cure is not ours to choose.
    undecided = dynident("identify", "scara", fit, "--as-proposed", "--cure")
    assert (undecided.code != 0, "all positions" in undecided.err) == (True, True)
    answered = dynident("identify", "scara", fit, "--as-proposed", "--accept", "torque_sign")
    assert answered.code == 0, answered.err
    # A file of answers goes beside the proposal, and need not repeat it.
    answers = fit.with_name("answers.json")
    answers.write_text('{"signs": {"tau": -1}}')
    stated = dynident("identify", "scara", fit, "--as-proposed", "--metadata", answers)
    assert stated.code == 0, stated.err


REMEDIES = (Remedy("columns", {"tau2": "none"}),)
ZERO_STATED = RecordingMetadata(zeros={"q3": 1.5})


@pytest.mark.parametrize(
    ("question", "answers", "answered"),
    [
        (Question("effort_kind", "?", ("joint_torque", "motor_current")), StatedAnswers(units={"tau": "N m"}), True),
        (Question("effort_kind", "they are external"), StatedAnswers(units={"tau": "N m"}), False),
        (Question("effort_kind", "they are external"), StatedAnswers(columns={"tau1": "a"}), True),
        (Question("units/q", "?"), StatedAnswers(units={"q2": "deg"}), True),
        (Question("units/q", "?"), StatedAnswers(units={"tau": "N m"}), False),
        (Question("columns", "?", check="torque_order"), StatedAnswers(accept=["torque_order"]), True),
        (Question("columns", "?", check="torque_order", is_curable=True), StatedAnswers(cure=True), True),
        (Question("columns", "?", check="repeated_torque", remedies=REMEDIES), StatedAnswers(cure=True), False),
        (Question("gravity", "?", check="gravity_direction"), StatedAnswers(units={"q": "rad"}), False),
        (Question("zeros", "?", check="joint_zero", is_curable=True), StatedAnswers(cure=True), False),
        (
            Question("zeros", "?", check="joint_zero"),
            StatedAnswers(metadata=RecordingMetadata(zeros={"q3": 1.5})),
            True,
        ),
    ],
)
def test_an_option_answers_the_question_that_it_is_about(question, answers, answered):
    assert answers.is_answered(question) is answered


def accept_like(asked: Question, columns: dict[str, str], units: dict[str, str], names: dict[str, str]):
    """Accept a file with a question beside one that is known: t, q1 and tau1, in deg; `names` are other names."""
    known = RecordingMetadata(
        columns={ours: names.get(column, column) for ours, column in READ.items()},
        units={"q": "deg"},
        effort_kind="joint_torque",
    )
    columns = {ours: names.get(column, column) for ours, column in columns.items()}
    proposal = Proposal(columns, units, "unknown", (), (asked,))
    none = np.zeros((0, 4))
    inspection = Inspection(Path("b.csv"), "csv", (*known.columns.values(), "g"), none, none, 0, proposal)
    return accept_proposal(inspection, has_gains=True, accepted=[known])


def test_a_unit_that_is_stated_goes_before_those_that_were_proposed_for_single_joints():
    proposed = {"q": "rad", "q1": "counts:16384", "q2": "counts:4010", "q3": "mm", "tau3": "N"}
    columns = {"t": "time", "q1": "a", "q2": "b", "q3": "c", "tau1": "d", "tau2": "e", "tau3": "f"}
    none = np.zeros((0, 7))
    proposal = Proposal(columns, proposed, "joint_torque", (), (Question("units/q1", "?", ("rad", "deg")),))
    inspection = Inspection(Path("b.csv"), "csv", tuple(columns.values()), none, none, 0, proposal)
    stated = RecordingMetadata(units={"q": "counts:4096"})
    answers = StatedAnswers(units=stated.units, metadata=stated)
    read = accept_proposal(inspection, has_gains=True, answers=answers)
    # A joint that slides keeps its own: the unit is that of those that turn.
    assert read.units == {"q": "counts:4096", "q3": "mm", "tau3": "N"}


READ = {"t": "time", "q1": "a", "tau1": "f"}
WHICH = ("joint_torque", "motor_current")


@pytest.mark.parametrize(
    ("asked", "columns", "units", "read"),
    [
        (Question("effort_kind", "?", WHICH), READ, {"q": "deg"}, ({"q": "deg"}, "joint_torque")),
        (
            Question("effort_kind", "?", WHICH),
            {"t": "time", "q1": "a", "current1": "f"},
            {"q": "deg", "current": "mA"},
            ({"q": "deg"}, "joint_torque"),
        ),
        (Question("units/q", "?", ("rad", "deg")), READ, {"q": "rad", "tau": "mN m"}, None),
        (Question("units/q", "?", ("rad", "deg")), READ, {}, ({"q": "deg"}, "unknown")),
        (
            Question("columns/tau", "?", ("f", "g")),
            {"t": "time", "q1": "a"},
            {"q": "deg"},
            ({"q": "deg"}, "joint_torque"),
        ),
    ],
)
def test_what_a_file_leaves_open_is_read_as_in_one_with_the_same_columns(asked, columns, units, read):
    with pytest.raises(DynidentError, match="open") if read is None else nullcontext():
        accepted = accept_like(asked, columns, units, {})
        assert (accepted.columns, accepted.units, accepted.effort_kind) == (READ, *read)
    # Names that a file without a header is given say nothing.
    with pytest.raises(DynidentError, match="open"):
        accept_like(asked, columns, units, {"a": "column2", "f": "column3"})


@pytest.mark.parametrize(
    ("asked", "columns"),
    [
        (Question("effort_kind", "?", WHICH, "torque_scale"), READ),
        (Question("columns/t", "It runs backward.", ("time", "g")), READ),
        (Question("units/t", "?", ("s", "ms")), READ),
        (Question("columns", "It is refused."), READ),
        (Question("effort_kind", "?", WHICH), {**READ, "q1": "f", "tau1": "a"}),
        (Question("effort_kind", "?", WHICH), {**READ, "tau1": "g"}),
    ],
)
def test_facts_of_one_file_and_what_contradicts_another_stay_open(asked, columns):
    with pytest.raises(DynidentError, match="open"):
        accept_like(asked, columns, {"q": "deg"}, {})


def test_without_a_robot_the_columns_are_listed(foreign):
    answer = dynident("inspect", foreign[0], "--json")
    assert answer.document["preview"]["columns"][1] == "act_pos_1"
    assert answer.document["format"] == "csv"


@pytest.mark.parametrize(
    ("question", "option"),
    [
        (Question("drives", "they are currents"), "--drive-gains"),
        (Question("columns/base_qx", "?", ("a", "b")), "--columns base_qx=…,base_qy=…"),
        (Question("effort_kind", "they are commanded"), '"effort_kind": "joint_torque" in --metadata'),
        (Question("columns/t", "?", ("a", "b")), "--rate HZ"),
        (
            Question("gravity", "?", check="gravity_direction", remedies=(Remedy("gravity", (0.0, 0.0, 9.81)),)),
            "--gravity 0,0,9.81, or --accept gravity_direction",
        ),
    ],
)
def test_a_question_names_the_option_that_answers_it(question, option):
    assert option in describe_answer(question, write_option)


def test_a_folder_is_called_one(tmp_path):
    refused = dynident("inspect", tmp_path, "--robot", "scara")
    assert (refused.code, "is a folder" in refused.err) == (2, True)


def test_the_folder_of_a_lerobot_data_set_is_answered_with_the_file_in_it(tmp_path):
    file = tmp_path / "fit" / "data" / "chunk-000" / "file-000.parquet"
    file.parent.mkdir(parents=True)
    file.write_bytes(b"")
    refused = dynident("inspect", tmp_path / "fit", "--robot", "scara")
    assert refused.code == 2
    assert f"LeRobotdataset;givethefileinit:{file}" in "".join(refused.err.split())
