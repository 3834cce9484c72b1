"""Recordings of real robots, and the choices to identify them."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynident.effects import EffectChoice
from dynident.identification import Identification, IdentificationChoices
from dynident.robot import Robot, robot_from_urdf

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
UR10E_GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
# Rows, counted from 1, between the standstills at both ends.
UR10E_ROWS = {
    "id_30s_12harm": (635, 3510),
    "id_40s_12harm": (500, 4460),
    "id_50s_12harm": (355, 5090),
    "val_ptp10": (700, 4200),
    "pair14_unloaded": (195, 4966),
}


def robot(name: str) -> Robot:
    return robot_from_urdf(name, (DATA / name / "robot.urdf").read_text(encoding="utf-8"))


def held_out(found: Identification) -> float:
    assert found.held_out is not None
    return found.held_out.relative_total
