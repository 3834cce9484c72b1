"""Registers whose sign a log has not read are told, read, and left as they are where somebody says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import Log, guess, log, read, signals

from dynident.recordings.conditioning.signed_registers import check_lost_sign, find_register

COUNTS = {7: 100.0, 10: 900.0, 11: 1500.0, 15: 20000.0, 31: 1.5e9}


def counted(given: Log, bit: int) -> tuple[np.ndarray, np.ndarray]:
    """Torques in whole counts of a register with a sign in that bit, and what makes N m of each joint's."""
    scale = np.abs(given.tau).max(axis=0) / COUNTS[bit]
    return np.rint(given.tau / scale), scale


def unsigned(counts: np.ndarray, bit: int, kind: str) -> np.ndarray:
    return np.where(counts < 0, 2.0**bit - counts if kind == "sign bit" else 2.0 ** (bit + 1) + counts, counts)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("name", "seed", "rate", "bit", "kind"),
    [
        ("ur10", 1, 50.0, 10, "sign bit"),
        ("ur10", 2, 200.0, 11, "sign bit"),
        ("franka_panda", 3, 100.0, 15, "sign bit"),
        ("crooked", 4, 100.0, 10, "sign bit"),
        ("ur10", 5, 100.0, 15, "complement"),
        ("franka_panda", 6, 50.0, 31, "complement"),
        ("crooked", 7, 200.0, 7, "complement"),
    ],
)
def test_torques_of_registers_are_read_with_their_sign(
    tmp_path: Path, name: str, seed: int, rate: float, bit: int, kind: str
) -> None:
    given = log(name, seed, rate)
    counts, _ = counted(given, bit)
    columns = given.columns(tau=unsigned(counts, bit, kind))
    accept = ("torque_scale", "torque_sign", "torque_order", "quantisation", "saturation")
    found = read(given.robot, tmp_path, columns, accept=accept)
    (check,) = [one for one in found.checks if one.name == "registers"]
    assert check.status == "warning"
    assert f"jump by {2**bit if kind == 'sign bit' else 2 ** (bit + 1)} around zero" in check.detail
    np.testing.assert_allclose(signals(found)[1], counts, atol=0.02 * COUNTS[bit])
    told = {one.field: one.value for one in guess(given.robot, columns).guesses}
    assert told["rows/registers"] == "corrected"


def test_registers_are_left_as_they_are_where_somebody_says_so(tmp_path: Path) -> None:
    given = log()
    raw = unsigned(counted(given, 10)[0], 10, "sign bit")
    accept = ("torque_scale", "torque_sign", "torque_order", "joint_order", "quantisation", "saturation", "lost_sign")
    skip = ("registers", "corrupted_samples", "held_samples")
    found = read(given.robot, tmp_path, given.columns(tau=raw), accept=accept, skip=skip)
    assert not [one for one in found.checks if one.name == "registers"]
    np.testing.assert_allclose(signals(found)[1], raw, atol=1e-6)


def test_a_wrapped_position_of_a_multi_turn_counter_is_read_with_its_sign(tmp_path: Path) -> None:
    given = log()
    counts = np.rint(given.q * 65536 / (2 * np.pi) / 4)
    columns = given.columns(q=np.where(counts < 0, 65536 + counts, counts))
    found = read(given.robot, tmp_path, columns, units={"q": "counts:16384"}, skip=("corrupted_samples",))
    np.testing.assert_allclose(signals(found)[0], given.q, atol=1e-3)


def test_registers_times_a_constant_are_read_with_their_sign(tmp_path: Path) -> None:
    # A driver makes mA of counts, and takes those below zero for large ones.
    given, step = log(), 2.69
    counts, _ = counted(given, 15)
    raw = np.round(step * unsigned(np.rint(counts / 200), 15, "complement"), 2)
    found = read(given.robot, tmp_path, given.columns(tau=raw), accept=("torque_scale",), skip=("corrupted_samples",))
    assert "65536 times their step, 2.69," in next(one.detail for one in found.checks if one.name == "registers")
    np.testing.assert_allclose(signals(found)[1], step * np.rint(counts / 200), atol=1e-2)
    # Where signs are not to be read, they were not lost: an absolute value does not jump.
    assert check_lost_sign(raw, ["a", "b", "c", "d", "e", "f"]) is None


@pytest.mark.parametrize("offset", [0.0, 1.0], ids=["signed", "above zero"])
@pytest.mark.parametrize("size", [300.0, 1500.0, 40000.0])
def test_whole_numbers_that_are_no_registers_are_left_alone(size: float, offset: float) -> None:
    tau = log().tau
    counts = np.rint(size * (tau / np.abs(tau).max(axis=0) + offset))
    assert find_register(counts, np.ones(len(counts) - 1, dtype=bool)) is None


@pytest.mark.parametrize(("level", "ripple"), [(135.0, 5.0), (180.0, 30.0), (300.0, 30.0)])
@pytest.mark.parametrize("step", [1.0, 0.1, 3.1])
def test_a_drive_that_is_off_between_moves_is_no_register(level: float, ripple: float, step: float) -> None:
    t = np.arange(6000) * 0.01
    counts = np.rint(level + ripple * np.sin(2.0 * t) + np.random.default_rng(0).standard_normal(len(t)))
    torque = np.where(t % 4.0 < 2.4, counts * step, 0.0)[:, None]
    assert find_register(torque, np.ones(len(t) - 1, dtype=bool)) is None


def test_a_register_that_passes_zero_slowly_is_found() -> None:
    counts = np.rint(100.0 * np.sin(0.2 * np.arange(6000) * 0.01))[:, None]
    for kind, bit in (("sign bit", 7), ("complement", 15)):
        assert find_register(unsigned(counts, bit, kind), np.ones(len(counts) - 1, dtype=bool)) is not None


def test_single_corrupted_samples_make_no_register() -> None:
    tau = log().tau
    counts = np.abs(np.rint(300 * tau / np.abs(tau).max(axis=0)))
    counts[500, 2] = 1100.0
    assert find_register(counts, np.ones(len(counts) - 1, dtype=bool)) is None


@pytest.mark.parametrize("seed", [1, 2])
def test_torques_of_an_arm_that_come_to_0_and_never_below_have_lost_their_signs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Coarse readings, as of a servo: several rows are 0 where the torque changes its sign.
    signed = np.cumsum(rng.normal(size=(2000, 3)), axis=0)
    signed -= signed.mean(axis=0)
    coarse = np.rint(8.0 * np.abs(signed) / np.abs(signed).max(axis=0)) * 0.0228
    found = check_lost_sign(coarse, ["a", "b", "c"])
    assert found is not None
    assert found.detail.startswith("No torque is ever below 0, though a … c all come down to it")
    # A joint whose load is never lifted says that the others may be held on one side as well; so may two.
    assert check_lost_sign(coarse + np.array([0.0, 0.0, 0.1]), ["a", "b", "c"]) is None
    assert check_lost_sign(coarse[:, :2], ["a", "b"]) is None


def test_a_drive_that_is_not_on_yet_has_not_lost_the_sign_of_its_torque() -> None:
    t = np.arange(2000)[:, None] / 100.0
    held = np.array([12.0, 8.0, 4.0]) + np.array([3.0, 2.0, 1.0]) * np.sin(t * np.array([1.0, 1.3, 2.0]))
    first_row, later, ramp = held.copy(), held.copy(), held * np.clip(t / 0.5, 0.0, 1.0)
    first_row[0], later[:100] = 0.0, 0.0
    for tau in (held, first_row, later, ramp):
        assert check_lost_sign(tau, ["a", "b", "c"]) is None
