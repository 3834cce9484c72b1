"""`--why effect@joint` asks a diagnosis why an effect is a finding or not; `--limits` what would have shown."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import pytest
from typer.testing import CliRunner

from dynident.diagnosis.diagnosis_result import DetectionLimit, Diagnosis
from dynident.effects import UnknownEffectError
from dynident.errors import DynidentError
from dynident.presentation.diagnosis_tables import build_limits_by_joint_table
from dynident_cli.option_parsers import parse_effect_place
from dynident_cli.program_and_exit_codes import create_application

JOINTS = ("shoulder", "elbow")


def test_an_effect_and_its_joint_are_read():
    assert parse_effect_place("backlash@elbow", JOINTS) == ("backlash", "elbow")
    assert parse_effect_place(" backlash ", JOINTS) == ("backlash", "")


def test_what_does_not_exist_is_refused_with_what_does():
    with pytest.raises(DynidentError, match=r"There is no joint 'knee'\. The joints are: shoulder, elbow"):
        parse_effect_place("backlash@knee", JOINTS)
    with pytest.raises(UnknownEffectError) as caught:
        parse_effect_place("magic@elbow", JOINTS)
    assert caught.value.pointer == "--why"


def test_limits_are_listed_joint_by_joint():
    limits = (
        DetectionLimit("offset", ("elbow",), "b2", "N m", size=0.1, half_size=0.05, usual=0.5),
        DetectionLimit("cable_force", (), "k1", "-", size=math.inf, half_size=math.inf, usual=1.0),
    )
    rows = build_limits_by_joint_table(cast(Diagnosis, SimpleNamespace(detection_limits=limits, changes=None))).texts
    assert rows[0][1:] == ["elbow", "b2", "0.100 N m", "20\u202f%"]
    assert rows[1][1:] == ["the whole robot", "k1", "–", "–"]


def test_limits_are_an_option_of_the_diagnosis():
    assert "--limits" in CliRunner().invoke(create_application("diagnose"), ["diagnose", "--help"]).output
