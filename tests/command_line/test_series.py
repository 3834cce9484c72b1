"""`dynident series`: one arm on many days, as files."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from support.running_commands import dynident, write_run

CHANGED = 3.0


@pytest.fixture(scope="module")
def days(desk: Path) -> list[Path]:
    """Four days; on the last two the second joint's torque reads so much more."""
    found = []
    for k in range(4):
        path = desk / f"day{k + 1}.csv"
        write_run(path, 11 + k)
        if k >= 2:
            _shifted(path)
        found.append(path)
    return found


def _shifted(path: Path) -> None:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    name = next(column for column in rows[0] if column.startswith("tau") and column.endswith("2"))
    for row in rows:
        row[name] = str(float(row[name]) + CHANGED)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def test_what_changed_is_told_with_its_day_and_the_courses_are_written_and_drawn(desk: Path, days: list[Path]) -> None:
    out, figure, kept = desk / "courses.csv", desk / "courses.svg", desk / "days.npz"
    answer = dynident("series", desk / "model.npz", *days, "--out", out, "--figure", figure, "--keep", kept)
    assert answer.code == 0, answer.err
    assert "from day3 on" in answer.out
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["day"] for row in rows} == {"day1", "day2", "day3", "day4"}
    assert figure.read_text(encoding="utf-8").startswith("<svg")

    # One more day: the others are not read again.
    for path in days:
        path.rename(path.with_suffix(".gone"))
    fifth = desk / "day5.csv"
    write_run(fifth, 15)
    _shifted(fifth)
    again = dynident("series", desk / "model.npz", fifth, "--keep", kept, "--json")
    assert again.code == 0, again.err
    found = again.document
    assert found["days"] == ["day1", "day2", "day3", "day4", "day5"]
    (offset,) = [one for one in found["changes"] if one["effect"] in ("offset", "coulomb_asymmetric")]
    assert offset["since"] == "day3"
    low, high = offset["interval"]
    assert low <= CHANGED <= high


def test_a_single_day_is_refused_in_words(desk: Path) -> None:
    answer = dynident("series", desk / "model.npz", desk / "run1.csv")
    assert answer.code == 2
    assert "at least two days" in answer.err
