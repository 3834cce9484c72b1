"""Shape constants that nobody gave are found from the data."""

from __future__ import annotations

import numpy as np
import pytest
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.effects import STOP, EffectChoice, MemorySignal, ReferenceParameters
from dynident.effects.hysteresis_states import step_state
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, extend, identify
from dynident.identification.shape_search import (
    check_choices,
    complete_shapes,
    find_shapes,
    lacks_shape,
    refine_shapes,
    split_by_joint,
)
from dynident.recordings import Preprocessing
from dynident.regressors.observation_matrix import RegressorInputs

ROBOT = arm("ur10")
BASE = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
BAND = Preprocessing(None, 20.0, 4)
MOTION = fourier_motion(ROBOT, 30.0, 200.0, 4)
NAMES = ROBOT.joint_names
NOISE = np.array([1.0, 1.0, 0.6, 0.3, 0.3, 0.3])


def base_torque(motion: Motion) -> np.ndarray:
    rigid = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    noise = NOISE * np.random.default_rng(0).normal(size=motion.q.shape)
    return rigid + 5 * np.sign(motion.dq) + 3 * motion.dq + 0.5 * motion.ddq + 1.0 + noise


def with_stribeck(joint: int, vs: float, amplitude: float) -> np.ndarray:
    tau = base_torque(MOTION)
    v = MOTION.dq[:, joint]
    tau[:, joint] += amplitude * np.exp(-((v / vs) ** 2)) * np.sign(v)
    return tau


def with_presliding(joint: int, slip: float, amplitude: float) -> np.ndarray:
    tau = base_torque(MOTION)
    z, before, signal = 0.0, MOTION.q[0, joint], MemorySignal(STOP, joint, slip)
    for k, here in enumerate(MOTION.q[:, joint]):
        z = step_state(signal, z, here - before)
        tau[k, joint] += amplitude * z
        before = here
    return tau


def plain(tau: np.ndarray):
    run = record(ROBOT, MOTION, tau)
    return identify(ROBOT, [run], [], IdentificationChoices(BASE, estimator="wls", preprocessing=BAND)), run


STRIBECK = with_stribeck(1, 0.13, 12.0)
PLAIN_STRIBECK, RUN_STRIBECK = plain(STRIBECK)


def build_inputs(identification, run):
    links = identification.estimate.standard_inertia().reshape(-1, 10)
    return RegressorInputs([run], BAND, ReferenceParameters.from_links(links, identification.model.robot.n))


def test_a_stribeck_velocity_is_found_on_the_grid_and_then_between_its_points():
    choice = EffectChoice("stribeck", (NAMES[1],))
    (coarse,) = find_shapes(PLAIN_STRIBECK.model, [choice], build_inputs(PLAIN_STRIBECK, RUN_STRIBECK))
    assert coarse.shape_values["vs"] == pytest.approx(0.13, rel=0.45)
    (fine,) = refine_shapes(PLAIN_STRIBECK.model, [coarse], build_inputs(PLAIN_STRIBECK, RUN_STRIBECK))
    assert fine.shape_values["vs"] == pytest.approx(0.13, rel=0.12)
    (complete,) = complete_shapes(PLAIN_STRIBECK.model, [choice], build_inputs(PLAIN_STRIBECK, RUN_STRIBECK))
    assert complete == fine


@pytest.mark.parametrize("slip", [8e-3, 0.03])
def test_a_slip_distance_is_found(slip):
    identification, run = plain(with_presliding(2, slip, 8.0))
    (found,) = complete_shapes(
        identification.model, [EffectChoice("presliding", (NAMES[2],))], build_inputs(identification, run)
    )
    assert found.shape_values["d0"] == pytest.approx(slip, rel=0.25)


@pytest.mark.parametrize("power", [2.0, 0.5])
def test_an_exponent_is_found(power):
    tau = base_torque(MOTION)
    v = MOTION.dq[:, 0]
    tau[:, 0] += 6.0 * np.abs(v) ** power * np.sign(v)
    identification, run = plain(tau)
    choice = EffectChoice("viscous_nonlinear", (NAMES[0],))
    (found,) = complete_shapes(identification.model, [choice], build_inputs(identification, run))
    assert found.shape_values["p"] == power


@pytest.mark.parametrize("angle", [-1.3, 0.02, 2.2])
def test_an_angle_is_refined_downward_and_through_zero(angle):
    tau = base_torque(MOTION)
    x, ratio = MOTION.q[:, 1] - angle, 0.45
    tau[:, 1] -= 1200.0 * np.sin(x) * (1 - 0.4 / np.sqrt(1 + ratio**2 + 2 * ratio * np.cos(x)))
    identification, run = plain(tau)
    choice = EffectChoice("gravity_compensator", (NAMES[1],), (("r", ratio), ("phi", angle + 0.2)))
    (found,) = refine_shapes(identification.model, [choice], build_inputs(identification, run), kept=[("r",)])
    assert found.shape_values["phi"] == pytest.approx(angle, abs=0.04)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_side_of_a_coupling_is_found(side):
    tau = base_torque(MOTION)
    shared = 4.0 * np.sign(MOTION.dq[:, 4] + side * MOTION.dq[:, 5])
    tau[:, 4] += shared
    tau[:, 5] += side * shared
    identification, run = plain(tau)
    choice = EffectChoice("transmission_coupling", (NAMES[4],))
    (found,) = complete_shapes(identification.model, [choice], build_inputs(identification, run))
    assert found.shape_values["side"] == side


def test_two_effects_are_sought_beside_each_other():
    tau = with_stribeck(1, 0.13, 12.0) + with_presliding(2, 0.03, 8.0) - base_torque(MOTION)
    identification, run = plain(tau)
    choices = [EffectChoice("stribeck", (NAMES[1],)), EffectChoice("presliding", (NAMES[2],))]
    stribeck, presliding = complete_shapes(identification.model, choices, build_inputs(identification, run))
    assert stribeck.shape_values["vs"] == pytest.approx(0.13, rel=0.15)
    assert presliding.shape_values["d0"] == pytest.approx(0.03, rel=0.25)


def test_given_shapes_are_kept():
    given = EffectChoice("stribeck", (NAMES[1],), (("delta", 2.0), ("vs", 0.5)))
    found = complete_shapes(PLAIN_STRIBECK.model, [given], build_inputs(PLAIN_STRIBECK, RUN_STRIBECK))
    assert found == (given,)


@pytest.mark.parametrize(("given", "free"), [("vs", "delta"), ("delta", "vs")])
def test_of_two_shape_constants_the_one_that_was_given_is_kept(given, free):
    choice = EffectChoice("stribeck", (NAMES[1],), ((given, 0.5),))
    (found,) = complete_shapes(PLAIN_STRIBECK.model, [choice], build_inputs(PLAIN_STRIBECK, RUN_STRIBECK))
    assert found.shape_values[given] == 0.5
    assert found.shape_values.keys() == {given, free}


def test_a_line_is_refined_by_less_than_its_width():
    tau = base_torque(MOTION)
    tau[:, 3] += 3.0 * np.sin(21.37 * MOTION.q[:, 3] + 0.4)
    identification, run = plain(tau)
    choice = EffectChoice("torque_ripple", (NAMES[3],), (("k", 21.3),))
    (found,) = refine_shapes(identification.model, [choice], build_inputs(identification, run))
    assert found.shape_values["k"] == pytest.approx(21.37, abs=0.02)


def test_an_open_choice_on_all_joints_becomes_one_a_joint():
    (*split,) = split_by_joint([EffectChoice("stribeck")], ROBOT)
    assert [choice.joints for choice in split] == [(name,) for name in NAMES]
    tilt = EffectChoice("base_tilt")
    given = EffectChoice("stribeck", (), (("vs", 0.1), ("delta", 2.0)))
    assert split_by_joint([tilt, given], ROBOT) == (tilt, given)


def test_what_lacks_a_shape_is_known():
    assert lacks_shape(EffectChoice("stribeck"))
    assert lacks_shape(EffectChoice("stribeck", (), (("vs", 0.1),)))
    assert not lacks_shape(EffectChoice("stribeck", (), (("vs", 0.1), ("delta", 1.0))))
    assert not lacks_shape(EffectChoice("coulomb"))
    assert not lacks_shape(EffectChoice("torque_ripple"))


def test_a_ripple_without_its_number_of_cycles_is_refused_with_a_way_out():
    with pytest.raises(DynidentError, match="diagnosis") as caught:
        check_choices([EffectChoice("coulomb"), EffectChoice("torque_ripple")], ROBOT)
    assert caught.value.pointer == "/effects/1/shape/k"
    with pytest.raises(DynidentError, match="diagnosis"):
        identify(
            ROBOT, [RUN_STRIBECK], [], IdentificationChoices((*BASE, EffectChoice("torque_ripple")), preprocessing=BAND)
        )


def test_identifying_and_extending_find_the_same_shape():
    choice = EffectChoice("stribeck", (NAMES[1],))
    grown = extend(PLAIN_STRIBECK, [choice], [RUN_STRIBECK])
    at_once = identify(ROBOT, [RUN_STRIBECK], [], IdentificationChoices((*BASE, choice), preprocessing=BAND))
    shapes = [next(p.shape for p in found.parameters if p.name == "Fst2") for found in (grown, at_once)]
    assert dict(shapes[0])["vs"] == pytest.approx(dict(shapes[1])["vs"], rel=1e-3)
    assert dict(shapes[0])["vs"] == pytest.approx(0.13, rel=0.12)
    amplitude = next(p for p in grown.parameters if p.name == "Fst2")
    assert amplitude.value == pytest.approx(12.0, rel=0.15)


def test_an_effect_that_needs_the_load_is_predicted_with_the_first_fit():
    load = pinocchio_torque(ROBOT, MOTION.q, MOTION.dq, MOTION.ddq)
    tau = base_torque(MOTION)
    tau[:, 1] += 0.1 * np.abs(load[:, 1]) * np.sign(MOTION.dq[:, 1])
    run = record(ROBOT, MOTION, tau)
    effects = (*BASE, EffectChoice("load_dependent_friction", (NAMES[1],)))
    choices = IdentificationChoices(effects, estimator="wls", preprocessing=BAND)
    found = identify(ROBOT, [run], [], choices)
    parameter = next(p for p in found.parameters if p.name == "cl2")
    assert parameter.value == pytest.approx(0.1, abs=max(0.015, 3 * parameter.standard_deviation))
    assert found.estimate.reference.inertias.any()
    plain_model, _ = plain(tau)
    assert not plain_model.estimate.reference.inertias.any()
    grown = extend(plain_model, [EffectChoice("load_dependent_friction", (NAMES[1],))], [run])
    np.testing.assert_allclose(grown.values, found.values, rtol=1e-3, atol=1e-3)


def test_an_effect_that_needs_the_load_is_refused_without_the_links():
    choices = IdentificationChoices(
        (EffectChoice("coulomb"), EffectChoice("load_dependent_friction")), preprocessing=BAND
    )
    with pytest.raises(DynidentError, match="rigid_body"):
        identify(ROBOT, [RUN_STRIBECK], [], choices)


def test_rows_that_a_model_has_kept_give_the_same_constants():
    choice, inputs = EffectChoice("stribeck", (NAMES[1],)), build_inputs(PLAIN_STRIBECK, RUN_STRIBECK)
    rows = PLAIN_STRIBECK.in_memory.training
    assert rows is not None
    assert complete_shapes(PLAIN_STRIBECK.model, [choice], inputs, known=rows) == complete_shapes(
        PLAIN_STRIBECK.model, [choice], inputs
    )
