"""Every effect of the catalogue: documented, finite, on its own rows, by the formula that it prints."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import arm, pinocchio_rows, random_states

from dynident.effects import (
    CATALOGUE,
    DEFAULT_EFFECTS,
    Column,
    EffectChoice,
    MemorySignal,
    Signals,
    UnknownEffectError,
    columns_of,
    effect_by_id,
)
from dynident.effects.catalogue import joints_of
from dynident.effects.friction import velocity_scale
from dynident.effects.memory import MemoryStates
from dynident.effects.structure import across
from dynident.robot import Robot

PUBLISHED = {
    "rigid_body", "rotor_inertia", "coulomb", "viscous", "offset", "viscous_asymmetric", "stribeck",
    "viscous_nonlinear", "load_dependent_friction", "position_dependent_friction", "presliding", "joint_spring",
    "torque_ripple", "base_tilt", "transmission_coupling",
}  # fmt: skip
ROBOTS = ("ur10", "scara", "dual_arm")
COUNT = 40


class Evaluated:
    """Columns of choices on an arm at random states, with the states and the predicted load beside them."""

    def __init__(self, robot: Robot, *choices: EffectChoice, smooth_sign: float = 0.0, seed: int = 0) -> None:
        self.robot = robot
        self.signals = Signals(robot, smooth_sign=smooth_sign)
        self.columns: list[Column] = columns_of(choices, self.signals)
        rng = np.random.default_rng(seed)
        self.q, self.dq, self.ddq = random_states(robot, COUNT, seed)
        self.dq[0] = 0.0
        self.reference = rng.normal(size=10 * robot.n)
        self.z = rng.uniform(-1, 1, (COUNT, len(self.signals.memory_signals)))
        self.load = pinocchio_rows(robot, self.q, self.dq, self.ddq) @ self.reference
        s = self.signals
        stacked = ca.densify(ca.horzcat(*(column.torque for column in self.columns)))
        function = ca.Function("c", [s.q, s.dq, s.ddq, s.memory_symbols, s.reference], [stacked])
        self.values = np.array(
            [
                np.array(function(self.q[k], self.dq[k], self.ddq[k], self.z[k], self.reference)).reshape(robot.n, -1)
                for k in range(COUNT)
            ]
        )

    def column(self, name: str) -> np.ndarray:
        """(COUNT, n)."""
        return self.values[:, :, [column.name for column in self.columns].index(name)]


def test_the_catalogue_holds_the_published_ids():
    assert set(CATALOGUE) == PUBLISHED
    assert all(effect.id == name for name, effect in CATALOGUE.items())


@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_every_effect_says_what_it_is(name):
    effect = effect_by_id(name)
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
        assert shape.proposal in ("grid", "angle_spectrum")


def test_no_two_parameters_of_different_effects_share_a_name():
    names = [spec.name for effect in CATALOGUE.values() for spec in effect.parameters]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("robot_name", ROBOTS)
@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_columns_of_every_effect_are_finite_named_and_have_units(name, robot_name):
    found = Evaluated(arm(robot_name), EffectChoice(name))
    assert np.isfinite(found.values).all()
    assert len({column.name for column in found.columns}) == len(found.columns)
    parameters = {spec.name for spec in effect_by_id(name).parameters}
    for column in found.columns:
        assert column.effect == name
        assert column.parameter in parameters
        assert column.unit
        assert column.name.startswith(column.parameter)
    per_joint = len(effect_by_id(name).parameters)
    expected = (
        per_joint
        if effect_by_id(name).scope == "robot"
        else per_joint * len(effect_by_id(name).applicable(arm(robot_name)))
    )
    assert len(found.columns) == expected


@pytest.mark.parametrize("robot_name", ROBOTS)
@pytest.mark.parametrize("name", sorted(PUBLISHED - {"rigid_body", "base_tilt", "transmission_coupling"}))
def test_an_effect_on_one_joint_is_a_torque_on_that_joint_alone(name, robot_name):
    robot = arm(robot_name)
    for j in effect_by_id(name).applicable(robot):
        found = Evaluated(robot, EffectChoice(name, (robot.joint_names[j],)))
        others = [k for k in range(robot.n) if k != j]
        for column in found.columns:
            rows = {int(row) for row in column.torque.sparsity().get_triplet()[0]}
            assert rows == {j}
            assert column.link == robot.joint_names[j]
            assert column.name.endswith(str(j + 1))
        assert not found.values[:, others].any()
        assert found.values[:, j].any()


def test_units_are_those_of_a_sliding_joint_where_the_joint_slides():
    robot = arm("scara")
    slides = robot.joint_names[2]
    units = {
        column.name: column.unit
        for name in ("coulomb", "viscous", "offset", "rotor_inertia", "joint_spring", "stribeck", "presliding")
        for column in columns_of([EffectChoice(name, (slides,))], Signals(robot))
    }
    assert units == {
        "Fc3": "N", "Fv3": "N s/m", "b3": "N", "Ia3": "kg", "ks3": "N/m", "bs3": "N", "Fst3": "N", "Fz3": "N",
        "cz3": "-",
    }  # fmt: skip


def sign(v):
    return np.sign(v)


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_plain_effects_are_their_formulas(robot_name):
    found = Evaluated(
        arm(robot_name),
        *(EffectChoice(name) for name in ("rotor_inertia", "coulomb", "viscous", "offset", "viscous_asymmetric")),
        EffectChoice("joint_spring"),
    )
    for j in range(found.robot.n):
        q, v, a = found.q[:, j], found.dq[:, j], found.ddq[:, j]
        expected = {"Ia": a, "Fc": sign(v), "Fv": v, "b": 1 + 0 * v, "Fva": abs(v), "ks": q, "bs": 1 + 0 * v}
        for name, column in expected.items():
            np.testing.assert_allclose(found.column(f"{name}{j + 1}")[:, j], column, rtol=1e-14)


@settings(max_examples=20, deadline=None)
@given(vs=st.floats(1e-3, 1.0), p=st.floats(0.25, 3.0), k=st.sampled_from([1.0, 2.0, 17.3]), d0=st.floats(1e-4, 0.1))
def test_effects_with_a_shape_are_their_formulas_for_any_shape(vs, p, k, d0):
    found = Evaluated(
        arm("ur10"),
        EffectChoice("stribeck", shape=(("vs", vs),)),
        EffectChoice("viscous_nonlinear", shape=(("p", p),)),
        EffectChoice("load_dependent_friction"),
        EffectChoice("position_dependent_friction", shape=(("k", k),)),
        EffectChoice("torque_ripple", shape=(("k", k),)),
        EffectChoice("presliding", shape=(("d0", d0),)),
    )
    assert found.signals.memory_signals == tuple(MemorySignal("stop", j, d0) for j in range(6))
    for j in range(6):
        q, v, load, z = found.q[:, j], found.dq[:, j], found.load[:, j], found.z[:, j]
        expected = {
            "Fst": np.exp(-((v / vs) ** 2)) * sign(v),
            "Fvn": np.abs(v) ** p * sign(v),
            "cl": np.abs(load) * sign(v),
            "Fpc": np.cos(k * q) * sign(v),
            "Fps": np.sin(k * q) * sign(v),
            "Ac": np.cos(k * q),
            "As": np.sin(k * q),
            "Fz": z,
            "cz": np.abs(load) * z,
        }
        for name, column in expected.items():
            np.testing.assert_allclose(found.column(f"{name}{j + 1}")[:, j], column, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_shared_motor_brakes_both_joints_by_its_own_friction_and_inertia(side):
    robot = arm("ur10")
    found = Evaluated(robot, EffectChoice("transmission_coupling", (robot.joint_names[4],), (("side", side),)))
    speed, acceleration = found.dq[:, 4] + side * found.dq[:, 5], found.ddq[:, 4] + side * found.ddq[:, 5]
    # Virtual work: the motor turns with q5 + side q6, so its torque acts on joint 6 times side.
    for name, torque in (("Iam5", acceleration), ("Fvm5", speed), ("Fcm5", np.sign(speed))):
        expected = np.zeros((COUNT, 6))
        expected[:, 4], expected[:, 5] = torque, side * torque
        np.testing.assert_allclose(found.column(name), expected, rtol=1e-13)


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_a_tilted_base_is_what_a_change_of_gravity_does_to_pinocchios_torque(robot_name):
    robot = arm(robot_name)
    found = Evaluated(robot, EffectChoice("base_tilt"))
    for name, direction in zip(("gx", "gy"), across(robot.gravity), strict=True):
        tilted = Robot(
            robot.name, robot.joints, robot.gravity + direction, robot.drives, robot.description, robot.inertias
        )
        rows = pinocchio_rows(tilted, found.q, found.dq, found.ddq) - pinocchio_rows(
            robot, found.q, found.dq, found.ddq
        )
        np.testing.assert_allclose(found.column(name), rows @ found.reference, atol=1e-8)


@given(g=st.tuples(*[st.floats(-10, 10)] * 3).filter(lambda g: np.linalg.norm(g) > 0.1))
def test_the_directions_of_a_tilt_are_across_gravity(g):
    first, second = across(np.array(g))
    frame = np.array([first, second, np.array(g) / np.linalg.norm(g)])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-9)


def test_under_common_gravity_a_tilt_is_named_by_the_axes_x_and_y():
    first, second = across(np.array([0.0, 0.0, -9.81]))
    np.testing.assert_allclose([first, second], [[1, 0, 0], [0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize(
    "choice",
    [
        EffectChoice("coulomb"),
        EffectChoice("viscous"),
        EffectChoice("stribeck", shape=(("vs", 0.3),)),
        EffectChoice("viscous_nonlinear", shape=(("p", 0.5),)),
        EffectChoice("load_dependent_friction"),
        EffectChoice("transmission_coupling", shape=(("side", -1.0),)),
    ],
    ids=lambda choice: choice.effect,
)
@pytest.mark.parametrize("smooth", [0.0, 0.01])
def test_friction_takes_energy_from_the_motion(choice, smooth):
    found = Evaluated(arm("ur10"), choice, smooth_sign=smooth)
    power = np.einsum("mnc,mn->mc", found.values, found.dq)
    resistive = [k for k, column in enumerate(found.columns) if column.parameter != "Iam"]
    assert (power[:, resistive] >= 0).all()


def test_presliding_takes_energy_over_every_closed_path():
    # z follows the path as a stop operator; what it takes over a cycle is the area of its loop.
    rng = np.random.default_rng(0)
    for size in (1e-3, 5e-3, 0.1):
        angle = np.linspace(0, 2 * np.pi, 4001)
        q = size * (np.sin(angle) + 0.5 * np.sin(3 * angle + rng.uniform(0, 6)))
        q = np.concatenate([q, q[1:], q[1:]])
        z = MemoryStates([MemorySignal("stop", 0, 2e-3)]).push(q[:, None])[:, 0]
        last = slice(8000, None)
        assert np.sum(0.5 * (z[last][1:] + z[last][:-1]) * np.diff(q[last])) >= -1e-12


def test_smooth_friction_tends_to_the_exact_one_away_from_rest():
    choices = [EffectChoice(name) for name in ("coulomb", "stribeck", "load_dependent_friction")]
    exact = Evaluated(arm("ur10"), *choices)
    errors = []
    for width in (0.1, 0.01, 0.001):
        smooth = Evaluated(arm("ur10"), *choices, smooth_sign=width)
        moving = np.abs(exact.dq).min(axis=1) > 0.02
        errors.append(np.abs(smooth.values - exact.values)[moving].max())
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-12


def test_friction_at_rest_is_zero_whether_smooth_or_not():
    for smooth in (0.0, 0.01):
        found = Evaluated(arm("ur10"), EffectChoice("coulomb"), EffectChoice("stribeck"), smooth_sign=smooth)
        assert not found.values[0].any()


@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_stored_energy_changes_by_the_power_of_its_torque(name):
    robot = arm("ur10")
    signals = Signals(robot)
    s = signals
    for column in columns_of([EffectChoice(name)], signals)[::3]:
        if column.energy is None:
            continue
        h = ca.SX(column.energy())
        rate = ca.jtimes(h, s.q, s.dq) + ca.jtimes(h, s.dq, s.ddq)
        power = ca.dot(s.dq, ca.densify(column.torque))
        function = ca.Function("p", [s.q, s.dq, s.ddq, s.reference], [rate - power, power])
        reference = np.random.default_rng(1).normal(size=60)
        for state in zip(*random_states(robot, 4, 9), strict=True):
            gap, size = (float(value) for value in function(*state, reference))
            assert abs(gap) < 1e-9 * max(1.0, abs(size))


@pytest.mark.parametrize("name", ["rigid_body", "rotor_inertia", "joint_spring", "torque_ripple"])
def test_effects_that_store_energy_say_how_much(name):
    columns = columns_of([EffectChoice(name)], Signals(arm("ur10")))
    assert all(column.energy is not None for column in columns)


def test_the_inertia_of_a_shared_motor_stores_energy():
    columns = columns_of([EffectChoice("transmission_coupling")], Signals(arm("ur10")))
    assert [column.parameter for column in columns if column.energy is not None] == ["Iam"] * 5


@pytest.mark.parametrize("name", sorted(PUBLISHED))
@pytest.mark.parametrize("robot_name", ROBOTS)
def test_every_grid_gives_complete_shapes_that_make_columns(name, robot_name):
    robot = arm(robot_name)
    effect = effect_by_id(name)
    for j in effect.applicable(robot):
        grid = effect.grid(robot, j)
        assert grid
        for shape in grid:
            assert set(shape) == {spec.name for spec in effect.shapes}
            assert all(np.isfinite(value) and value != 0 for value in shape.values())
        assert len({tuple(sorted(shape.items())) for shape in grid}) == len(grid)


def test_stribeck_velocities_are_relative_to_the_joints_velocity_limit():
    robot = arm("ur10")
    for j in range(6):
        grid = [shape["vs"] / velocity_scale(robot, j) for shape in effect_by_id("stribeck").grid(robot, j)]
        assert min(grid) == pytest.approx(0.004)
        assert 0.06 < max(grid) <= 0.13


def test_an_unknown_effect_is_answered_with_those_there_are():
    with pytest.raises(UnknownEffectError, match=r"no effect 'striebeck'.*stribeck") as caught:
        effect_by_id("striebeck", "/effects/2")
    assert caught.value.pointer == "/effects/2"


def test_an_unknown_joint_is_answered_with_those_there_are():
    robot = arm("scara")
    with pytest.raises(UnknownEffectError, match="no joint 'tail'") as caught:
        joints_of(EffectChoice("coulomb", ("tail",)), robot)
    assert all(name in caught.value.detail for name in robot.joint_names)


def test_an_effect_that_cannot_sit_on_a_joint_says_where_it_can():
    robot = arm("scara")
    with pytest.raises(UnknownEffectError, match="cannot sit on"):
        joints_of(EffectChoice("position_dependent_friction", (robot.joint_names[2],)), robot)
    with pytest.raises(UnknownEffectError, match="cannot sit on"):
        joints_of(EffectChoice("transmission_coupling", (robot.joint_names[3],)), robot)


def test_a_tilt_needs_gravity():
    base = arm("ur10")
    floating = Robot(base.name, base.joints, np.zeros(3), base.drives, base.description, base.inertias)
    with pytest.raises(UnknownEffectError, match="no joint"):
        columns_of([EffectChoice("base_tilt")], Signals(floating))


def test_an_unknown_shape_constant_is_answered_with_those_there_are():
    with pytest.raises(UnknownEffectError, match=r"no shape constant 'delta'.*vs"):
        columns_of([EffectChoice("stribeck", shape=(("delta", 2.0),))], Signals(arm("ur10")))


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
    ],
)
def test_an_impossible_shape_constant_is_refused(effect, shape):
    with pytest.raises(UnknownEffectError, match=shape[0]):
        columns_of([EffectChoice(effect, (), (shape,))], Signals(arm("ur10")))


def test_a_joint_named_twice_counts_once():
    robot = arm("ur10")
    name = robot.joint_names[1]
    assert joints_of(EffectChoice("coulomb", (name, name)), robot) == (1,)


def test_the_default_effects_are_links_rotors_and_plain_friction():
    assert [choice.effect for choice in DEFAULT_EFFECTS] == ["rigid_body", "rotor_inertia", "coulomb", "viscous"]
