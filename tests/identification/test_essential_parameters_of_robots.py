"""Essential parameters of an arm whose small ones are hidden by noise, and intervals beside the estimates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, from_bytes, identify, to_bytes
from dynident.identification.identified_models.correlated_and_essential_parameters import essential_parameters
from dynident.recordings import Preprocessing

ROBOT = arm("ur10")
NAMES = ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset")
DRIVES = np.vstack([np.random.default_rng(0).uniform(0.5, 5.0, (3, 6)), np.zeros((1, 6))])


def recorded(duration: float, seed: int):
    m = fourier_motion(ROBOT, duration, 100.0, seed)
    ia, fc, fv, _ = DRIVES
    tau = pinocchio_torque(ROBOT, m.q, m.dq, m.ddq) + ia * m.ddq + fc * np.sign(m.dq) + fv * m.dq
    return record(ROBOT, m, tau + np.random.default_rng(seed).normal(size=tau.shape), f"run {seed}")


@pytest.fixture(scope="module")
def identified():
    choices = IdentificationChoices(
        effects=tuple(EffectChoice(name) for name in NAMES), preprocessing=Preprocessing(10.0, 8.0, 3)
    )
    return identify(ROBOT, [recorded(25.0, 1)], [recorded(12.0, 2)], choices)


@pytest.fixture(scope="module")
def path(identified):
    return essential_parameters(identified)


def test_offsets_that_are_not_there_are_not_essential(path):
    gone = {step.name for step in path.steps}
    assert len(gone & {f"b{k}" for k in range(1, 7)}) >= 5
    assert not gone & {f"Fc{k}" for k in range(1, 7)}
    assert len(path.essential) + len(path.steps) == path.identification.model.n_parameters


def test_the_held_out_error_along_the_way_hardly_rises(identified, path):
    errors = [step.held_out.relative_total for step in path.steps]
    assert max(errors) < 1.02 * identified.held_out.relative_total
    assert path.identification.held_out.relative_total == pytest.approx(errors[-1], rel=1e-3)
    assert path.identification.fit.relative_total >= identified.fit.relative_total * (1 - 1e-9)


def test_every_step_is_one_that_noise_explains_and_the_reason_is_said(path):
    assert all(step.p_value >= 0.05 for step in path.steps)
    assert all(step.ratio >= 10 for step in path.steps)
    assert f"{len(path.essential)} of" in path.reason


def test_what_is_not_essential_is_zero_for_certain_and_marked_also_after_storing(path):
    for found in (path.identification, from_bytes(to_bytes(path.identification))):
        gone = [p for p in found.parameters if not p.essential]
        assert {p.name for p in gone} == {step.name for step in path.steps}
        assert all(p.value == 0.0 and p.standard_deviation == 0.0 for p in gone)
        assert all(p.standard_deviation > 0 for p in found.parameters if p.essential)


def test_essential_parameters_are_known_better_than_before(identified, path):
    before = {p.name: p.standard_deviation for p in identified.parameters}
    after = [(p.standard_deviation, before[p.name]) for p in path.identification.parameters if p.essential]
    assert np.median([new / old for new, old in after]) < 0.95


def test_a_ratio_that_cannot_be_is_refused(identified):
    with pytest.raises(DynidentError, match="above 1") as caught:
        essential_parameters(identified, ratio=0.5)
    assert caught.value.pointer == "/ratio"


def test_intervals_are_those_of_students_distribution_with_each_parameters_own_freedom(identified):
    for parameter, freedom in zip(identified.parameters, identified.statistics.freedom, strict=True):
        low, high = stats.t.interval(0.95, freedom, parameter.value, parameter.standard_deviation)
        assert parameter.interval == pytest.approx((low, high))
