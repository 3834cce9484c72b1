"""`dynident changes`: two days of one arm, as files."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from support.running_commands import dynident


@pytest.fixture(scope="module")
def worn(desk: Path) -> Path:
    """Another day's file in which the second joint's torque reads so much more: an offset that was not there before."""
    with (desk / "run2.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    name = next(column for column in rows[0] if column.startswith("tau") and column.endswith("2"))
    for row in rows:
        row[name] = str(float(row[name]) + 3.0)
    path = desk / "later.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def test_what_differs_is_told_with_its_size_and_written_where_it_is_wanted(desk: Path, worn: Path) -> None:
    out = desk / "changes.json"
    answer = dynident("changes", desk / "model.npz", "--before", desk / "run1.csv", "--after", worn, "--out", out)
    assert answer.code == 0, answer.err
    assert "Changes since the baseline" in answer.out
    assert "Friction of each joint" in answer.out
    found = json.loads(out.read_text(encoding="utf-8"))["changes"]
    offset = next(one for one in found if one["effect"] in ("offset", "coulomb_asymmetric"))
    low, high = offset["interval"]
    assert low <= 3.0 <= high


def test_the_same_arm_on_two_days_has_not_changed(desk: Path) -> None:
    answer = dynident(
        "changes", desk / "model.npz", "--before", desk / "run1.csv", "--after", desk / "run2.csv", "--json"
    )
    assert answer.code == 0, answer.err
    assert answer.document["changes"] == []
    assert all(abs(one["value"]) < 0.1 * one["before"] for one in answer.document["friction"])


def test_an_error_of_held_out_data_alone_leads_to_what_differs_in_them(desk: Path, worn: Path) -> None:
    words = "find what differs in the held-out data"
    fit, out = desk / "run1.csv", desk / "differs.npz"
    answer = dynident("identify", "scara", fit, "-v", worn, "--effects", "default", "--out", out)
    assert words in answer.out, answer.err
    assert f"dynident changes {out} --before {fit} --after {worn}" in answer.out
    assert words not in dynident("identify", "scara", fit, "-v", desk / "run2.csv", "--out", out).out
