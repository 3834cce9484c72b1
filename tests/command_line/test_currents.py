"""`dynident currents`: what every joint's current is made of, where nobody knows a drive gain."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque
from support.running_commands import dynident

ARM = arm("scara")
GAINS = np.array([14.0, 12.5, 80.0, 1.5])
COULOMB, VISCOUS = 4.0, 3.0


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("currents")
    paths = folder / "fit.csv", folder / "other.csv"
    for seed, path in enumerate(paths):
        motion = fourier_motion(ARM, 20.0, 100.0, seed)
        torque = pinocchio_torque(ARM, motion.q, motion.dq, motion.ddq)
        torque += COULOMB * np.sign(motion.dq) + VISCOUS * motion.dq
        current = torque / GAINS + np.random.default_rng(seed).normal(0.0, 0.005, torque.shape)
        columns = {"t": motion.t}
        for j in range(ARM.n):
            columns |= {f"q{j + 1}": motion.q[:, j], f"current{j + 1}": current[:, j]}
        pacsv.write_csv(pa.table(columns), path)
    return paths


def test_currents_are_predicted_and_their_friction_told_without_any_gain(runs: tuple[Path, Path]) -> None:
    fit, other = runs
    answer = dynident("currents", "scara", fit, "--validation", other, "--json")
    assert answer.code == 0, answer.err
    for joint, gain in zip(answer.document["joints"], GAINS, strict=True):
        assert joint["held_out_relative"] < 0.1
        told = {one["name"].rstrip("1234"): one for one in joint["parameters"]}
        for name, true in (("Fc", COULOMB), ("Fv", VISCOUS)):
            low, high = told[name]["interval"]
            width = high - low
            assert low - width < true / gain < high + width, (joint["joint"], name)
            assert told[name]["unit"].endswith(("A/(N m)", "A/(N)"))


def test_stated_gains_that_are_wrong_change_nothing(runs: tuple[Path, Path]) -> None:
    fit, _ = runs
    without = dynident("currents", "scara", fit, "--json").document["joints"]
    wrong = dynident("currents", "scara", fit, "--drive-gains", "3,70,2,9", "--json").document["joints"]
    for one, other in zip(without, wrong, strict=True):
        values = [[p["value"] for p in each["parameters"]] for each in (one, other)]
        assert values[0] == pytest.approx(values[1], rel=1e-6, abs=1e-9)
        assert one["rms"] == pytest.approx(other["rms"], rel=1e-6)


def test_tables_and_a_file_tell_the_same(runs: tuple[Path, Path], tmp_path: Path) -> None:
    fit, other = runs
    answer = dynident("currents", "scara", fit, "-v", other, "--out", tmp_path / "currents.json")
    assert answer.code == 0, answer.err
    assert "held out," in answer.out
    # Currents are not torques of another scale.
    assert "torque scale" not in answer.out
    kept = json.loads((tmp_path / "currents.json").read_text(encoding="utf-8"))["joints"]
    assert [one["joint"] for one in kept] == list(ARM.joint_names)


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ("default,load_dependent_friction", "without the gains"),
        ("default,stribeck", "does not search for: give vs"),
        ("default,payload", "leave it out"),
    ],
)
def test_effects_that_no_current_shows_are_refused_with_the_reason(
    runs: tuple[Path, Path], effects: str, words: str
) -> None:
    answer = dynident("currents", "scara", runs[0], "--effects", effects)
    assert answer.code == 2
    assert words in " ".join(answer.err.split())


def test_what_the_description_does_not_say_is_heeded(runs: tuple[Path, Path]) -> None:
    for option, said in (("--gravity", "0,0"), ("--lock", "nobody")):
        refused = dynident("currents", "scara", runs[0], option, said)
        assert refused.code == 2
        assert said in refused.err
