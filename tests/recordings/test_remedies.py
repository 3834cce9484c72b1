"""A remedy is an object: over HTTP, on the command line and in Python it is written in the syntax of each."""

from __future__ import annotations

import pickle

import pytest

from dynident.errors import Remedy, word_remedies, write_argument
from dynident.recordings import RecordingError
from dynident_cli.request_options import write_option

WRITTEN = [
    (
        Remedy("skip", ("held_samples",)),
        '"skip": ["held_samples"]',
        "--skip held_samples",
        'metadata=dy.RecordingMetadata(skip=("held_samples",))',
    ),
    (Remedy("units", {"q": "deg"}), '"units": {"q": "deg"}', "--units q=deg", 'units={"q": "deg"}'),
    (
        Remedy("units", {"q": "deg"}).for_recording("held"),
        '"metadata": {"held": {"units": {"q": "deg"}}}',
        '--metadata held=FILE with {"units": {"q": "deg"}}',
        'units={"q": "deg"} for held alone',
    ),
    (
        Remedy("columns", {"tau1": "none", "tau2": "none"}),
        '"columns": {"tau1": "none", "tau2": "none"}',
        "--columns tau1=none,tau2=none",
        'columns={"tau1": "none", "tau2": "none"}',
    ),
    (
        Remedy("locked_joints", {"j1": 0}),
        '"locked_joints": {"j1": 0}',
        "--lock j1",
        'load_robot(…, locked_joints={"j1": 0})',
    ),
    (Remedy("rate"), '"rate": …', "--rate HZ", "metadata=dy.RecordingMetadata(rate=…)"),
    (
        Remedy("gravity", (0.0, 0.0, 9.81)),
        '"gravity": [0, 0, 9.81]',
        "--gravity 0,0,9.81",
        "load_robot(…, gravity=(0, 0, 9.81))",
    ),
    (
        Remedy("windows", ((0.0, 4.5), (50.0, 60.0))),
        '"windows": [[0, 4.5], [50, 60]]',
        "--windows 0:4.5,50:60",
        "windows=([0, 4.5], [50, 60])",
    ),
    (
        Remedy("windows", ((1.7e9, 1.7e9 + 6.65),)),
        '"windows": [[1700000000, 1700000006.65]]',
        "--windows 1700000000:1700000006.65",
        "windows=([1700000000, 1700000006.65],)",
    ),
    (Remedy("contacts"), '"contacts": …', "--contacts", "set_base(robot, contacts=[…])"),
    (
        Remedy("drives", {"j1": {"drive_gain": ...}}),
        '"drives": {"j1": {"drive_gain": …}}',
        "--drive-gains",
        "drive_gains",
    ),
]


@pytest.mark.parametrize(("remedy", "over_http", "as_option", "in_python"), WRITTEN)
def test_each_way_in_writes_a_remedy_in_its_own_syntax(remedy, over_http, as_option, in_python) -> None:
    sentence = f"This looks wrong: say {remedy} (first in row 3)."
    assert sentence == f"This looks wrong: say {over_http} (first in row 3)."
    assert word_remedies(sentence, (remedy,), write_option) == f"This looks wrong: say {as_option} (first in row 3)."
    assert word_remedies(sentence, (remedy,), write_argument) == f"This looks wrong: say {in_python} (first in row 3)."


@pytest.mark.parametrize(
    "remedies",
    [
        (Remedy("columns", {"tau1": "none", "tau2": "none"}), Remedy("columns", {"tau1": "none"})),
        (Remedy("rate", 200), Remedy("rate", 20)),
    ],
)
def test_a_remedy_whose_text_begins_another_is_worded_too(remedies) -> None:
    for first, second in (remedies, remedies[::-1]):
        for write in (write_option, write_argument):
            worded = word_remedies(f"Say {first}, or {second}.", remedies, write)
            assert worded == f"Say {write(first)}, or {write(second)}."
            assert word_remedies(worded, remedies, write) == worded


def test_remedies_cross_the_border_of_a_process_with_their_error() -> None:
    error = RecordingError("say it", remedies=(Remedy("rate"),))
    assert pickle.loads(pickle.dumps(error)).remedies == (Remedy("rate"),)
