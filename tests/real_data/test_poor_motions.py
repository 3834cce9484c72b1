"""Real arms whose motion does not determine the model: a prior, physical limits, and an honest no."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from dynident.effects import EffectChoice
from dynident.identification import IdentificationChoices, identify, payload_from_pair
from dynident.recordings import RecordedJoints, Recording, RecordingMetadata, import_recording
from dynident.robot import Robot, robot_from_urdf
from dynident.robot.pseudo_inertia import smallest_pseudo_inertia

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
pytestmark = [
    pytest.mark.real_data,
    pytest.mark.skipif(
        not (DATA / "kr300").is_dir(), reason="the recordings of real robots are not here (../shared/data is missing)"
    ),
]

PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
# Its hydraulic counterbalance pulls at the second axis.
COUNTERBALANCED = (*PLAIN, EffectChoice("gravity_compensator", ("joint2",)))
FLANGE = 17.78
"""Mass of the last link without payload, kg; its description adds a payload of 200 kg that was not there."""


def robot(name: str) -> Robot:
    return robot_from_urdf(name, (DATA / name / "robot.urdf").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings")

    def recording(arm: Robot, file: str) -> Recording:
        source, target = DATA / arm.name / f"{file}.parquet", folder / f"{arm.name}_{file}.parquet"
        return import_recording(source, target, RecordedJoints(arm.joint_names), metadata=RecordingMetadata(name=file))[
            0
        ]

    return recording


@pytest.fixture(scope="module")
def kr300(read):
    arm = robot("kr300")
    training, *validation = (read(arm, name) for name in ("id_A", "val_B", "val_C"))

    def identified(choices: IdentificationChoices):
        return [identify(arm, [training], [other], choices) for other in validation]

    return identified


FEASIBLE = IdentificationChoices(COUNTERBALANCED, estimator="feasible", prior="description", free_links=("joint6",))


@pytest.mark.parametrize("prior", ["description", "description_entropic"])
def test_a_kr300_is_predicted_with_the_prior_and_a_free_payload(kr300, prior):
    # Ordinary least squares: 42 and 47 %; drawings and payload by hand: 15.5 and 15.2 %.
    for found in kr300(replace(FEASIBLE, prior=prior)):
        assert found.held_out.relative_total <= 0.156
        assert found.inertia_matrix_positive_definite
        assert smallest_pseudo_inertia(found.estimate.standard.to_inertias(found.model)).min() > 0
        assert any("the motion alone does not determine the model" in warning for warning in found.warnings)
        assert any("determine these parameters less than the prior does" in warning for warning in found.warnings)


def test_limits_of_physics_alone_already_tame_a_kr300(kr300):
    for found in kr300(replace(FEASIBLE, prior=None, free_links=())):
        assert found.held_out.relative_total < 0.156
        assert found.inertia_matrix_positive_definite


def test_the_payload_of_a_kr300_is_within_its_wide_interval(kr300):
    """150 kg: ten seconds of a small motion tell it to within a sixth, and the interval says so."""
    found, _ = kr300(FEASIBLE)
    place = [column.name for column in found.model.columns].index("M6")
    mass = found.estimate.standard.values[place] - FLANGE
    deviation = found.estimate.standard.standard_deviations[place]
    assert abs(mass - 150.0) < 1.96 * deviation
    assert abs(mass - 150.0) < 20.0
    # The description, payload and all, is not believed of the last link.
    assert deviation > 3.0


def test_the_payload_of_an_airbot_play_is_not_identifiable_from_its_motion_and_gets_no_number(read):
    """It was 0.48 kg; least squares would say 0.25 ± 0.03 kg."""
    arm = robot("airbot_play")
    found = payload_from_pair(arm, [read(arm, "id_chirp_unloaded")], read(arm, "chirp_loaded"))
    assert not found.identifiable
    assert found.mass is None
    assert "not identifiable from this motion" in found.reason
    assert "friction or offset" in found.reason
