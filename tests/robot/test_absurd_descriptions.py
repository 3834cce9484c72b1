"""Any number of a description may be absurd: the robot is read, or refused in words."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator

import pytest
from support.one_joint_robots import one_joint_urdf

from dynident.effects import EffectChoice, Signals, build_columns
from dynident.errors import DynidentError
from dynident.regressors.base_parameters import find_base_parameters
from dynident.robot import Description, Robot, robot_from_description
from dynident.robot.collision_reader import collision_geometry

ABSURD = ("1e300", "1e160", "1e-300", "inf", "-inf", "nan", "-1", "0", str(2**70), "1e999")
_NUMBER = re.compile(r'(?<=[" \[:,])-?\d+\.?\d*(?=[" \],}])')

MJCF = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody><body name="b" pos="0 0 0.5">
<joint name="axis" type="hinge" axis="0 1 0" range="-2.5 2.5"/><geom type="box" size="0.1 0.2 0.3" mass="3"/>
<geom type="capsule" fromto="0 0 0 0.1 0 0.2" size="0.05" density="1000"/><body name="c" pos="0.3 0 0">
<inertial pos="0.1 0 0" mass="1.5" diaginertia="0.05 0.06 0.04"/><geom type="sphere" size="0.07"/>
<joint name="two" type="slide" axis="1 0 0" range="-0.4 0.4" armature="0.01" damping="0.2"/></body></body></worldbody>
<actuator><motor joint="axis" gear="50" ctrlrange="-3 3" ctrllimited="true"/></actuator></mujoco>"""
URDF = one_joint_urdf("pendulum").replace(
    "</inertial>",
    '</inertial><collision><origin xyz="0.1 0 0" rpy="0.1 0 0"/><geometry><box size="0.1 0.2 0.3"/></geometry>'
    '</collision><collision><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>',
)
MASS = {"mass": 3.0, "center_of_mass": [0.1, 0.2, 0.0], "inertia": [0.1, 0.01, 0.01, 0.1, 0.01, 0.1]}
ROW = {"name": "axis", "alpha": 0.3, "d": 0.2, "r": 0.1, "limits": {"position": [-2, 2], "velocity": 2.0}}
TABLE = json.dumps({"gravity": [0, 0, -9.81], "joints": [ROW | {"mass_properties": MASS}]})


def mutants(text: str) -> Iterator[str]:
    for found in _NUMBER.finditer(text):
        for number in ABSURD:
            yield text[: found.start()] + number + text[found.end() :]


def as_text(text: str) -> str:
    return text


def as_json(text: str) -> str:
    return re.sub(r"\binf\b", "Infinity", text.replace("nan", "NaN"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("format", "text", "written"), [("urdf", URDF, as_text), ("mjcf", MJCF, as_text), ("modified_dh", TABLE, as_json)]
)
def test_every_number_of_a_description_may_be_absurd(format: str, text: str, written: Callable[[str], str]) -> None:
    refused = read = 0
    for mutant in mutants(text):
        try:
            robot = robot_from_description("robot", Description(format, written(mutant)))
            assert isinstance(robot, Robot)
            signals = Signals(robot)
            find_base_parameters(robot, build_columns([EffectChoice("rigid_body")], signals), signals)
            collision_geometry(robot)
            read += 1
        except DynidentError as error:
            assert error.detail  # noqa: PT017
            refused += 1
    assert refused > 20
    assert read > 20
