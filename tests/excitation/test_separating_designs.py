"""Designs for chosen parameters, for effects to be told apart, and motions of one joint at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.errors import DynidentError
from dynident.excitation import CriterionChoice, Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.motion import ImpossibleLimitsError, Surroundings
from dynident.regressors.model_structure import build_model
from dynident.robot import Robot

BASE = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
PEAK = EffectChoice("stribeck", ("elbow",), (("vs", 0.2),))
BEND = EffectChoice("viscous_nonlinear", ("elbow",), (("p", 2.0),))
SHORT = TrajectoryRequest(duration=5.0, harmonics=4, sampling_rate=200.0)
QUICK = DesignRequest(effects=BASE, trajectory=SHORT, starts=1, random_trajectories=15)


def observed(robot: Robot, design: Design, effects: tuple[EffectChoice, ...]) -> tuple[np.ndarray, tuple[str, ...]]:
    """W of the exciting part, by the observation matrix of identification."""
    model = build_model(robot, effects)
    first, last = (round(at * design.sampling_rate) for at in design.exciting)
    q, dq, ddq = (signal[first:last] for signal in (design.q, design.dq, design.ddq))
    assert robot.inertias is not None
    reference = ReferenceParameters.from_links(robot.inertias.astype(float), robot.n)
    entries = model.observation.evaluate(q, dq, ddq, reference=reference, memory=np.zeros((len(q), 0)))
    w = np.zeros((len(q), robot.n, model.n_parameters))
    w[:, model.observation.entry_rows, model.observation.entry_columns] = entries
    return w.reshape(-1, model.n_parameters), tuple(column.name for column in model.kept)


def left_over(w: np.ndarray, column: int) -> float:
    """Norm of what all other columns cannot make of one column."""
    others = np.delete(w, column, axis=1)
    return float(np.linalg.norm(w[:, column] - others @ np.linalg.lstsq(others, w[:, column], rcond=None)[0]))


def test_rivals_are_told_apart_better_by_a_motion_designed_for_it(scara):
    separation = CriterionChoice("separation", effects=(PEAK, BEND))
    anywhere = replace(QUICK, surroundings=Surroundings(assume_floor=False))
    design = design_experiment(scara, replace(anywhere, criterion=separation))
    plain = design_experiment(scara, replace(anywhere, effects=(*BASE, PEAK, BEND)))
    assert design.baseline is not None
    assert design.criterion_values.criterion < design.baseline.best.criterion
    assert {"Fst2", "Fvn2"} <= set(design.parameter_names)
    (w, names), (ordinary, _) = (observed(scara, one, (*BASE, PEAK, BEND)) for one in (design, plain))
    gains = [left_over(w, k) / left_over(ordinary, k) for k in (names.index("Fst2"), names.index("Fvn2"))]
    assert np.prod(gains) > 1.5
    assert min(gains) > 0.9


def test_predicted_shares_and_deviations_are_those_of_least_squares(scara):
    noise = {"shoulder": 0.5, "elbow": 0.2, "quill": 1.0, "tool_roll": 0.05}
    design = design_experiment(scara, replace(QUICK, kind="random", effects=(*BASE, PEAK), noise=noise))
    w, names = observed(scara, design, (*BASE, PEAK))
    weighted = w / np.tile([noise[joint] for joint in design.joint_names], len(w) // 4)[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    assert [one.name for one in design.expected] == list(names)
    for k, one in enumerate(design.expected):
        assert one.standard_deviation == pytest.approx(np.sqrt(covariance[k, k]), rel=0.02)
        assert one.share == pytest.approx(left_over(weighted, k) / np.linalg.norm(weighted[:, k]), rel=0.02)


def test_chosen_parameters_come_out_with_smaller_deviations(scara):
    chosen = ("Fv1", "Fv2")
    design = design_experiment(scara, replace(QUICK, criterion=CriterionChoice("parameters", parameters=chosen)))
    ordinary = design_experiment(scara, QUICK)

    def sum_of_variances(one: Design) -> float:
        w, names = observed(scara, one, BASE)
        covariance = np.linalg.inv(w.T @ w)
        return sum(covariance[names.index(name), names.index(name)] for name in chosen)

    assert sum_of_variances(design) < sum_of_variances(ordinary)


@pytest.mark.parametrize(
    ("criterion", "pointer", "match"),
    [
        (CriterionChoice("parameters"), "/criterion/parameters", "name the parameters"),
        (CriterionChoice("parameters", parameters=("Fv9",)), "/criterion/parameters", "no base parameter Fv9.*Fv1"),
        (CriterionChoice("separation"), "/criterion/effects", "name the effects"),
        (
            CriterionChoice("separation", effects=(PEAK, EffectChoice("offset", ("elbow",)))),
            "/criterion/effects/1",
            "no motion can distinguish offset",
        ),
    ],
)
def test_a_criterion_without_what_it_is_about_is_refused(scara, criterion, pointer, match):
    with pytest.raises(DynidentError, match=match) as caught:
        # A spring has an offset of its own.
        design_experiment(scara, replace(QUICK, effects=(*BASE, EffectChoice("joint_spring")), criterion=criterion))
    assert caught.value.pointer == pointer


def test_a_noise_that_is_none_is_refused(scara):
    with pytest.raises(DynidentError, match=r"noise of elbow is .*; it must be 1e-09 to") as caught:
        design_experiment(scara, replace(QUICK, noise={"elbow": 0.0}))
    assert caught.value.pointer == "/noise/elbow"


def test_a_slow_sweep_takes_one_joint_over_its_whole_range_both_ways(scara):
    trajectory = TrajectoryRequest(duration=20.0, sampling_rate=100.0, joints=("elbow",))
    design = design_experiment(scara, DesignRequest(kind="slow_sweep", trajectory=trajectory))
    low, high = scara.joints[1].limits.position
    assert np.ptp(design.q[:, 1]) == pytest.approx(min(0.98 * (high - low), 2 * np.pi), rel=1e-4)
    assert np.ptp(np.delete(design.q, 1, axis=1), axis=0).max() == 0
    first, last = (round(at * 100) for at in design.exciting)
    speed = np.ptp(design.q[:, 1]) / 20.0
    for sign in (1, -1):
        assert np.mean(np.abs(design.dq[first:last, 1] - sign * speed) < 1e-6) > 0.45


def test_reversals_go_back_and_forth_by_the_amplitudes_asked_for(scara):
    trajectory = TrajectoryRequest(
        sampling_rate=200.0, joints=("shoulder",), amplitudes=(0.01, 0.04), speeds=(0.01,), periods=3
    )
    design = design_experiment(scara, DesignRequest(kind="reversals", trajectory=trajectory))
    turns = np.flatnonzero(np.diff(np.sign(design.dq[np.abs(design.dq[:, 0]) > 1e-9, 0])))
    moving = design.q[np.abs(design.dq[:, 0]) > 1e-9, 0]
    strokes = np.abs(np.diff(moving[turns]))
    for amplitude in (0.01, 0.04):
        assert np.sum(np.abs(strokes - amplitude) < 1e-3) >= 4


def test_a_path_is_repeated_at_every_pace(scara):
    design = design_experiment(scara, replace(QUICK, kind="random", trajectory=replace(SHORT, paces=(1.0, 0.4))))
    first, last = (round(at * 200) for at in design.exciting)
    q = design.q[first:last]
    assert len(q) == 1000 + 2500
    fast, slow = q[:1000], q[1000:]
    np.testing.assert_allclose(slow[::5], fast[::2], atol=1e-9)
    assert np.abs(design.dq[first + 1000 : last]).max() == pytest.approx(
        0.4 * np.abs(design.dq[first : first + 1000]).max(), rel=1e-4
    )
    assert design.period is None


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"joints": ("nose",)}, "/trajectory/joints"),
        ({"amplitudes": (-0.1,)}, "/amplitudes/0"),
        ({"speeds": (1.5,)}, "/speeds/0"),
        ({"paces": (0.0,)}, "/paces/0"),
    ],
)
def test_a_motion_that_cannot_be_is_refused_where_it_is_asked_for(scara, change, pointer):
    with pytest.raises(DynidentError) as caught:
        design_experiment(scara, DesignRequest(kind="reversals", trajectory=TrajectoryRequest(**change)))
    assert caught.value.pointer == pointer


def test_an_amplitude_beyond_the_range_is_refused_with_the_range(scara):
    trajectory = TrajectoryRequest(amplitudes=(50.0,))
    with pytest.raises(ImpossibleLimitsError, match=r"shoulder.*its range is"):
        design_experiment(scara, DesignRequest(kind="reversals", trajectory=trajectory))
