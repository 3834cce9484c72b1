"""What a recording hardly shows is not claimed: gravity that explains little, degrees in which nothing would move."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support.drawn_recordings import log

from dynident.identification.column_inference.dynamics_fits import DynamicsFits
from dynident.identification.column_inference.unit_inference import guess_position_unit
from dynident.identification.recording_faults import gravity_in_torque


@pytest.mark.parametrize(("left", "is_told"), [(0.05, True), (0.14, True), (0.2, False), (0.29, False)])
def test_a_direction_of_gravity_has_to_explain_the_torque(
    monkeypatch: pytest.MonkeyPatch, left: float, is_told: bool
) -> None:
    """Of a few seconds another direction may leave less than the stated one, and still most of what was wrong."""
    found = SimpleNamespace(unexplained=left, is_sure=True, explains=None, gravity=np.array([1.7, -3.1, -9.2]))
    now = SimpleNamespace(worst_share=0.38, is_surely_above=lambda other: True)
    judge = SimpleNamespace(measure_unexplained=lambda motion: now)
    for name, value in (
        ("thin_out", lambda motion: motion),
        ("find_mounting", lambda robot, motion: found),
        ("_do_masses_agree", lambda robot, motion, gravity: False),
        ("_find_mounting_by_masses", lambda robot, motion, now: None),
    ):
        monkeypatch.setattr(gravity_in_torque, name, value)
    mounting = gravity_in_torque.find_other_mounting(log("ur10", 1).robot, [(None, 5.0)], judge)  # type: ignore[arg-type, list-item]
    assert (mounting is found) == is_told


@pytest.mark.parametrize("reach", [3.6, 4.5, 5.5])
def test_numbers_of_a_few_radians_are_no_degrees(reach: float) -> None:
    given = log("ur10", 2)
    q = given.q * reach / np.ptp(given.q, axis=0).max()
    fits = DynamicsFits(given.robot, given.t)
    unit = guess_position_unit(given.robot, q, None, None, fits)
    assert unit is not None
    assert (unit.unit, unit.confidence) == ("rad", 0.9)
