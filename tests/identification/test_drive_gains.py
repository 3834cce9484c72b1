"""Drive gains from runs without and with a known payload, and payloads weighed with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.noise_free_data import drawn_standard, torque_of
from support.oracles import arm, fourier_motion, pinocchio_rows, record

from dynident.errors import DynidentError
from dynident.identification.loads.drive_gains import DriveGains, identify_gains, payload_mass
from dynident.identification.loads.payloads_of_recordings import read_known_payload
from dynident.recordings import Preprocessing
from dynident.robot import Drive

UR10 = arm("ur10")
STANDARD = drawn_standard(UR10)
MASS, CENTRE = 4.0, (0.05, -0.02, 0.12)
# XX XY XZ YY YZ ZZ MX MY MZ M about the last joint's frame.
PAYLOAD = np.array([0.09, 0.005, -0.02, 0.1, 0.01, 0.03, *(MASS * np.array(CENTRE)), MASS])
GAINS = np.array([14.0, 12.5, 11.0, 10.5, 9.5, 11.5])
RATE = 200.0
BAND = Preprocessing(12.0, 10.0, 4)
CURRENT_NOISE = np.array([0.15, 0.15, 0.1, 0.05, 0.05, 0.05])
MOTION = fourier_motion(UR10, 20.0, RATE, 1, base_frequency=0.08, amplitude=2.5)
UNLOADED = torque_of(UR10, MOTION, STANDARD)
CARRIED = pinocchio_rows(UR10, MOTION.q, MOTION.dq, MOTION.ddq)[:, :, -10:] @ PAYLOAD


def currents(noise: float = 1.0, seed: int = 0):
    """The same motion without and with the payload, as currents."""
    rng = np.random.default_rng(seed)
    made = []
    for name, torque in (("unloaded", UNLOADED), ("loaded", UNLOADED + CARRIED)):
        current = torque / GAINS + noise * CURRENT_NOISE * rng.normal(size=torque.shape)
        made.append(record(UR10, MOTION, current, name))
    return made[0], replace(made[1], payload={"mass": MASS})


def gains_of(unloaded, loaded, **more) -> DriveGains:
    return identify_gains(UR10, [unloaded], [loaded], **{"preprocessing": BAND, **more})


def test_exact_currents_give_the_true_gains():
    found = gains_of(*currents(0.0), preprocessing=Preprocessing(None, None, 4))
    np.testing.assert_allclose(found.values, GAINS, rtol=1e-4)
    assert found.identifiable == (True,) * 6
    assert found.warnings == ()


def test_what_is_being_read_is_told_run_by_run():
    told: list[tuple[float, str]] = []
    runs = currents(0.0)
    gains_of(*runs, preprocessing=Preprocessing(None, None, 4), progress=lambda *news: told.append(news))
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    for run in runs:
        assert any(run.name in message for _, message in told)


def test_gains_are_in_the_unit_of_those_that_were_stated():
    """Torque that was computed with wrong gains gives those that it should have been computed with."""
    wrong = np.array([10.0, 14.0, 9.0, 12.0, 9.0, 10.0])
    unloaded, loaded = currents(0.0)
    computed = [
        replace(record(UR10, MOTION, run.source.tau * wrong, run.name), payload=run.payload)
        for run in (unloaded, loaded)
    ]
    wide = Preprocessing(None, None, 4)
    found = gains_of(*computed, stated=tuple(wrong), preprocessing=wide)
    np.testing.assert_allclose(found.values, GAINS, rtol=1e-4)
    np.testing.assert_allclose(found.factors, GAINS / wrong, rtol=1e-4)
    robot = replace(UR10, drives=tuple(Drive(gear_ratio=2.0, torque_constant=float(g) / 2.0) for g in wrong))
    by_data_sheet = identify_gains(robot, computed[:1], computed[1:], preprocessing=wide)
    np.testing.assert_allclose(by_data_sheet.values, found.values, rtol=1e-9)


def test_a_payload_whose_centre_is_known_tells_more():
    unloaded, loaded = currents()
    by_mass = gains_of(unloaded, loaded)
    by_centre = gains_of(unloaded, replace(loaded, payload={"mass": MASS, "centre": list(CENTRE)}))
    # To within what twenty stretches of time tell of a standard deviation.
    assert (by_centre.standard_deviations < 1.1 * by_mass.standard_deviations).all()
    assert (by_centre.standard_deviations[3:] < 0.85 * by_mass.standard_deviations[3:]).any()


@pytest.mark.slow
def test_intervals_of_gains_and_of_a_mass_weighed_with_them_cover_the_truth(thorough):
    other_mass, seeds = 0.6, 30 if thorough else 12
    hits, weighed, errors = [], [], []
    for seed in range(seeds):
        unloaded, loaded = currents(seed=seed)
        found = gains_of(unloaded, loaded)
        hits.append((found.intervals[:, 0] < GAINS) & (found.intervals[:, 1] > GAINS))
        errors.append(found.values / GAINS - 1)
        rng = np.random.default_rng(1000 + seed)
        current = (UNLOADED + other_mass * CARRIED) / GAINS + CURRENT_NOISE * rng.normal(size=UNLOADED.shape)
        again, _ = currents(seed=2000 + seed)
        mass = payload_mass(UR10, [again], record(UR10, MOTION, current, "other"), gains=found, preprocessing=BAND)
        assert 0 < mass.from_gains < mass.standard_deviation
        weighed.append(mass.interval[0] < other_mass * MASS < mass.interval[1])
    assert 0.88 < np.mean(hits) <= 0.99
    assert np.mean(weighed) >= 0.83
    bias, spread = np.mean(errors, axis=0), np.std(errors, axis=0) / np.sqrt(seeds)
    assert (np.abs(bias) < 4 * spread).all()


def test_noisy_currents_do_not_make_the_gains_small_as_ordinary_least_squares_does():
    """The currents stand among the columns: least squares on the payload's torque takes their noise for signal."""
    rng = np.random.default_rng(3)
    rows = pinocchio_rows(UR10, MOTION.q[::20], MOTION.dq[::20], MOTION.ddq[::20])
    noise = 8 * CURRENT_NOISE
    unloaded, loaded = currents(8.0, seed=3)
    found = gains_of(unloaded, loaded, preprocessing=Preprocessing(None, None, 20))
    assert found.identifiable[1]
    # Joint 2 by itself, W and the payload's torque exact: w = g u - W χ.
    j = 1
    more = np.column_stack([MOTION.ddq[::20, j], np.sign(MOTION.dq[::20, j]), MOTION.dq[::20, j], np.ones(len(rows))])
    w = np.hstack([rows[:, j], more])
    with_it, without = (torque[::20, j] / GAINS[j] for torque in (UNLOADED + CARRIED, UNLOADED))
    measured = [u + noise[j] * rng.normal(size=len(u)) for u in (with_it, without)]
    matrix = np.vstack([np.column_stack([measured[0], -w]), np.column_stack([measured[1], -w])])
    right = np.concatenate([CARRIED[::20, j], np.zeros(len(rows))])
    naive = np.linalg.lstsq(matrix, right)[0][0]
    assert naive < 0.9 * GAINS[j]
    assert abs(found.values[j] - GAINS[j]) < 0.5 * abs(naive - GAINS[j])


def test_a_gain_that_the_payload_hardly_shows_is_called_not_identifiable():
    scara = arm("scara")
    motion = fourier_motion(scara, 20.0, RATE, 1, base_frequency=0.05, harmonics=3, amplitude=1.0, fastest=0.1)
    standard = drawn_standard(scara)
    carried = pinocchio_rows(scara, motion.q, motion.dq, motion.ddq)[:, :, -1] * 2.0
    rng = np.random.default_rng(0)
    runs = [
        record(scara, motion, torque_of(scara, motion, standard) + share * carried + rng.normal(size=motion.q.shape), n)
        for share, n in ((0.0, "unloaded"), (1.0, "loaded"))
    ]
    found = identify_gains(scara, runs[:1], [replace(runs[1], payload={"mass": 2.0})], preprocessing=BAND)
    assert not all(found.identifiable)
    for name, good in zip(scara.joint_names, found.identifiable, strict=True):
        assert any(f"The gain of {name} is not identifiable" in w for w in found.warnings) == (not good)


@pytest.mark.parametrize(
    ("payload", "pointer", "word"),
    [
        (None, "/payload", "no payload is given"),
        ({}, "/payload/mass", "mass is None"),
        ({"mass": 0.0}, "/payload/mass", "above zero"),
        ({"mass": -1}, "/payload/mass", "above zero"),
        ({"mass": "two"}, "/payload/mass", "'two'"),
        ({"mass": float("nan")}, "/payload/mass", "nan"),
        ({"mass": True}, "/payload/mass", "True"),
        ({"mass": 2.0, "centre": [0.0, 1.0]}, "/payload/centre", "x, y and z"),
        ({"mass": 2.0, "centre": "there"}, "/payload/centre", "x, y and z"),
        ({"mass": 2.0, "centre": 3}, "/payload/centre", "x, y and z"),
    ],
)
def test_payloads_that_are_not_known_are_refused(payload, pointer, word):
    unloaded, loaded = currents()
    loaded = replace(loaded, payload=payload)
    with pytest.raises(DynidentError, match=word) as caught:
        read_known_payload(loaded)
    assert caught.value.pointer == pointer
    with pytest.raises(DynidentError):
        gains_of(unloaded, loaded)


def test_missing_runs_are_named():
    unloaded, loaded = currents()
    with pytest.raises(DynidentError, match="with the payload is missing") as caught:
        identify_gains(UR10, [unloaded], [])
    assert caught.value.pointer == "/loaded_ids"
    with pytest.raises(DynidentError, match="without the payload is missing") as caught:
        identify_gains(UR10, [], [loaded])
    assert caught.value.pointer == "/unloaded_ids"
    with pytest.raises(DynidentError, match="same name"):
        identify_gains(UR10, [unloaded], [replace(loaded, name="unloaded")])


def test_currents_that_are_zero_are_refused():
    unloaded, loaded = (record(UR10, MOTION, np.zeros_like(MOTION.q), name) for name in ("unloaded", "loaded"))
    with pytest.raises(DynidentError, match="zero everywhere"):
        gains_of(unloaded, replace(loaded, payload={"mass": 2.0}))
    unloaded, loaded = currents()
    dead = [record(UR10, MOTION, run.source.tau * [1, 1, 0, 1, 1, 1], run.name) for run in (unloaded, loaded)]
    with pytest.raises(DynidentError, match="no effect"):
        gains_of(dead[0], replace(dead[1], payload={"mass": 2.0}))


@pytest.mark.parametrize("stated", [(1.0,), (1.0, 2.0, 3.0, 0.0, 1.0, 1.0), (1.0, float("inf"), 1.0, 1.0, 1.0, 1.0)])
def test_stated_gains_that_make_no_sense_are_refused(stated):
    with pytest.raises(DynidentError, match="6 joints"):
        gains_of(*currents(), stated=stated)


def test_a_payload_is_weighed_with_gains_that_are_right():
    unloaded, loaded = currents()
    true = DriveGains(UR10.joint_names, GAINS, np.zeros((6, 6)), np.ones(6), (True,) * 6)
    found = payload_mass(UR10, [unloaded], loaded, gains=true, preprocessing=BAND)
    assert found.interval[0] < MASS < found.interval[1]
    assert found.from_gains == 0.0
    assert found.identifiable
    nothing = payload_mass(UR10, [unloaded], replace(currents(seed=5)[0], name="again"), gains=true, preprocessing=BAND)
    assert abs(nothing.mass) < 0.2 * MASS
    assert not nothing.identifiable
