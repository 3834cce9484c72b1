"""The validations of §12.7 on real arms: what is known of them is found, what is not is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from dynident.effects import EffectChoice
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import RecordedJoints, Recording, RecordingMetadata, import_recording
from dynident.robot import Robot, robot_from_urdf
from dynident.validation import (
    Method,
    validate_cross,
    validate_inertia_matrix,
    validate_methods,
    validate_payload,
    validate_simulation,
)

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
pytestmark = [
    pytest.mark.real_data,
    pytest.mark.skipif(
        not (DATA / "ur10e").is_dir(), reason="the recordings of real robots are not here (../shared/data is missing)"
    ),
]

CHOICES = IdentificationChoices(
    tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
)
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
# Rows, counted from 1, between the standstills at both ends.
ROWS = {
    "id_30s_12harm": (635, 3510),
    "id_50s_12harm": (355, 5090),
    "pair14_unloaded": (195, 4966),
    "pair14_loaded": (308, 5071),
}
LOAD = 2.805


def robot(name: str) -> Robot:
    return robot_from_urdf(name, (DATA / name / "robot.urdf").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings")

    def recording(arm: Robot, file: str, gains=None, **more) -> Recording:
        source, windows = DATA / arm.name / f"{file}.parquet", ()
        if arm.name == "ur10e":
            t = pq.read_table(source, columns=["t"])["t"].to_numpy()
            windows = ((t[ROWS[file][0] - 1], t[ROWS[file][1] - 1]),)
        metadata = RecordingMetadata(name=file, windows=windows, **more)
        target = folder / f"{arm.name}_{file}.parquet"
        return import_recording(source, target, RecordedJoints(arm.joint_names, gains=gains), metadata=metadata)[0]

    return recording


@pytest.fixture(scope="module")
def ur10e(read):
    arm = robot("ur10e")
    training, unseen = (read(arm, name, GAINS) for name in ("id_30s_12harm", "id_50s_12harm"))
    return identify(arm, [training], [unseen], CHOICES), training, unseen


def test_a_ur10e_passes_cross_validation_and_has_a_positive_definite_inertia_matrix(ur10e):
    model, _, unseen = ur10e
    assert validate_cross(model, [unseen], limit=0.05).judged.verdict == "pass"
    assert validate_inertia_matrix(model).judged.verdict == "pass"


@pytest.mark.slow
def test_a_simulated_ur10e_needs_the_recorded_torque(ur10e):
    model, _, unseen = ur10e
    found = validate_simulation(model, unseen, longest=10.0)
    assert found.judged.verdict == "pass"
    assert found.torque.relative_total < 0.05


def test_methods_agree_on_a_ur10e_and_the_sequential_strategies_cost_little(ur10e):
    model, training, unseen = ur10e
    methods = [
        Method(),
        Method(estimator="ols"),
        Method(model="filtered"),
        Method(strategy="sequential"),
        Method(strategy="sequential", steps="wrist_then_shoulder"),
    ]
    table = validate_methods(model, [training], [unseen], methods)
    assert table.judged.verdict == "pass"
    reference = table.results[0].held_out.relative_total
    for row in table.results[1:]:
        assert row.held_out.relative_total < 1.15 * reference


def test_the_known_load_of_a_ur10e_tells_that_its_gains_are_a_tenth_too_high(read):
    arm = robot("ur10e")
    unloaded = read(arm, "pair14_unloaded", GAINS)
    loaded = read(arm, "pair14_loaded", GAINS, payload={"mass": LOAD})
    found = validate_payload(identify(arm, [unloaded], [], CHOICES), [unloaded], loaded)
    assert found.judged.verdict == "fail"
    assert 3.0 < found.weighed.mass < 3.15
    assert "gains are probably too high" in found.judged.reason


def test_the_load_of_an_airbot_play_is_not_evaluated_and_the_reason_is_friction(read):
    arm = robot("airbot_play")
    unloaded = read(arm, "id_chirp_unloaded")
    loaded = read(arm, "chirp_loaded", payload={"mass": 0.48})
    found = validate_payload(identify(arm, [unloaded], [], CHOICES), [unloaded], loaded)
    assert found.judged.verdict == "not_evaluated"
    assert "friction" in found.judged.reason
    assert found.weighed.mass is None


def test_a_kr300_whose_motion_is_too_small_fails_by_a_posture(read):
    arm = robot("kr300")
    model = identify(arm, [read(arm, "id_A")], [], replace(CHOICES, estimator="wls"))
    found = validate_inertia_matrix(model)
    assert found.judged.verdict == "fail"
    assert found.smallest_eigenvalue < 0
    assert validate_cross(model, [read(arm, "val_B")]).judged.verdict == "fail"
