"""Every effect of the catalogue: documented, finite, named, on its own rows; choices that do not fit are refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.effect_columns import PUBLISHED, Evaluated
from support.oracles import arm, random_states

from dynident.effects import (
    CATALOGUE,
    DEFAULT_EFFECTS,
    EffectChoice,
    RunSignal,
    ShapeSpec,
    Signals,
    UnknownEffectError,
    build_columns,
    count_reference_parameters,
    get_effect,
)
from dynident.effects.effect_columns import find_joints
from dynident.effects.usual_effect_sizes import get_velocity_scale
from dynident.robot import Robot

ROBOTS = ("ur10", "scara", "dual_arm")
# Effects of one joint that act on others too, beside those of the whole robot.
REACHING = {
    "rigid_body", "transmission_coupling", "cable_force", "rotor_coupling", "backlash", "joint_elasticity",
    "encoder_zero_error", "kinematic_error", "payload",
}  # fmt: skip
LOCAL = [name for name in PUBLISHED if name not in REACHING and get_effect(name).scope == "joint"]


def test_the_catalogue_holds_the_published_ids():
    assert set(CATALOGUE) >= set(PUBLISHED)
    assert all(effect.id == name for name, effect in CATALOGUE.items())


@pytest.mark.parametrize("name", PUBLISHED)
def test_every_effect_says_what_it_is(name):
    effect = get_effect(name)
    assert effect.title
    assert effect.formula
    assert effect.signature
    assert effect.sources
    assert effect.parameters
    names = [spec.name for spec in effect.parameters]
    assert len(set(names)) == len(names)
    for spec in effect.parameters:
        assert spec.unit
        assert spec.description
    for shape in effect.shapes:
        assert shape.unit
        assert shape.description
        assert shape.proposal in ("grid", "angle_spectrum", "time_spectrum", "burst")
        assert shape.admits(shape.default)


@pytest.mark.parametrize("name", PUBLISHED)
def test_what_an_effect_is_confused_with_is_in_the_catalogue(name):
    effect = get_effect(name)
    others = {*effect.confused_with, *effect.same_function}
    assert others <= set(CATALOGUE)
    assert name not in others
    assert all(name in get_effect(other).same_function for other in effect.same_function)


def test_no_two_parameters_of_different_effects_share_a_name():
    names = [spec.name for name in PUBLISHED for spec in get_effect(name).parameters]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("robot_name", ROBOTS)
@pytest.mark.parametrize("name", PUBLISHED)
def test_columns_of_every_effect_are_finite_named_and_have_units(name, robot_name):
    found = Evaluated(arm(robot_name), EffectChoice(name))
    assert np.isfinite(found.values).all()
    assert len({column.name for column in found.columns}) == len(found.columns)
    parameters = {spec.name for spec in get_effect(name).parameters}
    for column in found.columns:
        assert column.effect == name
        assert column.parameter in parameters
        assert column.unit
        assert column.name.startswith(column.parameter)
    per_joint = len(get_effect(name).parameters)
    expected = (
        per_joint
        if get_effect(name).scope == "robot"
        else per_joint * len(get_effect(name).get_default_joints(arm(robot_name)))
    )
    assert len(found.columns) == expected


@pytest.mark.parametrize("robot_name", ["ur10", "scara"])
@pytest.mark.parametrize("name", LOCAL)
def test_an_effect_on_one_joint_is_a_torque_on_that_joint_alone(name, robot_name):
    robot = arm(robot_name)
    possible = get_effect(name).applicable(robot)
    if not possible:
        pytest.skip(f"{name} cannot act on any joint of {robot_name}")
    found = Evaluated(robot, *(EffectChoice(name, (robot.joint_names[j],)) for j in possible))
    for k, column in enumerate(found.columns):
        j = possible[k // len(get_effect(name).parameters)]
        assert {int(row) for row in column.torque.sparsity().get_triplet()[0]} == {j}
        assert column.link == robot.joint_names[j]
        assert column.name.endswith(str(j + 1))
        assert found.values[:, j, k].any()
        assert not np.delete(found.values[:, :, k], j, axis=1).any()


@pytest.mark.parametrize("name", sorted(REACHING - {"rigid_body"}))
def test_an_effect_that_reaches_further_is_named_after_its_joint(name):
    robot = arm("ur10")
    signals = Signals(robot)
    for j in get_effect(name).applicable(robot):
        columns = build_columns([EffectChoice(name, (robot.joint_names[j],))], signals)
        assert [column.name for column in columns] == [f"{spec.name}{j + 1}" for spec in get_effect(name).parameters]
        assert {column.link for column in columns} == {robot.joint_names[j]}


def test_units_are_those_of_a_sliding_joint_where_the_joint_slides():
    robot = arm("scara")
    slides = robot.joint_names[2]
    units = {
        column.name: column.unit
        for name in ("coulomb", "viscous", "offset", "rotor_inertia", "joint_spring", "stribeck", "presliding")
        for column in build_columns([EffectChoice(name, (slides,))], Signals(robot))
    }
    assert units == {
        "Fc3": "N", "Fv3": "N s/m", "b3": "N", "Ia3": "kg", "ks3": "N/m", "bs3": "N", "Fst3": "N", "Fz3": "N",
        "cz3": "-",
    }  # fmt: skip


@pytest.mark.parametrize("name", PUBLISHED)
def test_stored_energy_changes_by_the_power_of_its_torque(name):
    robot = arm("ur10")
    signals = Signals(robot)
    s = signals
    for column in build_columns([EffectChoice(name)], signals)[::3]:
        if column.energy is None:
            continue
        h = ca.SX(column.energy())
        rate = ca.jtimes(h, s.q, s.dq) + ca.jtimes(h, s.dq, s.ddq)
        power = ca.dot(s.dq, ca.densify(column.torque))
        present = s.in_runs(RunSignal())
        function = ca.Function("p", [s.q, s.dq, s.ddq, s.reference, present], [rate - power, power])
        reference = np.random.default_rng(1).normal(size=count_reference_parameters(robot))
        for state in zip(*random_states(robot, 4, 9), strict=True):
            for there in (0.0, 1.0):
                gap, size = (float(value) for value in function(*state, reference, there))
                assert abs(gap) < 1e-9 * max(1.0, abs(size))


@pytest.mark.parametrize("name", [
    "rigid_body", "rotor_inertia", "joint_spring", "torque_ripple", "gravity_compensator", "cable_force",
    "rotor_coupling", "payload",
])  # fmt: skip
def test_effects_that_store_energy_say_how_much(name):
    columns = build_columns([EffectChoice(name)], Signals(arm("ur10")))
    assert all(column.energy is not None for column in columns)


def test_the_inertia_of_a_shared_motor_stores_energy():
    columns = build_columns([EffectChoice("transmission_coupling")], Signals(arm("ur10")))
    assert [column.parameter for column in columns if column.energy is not None] == ["Iam"] * 5


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize("robot_name", ROBOTS)
def test_every_grid_gives_complete_shapes_that_make_columns(name, robot_name):
    robot = arm(robot_name)
    effect = get_effect(name)
    for j in effect.applicable(robot):
        grid = effect.grid(robot, j)
        assert grid
        for shape in grid:
            assert set(shape) == {spec.name for spec in effect.shapes}
            assert all(spec.admits(shape[spec.name]) for spec in effect.shapes)
        assert len({tuple(sorted(shape.items())) for shape in grid}) == len(grid)


def test_stribeck_velocities_are_relative_to_the_joints_velocity_limit():
    robot = arm("ur10")
    for j in range(6):
        grid = [shape["vs"] / get_velocity_scale(robot, j) for shape in get_effect("stribeck").grid(robot, j)]
        assert min(grid) == pytest.approx(0.004)
        assert 0.06 < max(grid) <= 0.13


def test_an_unknown_effect_is_answered_with_those_there_are():
    with pytest.raises(UnknownEffectError, match=r"no effect 'striebeck'.*stribeck") as caught:
        get_effect("striebeck", "/effects/2")
    assert caught.value.pointer == "/effects/2"


def test_an_unknown_joint_is_answered_with_those_there_are():
    robot = arm("scara")
    with pytest.raises(UnknownEffectError, match="no joint 'tail'") as caught:
        find_joints(EffectChoice("coulomb", ("tail",)), robot)
    assert all(name in caught.value.detail for name in robot.joint_names)
    with pytest.raises(UnknownEffectError, match=r"no joint 'elbw'; did you mean 'elbow'\? The joints are: "):
        find_joints(EffectChoice("coulomb", ("elbw",)), robot)


def test_an_effect_that_cannot_sit_on_a_joint_says_where_it_can():
    robot = arm("scara")
    with pytest.raises(UnknownEffectError, match="cannot act on"):
        find_joints(EffectChoice("position_dependent_friction", (robot.joint_names[2],)), robot)
    with pytest.raises(UnknownEffectError, match="cannot act on"):
        find_joints(EffectChoice("transmission_coupling", (robot.joint_names[3],)), robot)


def test_a_tilt_needs_gravity():
    base = arm("ur10")
    floating = Robot(base.name, base.joints, np.zeros(3), base.drives, base.description, base.inertias)
    with pytest.raises(UnknownEffectError, match="cannot act on any joint"):
        build_columns([EffectChoice("base_tilt")], Signals(floating))


def test_an_unknown_shape_constant_is_answered_with_those_there_are():
    with pytest.raises(UnknownEffectError, match=r"no shape constant 'speed'.*vs, delta"):
        build_columns([EffectChoice("stribeck", shape=(("speed", 2.0),))], Signals(arm("ur10")))


@pytest.mark.parametrize(
    ("effect", "shape"),
    [
        ("stribeck", ("vs", 0.0)),
        ("stribeck", ("vs", float("nan"))),
        ("presliding", ("d0", 0.0)),
        ("presliding", ("d0", -1e-3)),
        ("viscous_nonlinear", ("p", -1.0)),
        ("viscous_nonlinear", ("p", float("inf"))),
        ("transmission_coupling", ("side", float("nan"))),
        ("transmission_coupling", ("side", 0.0)),
        ("presliding", ("law", 0.0)),
        ("gravity_compensator", ("phi", float("nan"))),
        ("gravity_compensator", ("r", 0.0)),
        ("warm_up_friction", ("Tw", 0.0)),
        ("backlash", ("w", -1.0)),
        ("base_vibration", ("f", 0.0)),
        ("external_contact", ("t1", float("inf"))),
    ],
)
def test_an_impossible_shape_constant_is_refused(effect, shape):
    with pytest.raises(UnknownEffectError, match=shape[0]):
        build_columns([EffectChoice(effect, (), (shape,))], Signals(arm("ur10")))


@pytest.mark.parametrize(
    ("effect", "shape"),
    [("gravity_compensator", ("phi", 0.0)), ("external_contact", ("t0", 0.0)), ("external_contact", ("t0", -3.0))],
)
def test_an_angle_or_a_time_may_be_zero_or_below(effect, shape):
    assert build_columns([EffectChoice(effect, (), (shape,))], Signals(arm("ur10")))


@given(value=st.floats(), signed=st.booleans(), may_be_zero=st.booleans())
def test_a_shape_constant_is_finite_and_above_zero_unless_told_otherwise(value, signed, may_be_zero):
    spec = ShapeSpec("x", "-", "anything", 1.0, signed=signed, may_be_zero=may_be_zero)
    sensible = np.isfinite(value) and (value > 0 or (value < 0 and signed) or (value == 0 and may_be_zero))
    assert spec.admits(value) == bool(sensible)


def test_a_joint_named_twice_counts_once():
    robot = arm("ur10")
    name = robot.joint_names[1]
    assert find_joints(EffectChoice("coulomb", (name, name)), robot) == (1,)


def test_the_default_effects_are_links_rotors_and_plain_friction():
    assert [choice.effect for choice in DEFAULT_EFFECTS] == ["rigid_body", "rotor_inertia", "coulomb", "viscous"]
