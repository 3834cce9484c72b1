"""`dynident gains`: drive gains from a load of known mass, as a user finds them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from support.oracles import arm, fourier_motion, pinocchio_rows, pinocchio_torque
from support.running_commands import dynident

from dynident_service.drive_gains.wire_types import DriveGainsResult

ARM = arm("ur10")
GAINS = np.array([14.0, 12.5, 11.0, 10.5, 9.5, 11.5])
MASS = 4.0


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("gains")
    motion = fourier_motion(ARM, 15.0, 100.0, 1, base_frequency=0.08, amplitude=2.0)
    plain = pinocchio_torque(ARM, motion.q, motion.dq, motion.ddq) + 4 * np.sign(motion.dq) + 3 * motion.dq
    load = MASS * np.array([0.02, 0, 0, 0.02, 0, 0.005, 0.03, 0.0, 0.1, 1.0])
    carried = pinocchio_rows(ARM, motion.q, motion.dq, motion.ddq)[:, :, -10:] @ load
    rng = np.random.default_rng(0)
    paths = folder / "plain.csv", folder / "heavy.csv"
    for path, torque in zip(paths, (plain, plain + carried), strict=True):
        current = torque / GAINS + 0.03 * rng.normal(size=torque.shape)
        columns = {"t": motion.t}
        for j in range(ARM.n):
            columns |= {f"q{j + 1}": motion.q[:, j], f"current{j + 1}": current[:, j]}
        pacsv.write_csv(pa.table(columns), path)
    return paths


def test_gains_of_currents_come_out_in_newton_metres_per_ampere(runs):
    plain, heavy = runs
    answer = dynident(
        "gains", "ur10", plain, "--loaded", heavy, "--mass", MASS, "--drive-gains", "1,1,1,1,1,1", "--json"
    )
    assert answer.code == 0, answer.err
    # The answer is the service's.
    found = DriveGainsResult.model_validate(answer.document).gains
    assert [one.joint for one in found] == list(ARM.joint_names)
    low, high = np.array([one.interval for one in found]).T
    assert (low < GAINS).sum() + (high > GAINS).sum() >= 11
    np.testing.assert_allclose([one.drive_gain for one in found], GAINS, rtol=0.1)
    assert all(one.identifiable for one in found)


def test_the_load_may_be_said_with_the_measurement(runs, tmp_path):
    plain, heavy = runs
    said = tmp_path / "heavy.json"
    said.write_text(json.dumps({"payload": {"mass": MASS}}))
    common = ["gains", "ur10", plain, "--loaded", heavy, "--drive-gains", "1,1,1,1,1,1", "--json"]
    told = dynident(*common, "--metadata", f"heavy={said}")
    assert told.code == 0, told.err
    assert told.document["gains"] == dynident(*common, "--mass", MASS).document["gains"]
    nothing = dynident(*common)
    assert nothing.code == 2
    assert "--mass" in nothing.err


def test_the_gains_stand_in_a_table_beside_the_stated_ones(runs):
    plain, heavy = runs
    stated = "10,10,10,10,10,10"
    answer = dynident("gains", "ur10", plain, "--loaded", heavy, "--mass", MASS, "--drive-gains", stated)
    assert answer.code == 0, answer.err
    assert "shoulder_pan_joint" in answer.out
    assert "identifiable" in answer.out
    assert "± 95 %" in answer.out
    said = re.search(r"--drive-gains (\S+)", answer.out)
    assert said is not None
    np.testing.assert_allclose([float(gain) for gain in said[1].split(",")], GAINS, rtol=0.1)


def test_another_load_is_weighed_with_the_gains(runs):
    """Here the known one once more, as if nobody knew it."""
    plain, heavy = runs
    weigh = ["--weigh", heavy, "--weigh-unloaded", plain]
    said = ["gains", "ur10", plain, "--loaded", heavy, "--mass", MASS, "--drive-gains", "1,1,1,1,1,1", *weigh]
    (load,) = dynident(*said, "--json").document["loads"]
    assert load["mass"] == pytest.approx(MASS, rel=0.05)
    assert load["interval"][0] < load["mass"] < load["interval"][1]
    assert 0 < load["from_gains"] < load["standard_deviation"]
    assert load["identifiable"]
    assert "not zero" in dynident(*said).out
    refused = dynident(*said[:-4], "--weigh-unloaded", plain)
    assert refused.code == 2
    assert "give --weigh, too" in refused.err


@pytest.mark.parametrize(
    ("mass", "centre", "word"), [(0, "", "mass is 0.0; it must be"), (4, "0.1,0.2", "give 3 values")]
)
def test_a_load_that_is_no_load_is_refused(runs, mass, centre, word):
    plain, heavy = runs
    more = ["--centre", centre] if centre else []
    answer = dynident("gains", "ur10", plain, "--loaded", heavy, "--mass", mass, *more, "--drive-gains", "1,1,1,1,1,1")
    assert answer.code == 2
    assert word in " ".join(answer.err.split())
    assert "Traceback" not in answer.err
