"""Data show a torque over the position, not a spring: diagnoses ask for the part, and use the answer."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from io import StringIO

import numpy as np
import pytest
from rich.console import Console
from support.hidden_effects import NAMES, ROBOT, WITH_OFFSET, Experiment, experiment, on_joint

import dynident as dy
from dynident.diagnosis import Diagnosis, DiagnosisChoices, diagnose
from dynident.effects import CATALOGUE
from dynident.errors import DynidentError
from dynident.identification import identify
from dynident.robot.description_and_json import robot_from_document, robot_to_document
from dynident.robot.limits_and_drives import HARDWARE, check_hardware
from dynident_cli.printed_results import show_diagnosis

SPRING = "gravity_compensator"


def balancer(q, v, load):
    """A spring on a crank of 0.6 of the distance of its foot, slack at 0.6, in line at 0.3 rad."""
    length = np.sqrt(1 + 0.6**2 + 2 * 0.6 * np.cos(q - 0.3))
    return -150.0 * np.sin(q - 0.3) * (1 - 0.6 / length)


@cache
def hidden() -> Experiment:
    return experiment(on_joint(1, balancer), WITH_OFFSET, 3)


@cache
def diagnosed(has: bool | None = None) -> Diagnosis:
    parts = (SPRING,)
    choices = None if has is None else DiagnosisChoices(has=parts) if has else DiagnosisChoices(has_not=parts)
    return diagnose(hidden().identification, [hidden().training], choices)


def test_a_torque_over_the_position_is_told_as_that_and_the_part_is_asked_for():
    diagnosis = diagnosed()
    (choice,) = diagnosis.recommended
    assert (choice.effect, choice.joints) == (SPRING, (NAMES[1],))
    assert (
        f"The model lacks: Torque over the position (gravity compensating spring?) on {NAMES[1]}" in diagnosis.summary
    )
    (question,) = diagnosis.questions
    assert question in diagnosis.summary
    assert HARDWARE[SPRING] in question
    assert diagnosis.find_question(choice) == question
    printed = StringIO()
    show_diagnosis(Console(file=printed, width=200), diagnosis, ROBOT, "")
    assert f"--has {SPRING} or --has-not {SPRING}" in printed.getvalue()


def test_a_part_that_is_there_is_named():
    diagnosis = diagnosed(has=True)
    assert diagnosis.recommended == diagnosed().recommended
    assert diagnosis.questions == ()
    assert f"The model lacks: Gravity compensating spring on {NAMES[1]}" in diagnosis.summary


def test_a_part_that_is_not_there_is_not_proposed():
    diagnosis = diagnosed(has=False)
    assert all(item.effect != SPRING for item in diagnosis.candidates)
    assert diagnosis.verdict != "adequate"
    assert (
        str(diagnosis.why_not(SPRING, NAMES[1]))
        == "Not tried: the robot has no such part (has_not gravity_compensator)."
    )


def test_what_the_robot_states_counts_until_a_request_says_otherwise():
    robot, run = replace(ROBOT, has_not=(SPRING,)), hidden()
    stated = identify(robot, [run.training], [run.validation], run.identification.choices)
    assert diagnose(stated, [hidden().training]).recommended == diagnosed(has=False).recommended
    assert diagnose(stated, [hidden().training], DiagnosisChoices(has=(SPRING,))).recommended == diagnosed().recommended


def test_every_part_has_an_effect_and_every_effect_of_a_part_says_what_the_data_show():
    parts = {effect.hardware: effect for effect in CATALOGUE.values() if effect.hardware}
    assert set(parts) == set(HARDWARE)
    assert all(effect.appearance for effect in parts.values())


def test_a_robot_keeps_its_parts_in_a_file():
    robot = replace(ROBOT, has=("cable",), has_not=(SPRING, "coupled_wrist"))
    again = robot_from_document(robot_to_document(robot))
    assert (again.has, again.has_not) == (robot.has, robot.has_not)


@pytest.mark.parametrize(
    ("stated", "pointer"),
    [
        ({"has": ["balancer"]}, "/has/0"),
        ({"has_not": ["cable", "ballast"]}, "/has_not/1"),
        ({"has": ["cable"], "has_not": ["cable"]}, "/has_not/0"),
    ],
)
def test_parts_that_cannot_be_are_named(stated, pointer):
    with pytest.raises(DynidentError) as raised:
        check_hardware(**{"has": [], "has_not": [], **stated})
    assert raised.value.pointer == pointer
    with pytest.raises(DynidentError, match="There is no hardware 'balancer'; the names are: gravity_compensator"):
        dy.load_robot("ur10", hardware={"balancer": False})


def test_a_robot_file_states_its_parts_and_arguments_replace_them(tmp_path):
    content = dy.load_robot("scara").description.content
    path = tmp_path / "robot.json"
    path.write_text(
        '{"description": {"format": "modified_dh", "content": '
        + content
        + '}, "has": ["cable"], "has_not": ["spring"]}'
    )
    assert dy.load_robot(path).has == ("cable",)
    changed = dy.load_robot(path, hardware={"cable": False})
    assert (changed.has, set(changed.has_not)) == ((), {"cable", "spring"})


def test_the_command_line_states_parts():
    from dynident_cli.argument_loading import load_robot_argument
    from dynident_cli.shared_options import RobotAdditions

    robot = load_robot_argument("ur10", RobotAdditions(has="cable", has_not="spring, gravity_compensator"))
    assert robot.hardware == {"cable": True, "spring": False, "gravity_compensator": False}
    with pytest.raises(DynidentError, match="'cable' is in has and in has_not"):
        load_robot_argument("ur10", RobotAdditions(has="cable", has_not="cable"))
