"""Friction from runs of single joints, then the inertial parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.noise_free_data import drawn_standard, torque_of
from support.oracles import Motion, arm, crooked_urdf, fourier_motion, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, extend, identify
from dynident.identification.strategies.separate_friction import find_sole_mover
from dynident.recordings import Preprocessing
from dynident.robot import robot_from_urdf

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
UR10 = arm("ur10")
CROOKED = robot_from_urdf("crooked", crooked_urdf(4, 3, (2,)))
RATE = 200.0
WIDE = Preprocessing(None, None, 2)
BAND = Preprocessing(15.0, 10.0, 4)
NOISE = 0.3


def strokes(robot, joint: int, speeds=(0.1, 0.3, 0.6, -0.6, -0.3, -0.1), home: float = 0.4, seconds=1.5) -> Motion:
    """One joint at constant speeds, with short ramps between them; the others stand still."""
    ramp = round(0.3 * RATE)
    velocity = [np.zeros(20)]
    for before, now in zip((0.0, *speeds), (*speeds, 0.0), strict=True):
        velocity.append(before + (now - before) * 0.5 * (1 - np.cos(np.pi * np.arange(ramp) / ramp)))
        velocity.append(np.full(round(seconds * RATE), now))
    dq = np.concatenate(velocity)
    t = np.arange(len(dq)) / RATE
    q, dqs, ddqs = (np.zeros((len(t), robot.n)) for _ in range(3))
    q[:] = np.linspace(home, -home, robot.n)
    q[:, joint] += np.cumsum(dq) / RATE
    dqs[1:-1] = 0.5 * RATE * (q[2:] - q[:-2])
    ddqs[1:-1] = RATE**2 * (q[2:] - 2 * q[1:-1] + q[:-2])
    return Motion(t, q, dqs, ddqs)


def friction_tests(robot, standard, joints=None, noise: float = 0.0, seed: int = 0, role="friction", **more) -> list:
    rng = np.random.default_rng(seed)
    made = []
    for joint in range(robot.n) if joints is None else joints:
        motion = strokes(robot, joint, **more)
        tau = torque_of(robot, motion, standard) + noise * rng.normal(size=motion.q.shape)
        made.append(replace(record(robot, motion, tau, f"joint{joint + 1}"), role=role))
    return made


def whole_motion(robot, standard, noise: float = 0.0, seed: int = 7, duration: float = 15.0):
    motion = fourier_motion(robot, duration, RATE, seed, base_frequency=0.08, amplitude=2.0)
    tau = torque_of(robot, motion, standard) + noise * np.random.default_rng(seed).normal(size=motion.q.shape)
    return record(robot, motion, tau, "whole")


def choices(**more) -> IdentificationChoices:
    return IdentificationChoices(**{"effects": EFFECTS, "strategy": "separate_friction", "preprocessing": BAND, **more})


def friction_of(found) -> dict[str, float]:
    return {p.name: p.value for p in found.parameters if p.effect in ("coulomb", "viscous")}


@pytest.mark.parametrize("robot", [UR10, CROOKED], ids=["ur10", "crooked"])
def test_exact_torque_gives_the_true_friction_and_base_parameters(robot):
    standard = drawn_standard(robot)
    runs = [whole_motion(robot, standard, duration=25.0), *friction_tests(robot, standard)]
    found = identify(robot, runs, [], choices(preprocessing=WIDE))
    truth = found.model.base.grouping @ standard
    friction = np.array([c.effect in ("coulomb", "viscous") for c in found.model.kept])
    np.testing.assert_allclose(found.values[friction], truth[friction], rtol=1e-5)
    assert np.abs(found.values - truth).max() < 1e-4 * np.abs(truth).max()


def test_friction_keeps_what_its_own_runs_say_and_gravity_need_not_be_known():
    """The whole robot's motion has other friction, and the tests another tool: neither changes the answer."""
    standard = drawn_standard(UR10)
    heavier = standard.copy()
    heavier[59] += 3.0
    other = standard.copy()
    other[66:78] *= 1.5
    names = [f"{kind}{j + 1}" for kind in ("Fc", "Fv") for j in range(6)]
    little = 0.01
    runs = [whole_motion(UR10, other, little), *friction_tests(UR10, heavier, noise=little)]
    friction = friction_of(identify(UR10, runs, [], choices(preprocessing=WIDE)))
    np.testing.assert_allclose([friction[name] for name in names], standard[66:78], rtol=5e-3)
    together = friction_of(identify(UR10, [whole_motion(UR10, other)], [], choices(strategy="global")))
    assert abs(together["Fc1"] - other[66]) < abs(together["Fc1"] - standard[66])


@pytest.mark.slow
def test_intervals_of_friction_and_of_what_follows_cover_the_truth():
    standard = drawn_standard(UR10)
    hits, first = [], None
    for seed in range(25):
        tests = friction_tests(UR10, standard, noise=NOISE, seed=seed)
        found = identify(UR10, [whole_motion(UR10, standard, NOISE, 100 + seed), *tests], [], choices())
        first = first or found
        error = found.values - found.model.base.grouping @ standard
        hits.append(np.abs(error) < 1.96 * found.statistics.standard_deviations)
    friction = np.array([c.effect in ("coulomb", "viscous") for c in first.model.kept])
    assert 0.90 < np.mean(np.array(hits)[:, friction]) < 0.99
    assert 0.88 < np.mean(np.array(hits)[:, ~friction]) < 0.99


def test_the_uncertainty_of_friction_is_carried_into_the_inertial_parameters():
    standard = drawn_standard(UR10)
    whole = whole_motion(UR10, standard, 2.0)
    deviations = []
    for noise in (0.2, 6.0):
        found = identify(UR10, [whole, *friction_tests(UR10, standard, noise=noise)], [], choices())
        friction = np.array([c.effect in ("coulomb", "viscous") for c in found.model.kept])
        deviations.append(found.statistics.standard_deviations)
        # Cross-covariances: what friction is too large by, the rest has to make up for.
        assert np.abs(found.statistics.covariance[np.ix_(friction, ~friction)]).max() > 0
    growth = deviations[1] / deviations[0]
    # Not by 30, as the noise does: blocks are left out of all rows together, so that the whole motion's blocks give
    # friction deviations of their own, which quiet runs do not lower.
    assert growth[friction].min() > 5
    # Neighbouring blocks that by chance seem to depend on each other make a variance up to twice as large.
    assert growth[~friction].min() > 0.65
    assert np.median(growth[~friction]) > 1.0
    assert growth[~friction].max() > 1.02


@pytest.mark.parametrize("covariance", ["by_time_and_joints", "by_joint"])
@pytest.mark.parametrize("seed", range(2))
def test_joints_may_be_tested_at_different_numbers_of_speeds(covariance, seed):
    standard, rng = drawn_standard(UR10), np.random.default_rng(seed)
    tests = []
    for joint in range(UR10.n):
        fast = rng.uniform(0.05, 0.7, rng.integers(2, 5))
        tests += friction_tests(UR10, standard, (joint,), NOISE, joint, speeds=(*fast, *-fast[::-1]))
    whole = whole_motion(UR10, standard, NOISE)
    found = identify(UR10, [whole, *tests], [], choices(covariance=covariance))
    error = np.abs(found.values - found.model.base.grouping @ standard)
    assert np.mean(error <= found.statistics.half_widths()) > 0.85
    assert np.isfinite(found.statistics.standard_deviations).all()


def test_joints_without_friction_runs_are_identified_with_the_rest_and_named():
    standard = drawn_standard(UR10)
    runs = [whole_motion(UR10, standard, NOISE), *friction_tests(UR10, standard, joints=(0, 1), noise=NOISE)]
    found = identify(UR10, runs, [], choices())
    (said,) = [w for w in found.warnings if "moving alone" in w]
    assert "wrist_3_joint" in said
    assert "shoulder_pan_joint" not in said
    values = friction_of(found)
    assert abs(values["Fc6"] - standard[71]) < 0.2


def test_runs_of_single_joints_are_found_in_ordinary_recordings_too():
    standard = drawn_standard(UR10)
    runs = [whole_motion(UR10, standard), *friction_tests(UR10, standard, role="identification")]
    found = identify(UR10, runs, [], choices(preprocessing=WIDE))
    assert not any("moving alone" in w for w in found.warnings)
    assert friction_of(found)["Fc2"] == pytest.approx(standard[67], rel=1e-4)


def test_motions_of_all_joints_are_no_friction_runs():
    with pytest.raises(DynidentError, match="each joint alone") as caught:
        identify(UR10, [whole_motion(UR10, drawn_standard(UR10))], [], choices())
    assert caught.value.pointer == "/recordings"


def test_friction_tests_alone_are_not_enough_to_identify_a_robot():
    with pytest.raises(DynidentError, match="whole robot"):
        identify(UR10, friction_tests(UR10, drawn_standard(UR10)), [], choices())


@pytest.mark.parametrize(("speeds", "said"), [((0.2, 0.5, 0.8), "one direction"), ((0.4, -0.4), "one speed, 0.4")])
def test_friction_runs_that_do_not_suffice_are_named(speeds, said):
    standard = drawn_standard(UR10)
    runs = [
        whole_motion(UR10, standard, NOISE),
        *friction_tests(UR10, standard, (1,), NOISE, speeds=speeds, seconds=2.0),
    ]
    found = identify(UR10, runs, [], choices())
    assert any("shoulder_lift_joint" in w and said in w for w in found.warnings)
    (coulomb,) = [p for p in found.parameters if p.name == "Fc2"]
    assert abs(coulomb.value - standard[67]) < 3 * coulomb.standard_deviation


def test_asymmetric_and_stribeck_friction_are_told_from_the_same_runs():
    effects = (
        *EFFECTS[:4],
        EffectChoice("viscous_asymmetric", ("elbow_joint",)),
        EffectChoice("stribeck", ("elbow_joint",), (("delta", 2.0), ("vs", 0.2))),
    )
    standard = drawn_standard(UR10)
    standard[78:] = 0.0

    def with_more(recorded, motion):
        more = 0.7 * np.abs(motion.dq[:, 2]) + 1.3 * np.exp(-((motion.dq[:, 2] / 0.2) ** 2)) * np.sign(motion.dq[:, 2])
        tau = recorded.source.tau.copy()
        tau[:, 2] += more
        return replace(record(UR10, motion, tau, recorded.name), role=recorded.role)

    whole = fourier_motion(UR10, 15.0, RATE, 7, base_frequency=0.08, amplitude=2.0)
    run = strokes(UR10, 2)
    runs = [
        with_more(whole_motion(UR10, standard), whole),
        with_more(friction_tests(UR10, standard, (2,))[0], run),
    ]
    found = identify(UR10, runs, [], choices(effects=effects, preprocessing=WIDE))
    values = {p.name: p.value for p in found.parameters}
    np.testing.assert_allclose([values["Fva3"], values["Fst3"], values["Fc3"]], [0.7, 1.3, standard[68]], rtol=1e-3)


def test_other_strategies_do_not_take_friction_tests_for_ordinary_data():
    standard = drawn_standard(UR10)
    whole = whole_motion(UR10, standard, NOISE)
    nonsense = [replace(run, name="odd") for run in friction_tests(UR10, standard, (0,), noise=50.0)]
    for strategy in ("global", "sequential"):
        plain = identify(UR10, [whole], [], choices(strategy=strategy))
        found = identify(UR10, [whole, *nonsense], [], choices(strategy=strategy))
        np.testing.assert_array_equal(found.values, plain.values)
        assert found.data.measurement_names == ("whole", "odd")
        assert any("odd" in w and "Not used" in w for w in found.warnings)


def test_effects_can_be_added_to_a_model_with_separate_friction():
    standard = drawn_standard(UR10)
    runs = [whole_motion(UR10, standard, NOISE), *friction_tests(UR10, standard, noise=NOISE)]
    found = identify(UR10, runs, [], choices(effects=EFFECTS[:4]))
    grown = extend(found, [EFFECTS[4]], runs)
    offsets = [p.value for p in grown.parameters if p.effect == "offset"]
    assert len(offsets) == 6
    assert grown.fit.relative_total < found.fit.relative_total
    assert friction_of(grown) == pytest.approx(friction_of(found), rel=1e-6)


def test_an_estimator_that_needs_all_equations_is_refused():
    standard = drawn_standard(UR10)
    with pytest.raises(DynidentError, match="steps") as caught:
        identify(
            UR10, [whole_motion(UR10, standard), *friction_tests(UR10, standard)], [], choices(estimator="feasible")
        )
    assert caught.value.pointer == "/estimator"


def test_a_joint_that_alone_moves_steadily_is_found_sample_by_sample():
    dq = np.array([[0.3, 0.0], [0.3, 0.1], [0.0, -0.2], [0.0, 0.0], [0.3, 0.005], [0.003, 0.0]])
    ddq = np.zeros_like(dq)
    np.testing.assert_array_equal(find_sole_mover(dq, ddq), [0, -1, 1, -1, 0, -1])
    ddq[:, 0] = 5.0
    np.testing.assert_array_equal(find_sole_mover(dq, ddq), [-1, -1, 1, -1, -1, -1])
