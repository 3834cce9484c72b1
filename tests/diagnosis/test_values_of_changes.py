"""When a difference is told: against zero, alone or together with what else is of the same cause."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynident.diagnosis.change_sizes import Estimates, yield_changes
from dynident.diagnosis.diagnosis_result import Change, RankedEffect
from dynident.effects import Column, EffectChoice
from dynident.estimation.parameter_covariance import Statistics
from dynident.robot import robot_from_library

SINCE = ("today",)


def told(
    effect: str,
    joints: tuple[str, ...],
    names: tuple[str, ...],
    values: Any,
    covariance: Any,
    beside: tuple[Column, ...] = (),
) -> list[Change]:
    link = joints[0] if joints else ""
    columns = (*(Column(effect, name, name, link, "-", ca.SX(1, 1), runs=SINCE) for name in names), *beside)
    statistics = Statistics(np.array(covariance), np.ones(1), np.ones(1), np.full(len(columns), 30.0))
    estimates = Estimates(robot_from_library("scara"), columns, np.array(values), statistics)
    choice = EffectChoice(effect, joints, (), SINCE)
    ranked = RankedEffect(1, choice, 0.2, 0.1, 0.5, 9.0, 0.001, True, "", (), 0.9)
    found: Any = SimpleNamespace(equal=())
    return list(yield_changes(estimates, found, ranked))


@pytest.mark.parametrize(("correlation", "is_told"), [(0.99, True), (0.0, False)])
def test_what_is_surely_there_though_no_parameter_by_itself_is_sure_is_told_as_that(
    correlation: float, is_told: bool
) -> None:
    covariance = np.array([[1.0, correlation], [correlation, 1.0]])
    changes = told("base_tilt", (), ("gx", "gy"), [1.0, -1.0], covariance)
    assert bool(changes) == is_told
    for change in changes:
        assert change.main.interval[0] < 0.0 < change.main.interval[1]
        assert "together they do" in change.evidence


def test_a_difference_that_may_as_well_be_none_is_not_told() -> None:
    joint = robot_from_library("scara").joint_names[0]
    assert not told("offset", (joint,), ("b",), [1.0], [[1.0]])
    (change,) = told("offset", (joint,), ("b",), [5.0], [[1.0]])
    assert "together" not in change.evidence


def test_a_difference_of_friction_that_follows_the_temperature_is_told_as_that_of_the_later_recordings() -> None:
    one, other = robot_from_library("scara").joint_names[:2]
    for joint, follows in ((one, True), (other, False)):
        warmth = Column("temperature_friction", "Fct", "Fct1", joint, "N m/K", ca.SX(1, 1))
        (change,) = told("coulomb", (one,), ("Fc",), [5.0, 0.1], np.eye(2), (warmth,))
        assert ("at the temperatures of the later recordings" in change.evidence) == follows
