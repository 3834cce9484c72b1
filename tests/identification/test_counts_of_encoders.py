"""Positions in counts of an encoder are read, proposed where the robot tells them, and never taken for radians."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import guess, log, read, signals

from dynident.recordings import RecordingError


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("name", "seed", "rate", "counts", "zero"),
    [
        ("ur10", 1, 100.0, 131072, 0),
        ("ur10", 2, 200.0, 65536, 0),
        ("franka_panda", 3, 100.0, 1048576, 0),
        ("franka_panda", 4, 50.0, 20000, 0),
        ("ur10", 5, 100.0, 4096, 2048),
        ("ur10", 6, 100.0, 1000000, 0),
    ],
)
def test_counts_a_turn_are_proposed_or_asked_with_the_right_ones_among_the_first(
    tmp_path: Path, name: str, seed: int, rate: float, counts: int, zero: int
) -> None:
    given = log(name, seed, rate)
    q = np.rint(given.q * counts / (2.0 * np.pi)) + zero
    unit = f"counts:{counts}" + (f"@{zero}" if zero else "")
    found = guess(given.robot, given.columns(q=q))
    asked = [one for one in found.questions if one.field == "units/q"]
    assert found.units["q"] == unit or (asked and unit in asked[0].choices)
    recording = read(given.robot, tmp_path, given.columns(q=q), units={"q": unit}, accept=("quantisation",))
    np.testing.assert_allclose(signals(recording)[0], given.q, atol=2.0 * np.pi / counts + 1e-3)


@pytest.mark.parametrize(("name", "counts"), [("ur10", 131072), ("franka_panda", 4096), ("ur10", 20000)])
def test_counts_are_never_taken_for_radians(tmp_path: Path, name: str, counts: int) -> None:
    given = log(name)
    columns = given.columns(q=np.rint(given.q * counts / (2.0 * np.pi)))
    with pytest.raises(RecordingError, match="encoder counts") as raised:
        read(given.robot, tmp_path, columns)
    assert '"counts:4096@2048"' in str(raised.value)


def test_every_joint_may_count_by_itself_and_a_wrong_unit_names_what_is_known(tmp_path: Path) -> None:
    given = log()
    counts = np.array([4096, 8192, 10000, 4000.5, 65536, 1e6])
    units = {f"q{joint + 1}": f"counts:{counts[joint]:g}" for joint in range(6)} | {"q6": "counts:1e6@17"}
    shift = np.array([0, 0, 0, 0, 0, 17.0])
    columns = given.columns(q=given.q * counts / (2.0 * np.pi) + shift)
    np.testing.assert_allclose(signals(read(given.robot, tmp_path, columns, units=units))[0], given.q, atol=1e-6)
    with pytest.raises(RecordingError, match=r"choose from rad.*counts:N"):
        read(given.robot, tmp_path, columns, units={"q": "counts:none"})


def test_degrees_in_whole_numbers_are_no_counts() -> None:
    given = log()
    found = guess(given.robot, given.columns(q=np.rint(np.rad2deg(given.q))))
    assert found.units.get("q") == "deg"


def test_whole_numbers_that_may_be_degrees_are_refused_and_no_unit_is_taken_unasked(tmp_path: Path) -> None:
    given = log("ur10", 4)
    small = given.q[:, :1].mean() + 0.25 * (given.q - given.q.mean(axis=0))
    columns = given.columns(q=np.rint(small * 4096 / (2.0 * np.pi)))
    with pytest.raises(RecordingError, match="encoder counts") as raised:
        read(given.robot, tmp_path, columns, cures=5)
    assert [one.apply for one in raised.value.checks if one.status == "error"] == [None]


@pytest.mark.parametrize("seed", [1, 2])
def test_counts_that_differ_by_joint_are_asked_with_estimates(seed: int) -> None:
    given = log("ur10", seed)
    counts = np.array([482904.0, 482904.0, 360000.0, 163836.0, 163836.0, 112680.0])
    found = guess(given.robot, given.columns(q=np.rint(given.q * counts / (2.0 * np.pi))))
    (asked,) = [one for one in found.questions if one.field == "units/q"]
    value = asked.remedies[0].value
    assert isinstance(value, dict)
    # The last joint carries nothing, and any scale of it explains as much.
    assert sorted(value) == ["q1", "q2", "q3", "q4", "q5"]
    assert "and those of other joints" in asked.detail
    estimates = [float(unit.partition(":")[2]) for _, unit in sorted(value.items())]
    np.testing.assert_allclose(estimates, counts[:5], rtol=0.15)


@pytest.mark.parametrize("seed", [1, 2])
def test_one_encoder_for_all_joints_is_not_asked_by_joint(seed: int) -> None:
    given = log("franka_panda", seed)
    # Servos say coarsely how much they are loaded, in per cent.
    load = np.round(100.0 * given.tau / np.array([60, 60, 30, 30, 30, 20, 20.0]), 1)
    columns = given.columns(tau=load, q=np.rint(given.q * 4096 / (2.0 * np.pi)) + 2048)
    found = guess(given.robot, {name.replace("tau", "load_pct_"): values for name, values in columns.items()})
    assert found.units["q"] == "counts:4096@2048"
    assert [one.field for one in found.questions] == ["drives"]


def test_gears_that_differ_by_joint_keep_the_count_at_zero() -> None:
    given = log("ur10", 1)
    gears = np.array([1.7, 1.0, 1.0, 0.6, 1.0, 1.0])
    found = guess(given.robot, given.columns(q=np.rint(given.q * gears * 4096 / (2.0 * np.pi)) + 2048))
    asked = next(one for one in found.questions if one.field == "units/q")
    value = asked.remedies[0].value
    assert isinstance(value, dict)
    estimates = [unit.removeprefix("counts:").partition("@") for _, unit in sorted(value.items())]
    assert {zero for *_, zero in estimates} == {"2048"}
    np.testing.assert_allclose([float(counts) for counts, *_ in estimates], 4096 * gears[:5], rtol=0.05)
