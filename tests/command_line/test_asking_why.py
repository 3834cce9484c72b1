"""`--why effect@joint` asks a diagnosis why an effect is a finding or not."""

from __future__ import annotations

import pytest

from dynident.effects import UnknownEffectError
from dynident.errors import DynidentError
from dynident_cli.option_parsers import parse_effect_place

JOINTS = ("shoulder", "elbow")


def test_an_effect_and_its_joint_are_read():
    assert parse_effect_place("backlash@elbow", JOINTS) == ("backlash", "elbow")
    assert parse_effect_place(" backlash ", JOINTS) == ("backlash", "")


def test_what_does_not_exist_is_refused_with_what_does():
    with pytest.raises(DynidentError, match="the robot has no joint 'knee'; its joints are shoulder, elbow"):
        parse_effect_place("backlash@knee", JOINTS)
    with pytest.raises(UnknownEffectError) as caught:
        parse_effect_place("magic@elbow", JOINTS)
    assert caught.value.pointer == "--why"
