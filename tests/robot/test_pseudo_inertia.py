"""The pseudo-inertia against Pinocchio's, and against masses summed one by one; units of described masses."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.oracles import FROM_PINOCCHIO

from dynident.robot import robot_from_urdf
from dynident.robot.pseudo_inertia import (
    find_description_units,
    inertial_parameters,
    pseudo_inertia,
    smallest_pseudo_inertia,
)


def of_points(points: np.ndarray, masses: np.ndarray) -> np.ndarray:
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for r, m in zip(points, masses, strict=True))
    upper = inertia[np.triu_indices(3)]
    return np.concatenate([upper, masses @ points, [masses.sum()]])


def test_it_is_the_second_moment_of_the_mass_in_homogeneous_coordinates():
    rng = np.random.default_rng(1)
    points, masses = rng.normal(size=(8, 3)), rng.uniform(0.1, 2, 8)
    wide = np.column_stack([points, np.ones(8)])
    expected = (wide * masses[:, None]).T @ wide
    np.testing.assert_allclose(pseudo_inertia(of_points(points, masses)), expected, atol=1e-12)


def test_it_is_pinocchios():
    inertia = pin.Inertia.Random()
    expected = pin.PseudoInertia.FromInertia(inertia).toMatrix()
    parameters = inertia.toDynamicParameters()[FROM_PINOCCHIO]
    np.testing.assert_allclose(pseudo_inertia(parameters), expected, atol=1e-12)


@settings(max_examples=50)
@given(st.lists(st.floats(-100, 100), min_size=10, max_size=10))
def test_parameters_come_back_from_it(values):
    parameters = np.array(values)
    np.testing.assert_allclose(inertial_parameters(pseudo_inertia(parameters)), parameters, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_bodies_that_exist_have_none_below_zero(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    parameters = of_points(rng.normal(size=(count, 3)), rng.uniform(0.01, 5, count))
    assert smallest_pseudo_inertia(parameters) > -1e-8


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("negative mass", {9: -1.0}),
        ("triangle inequality", {0: 5.0}),
        ("centre of mass outside of what the inertia allows", {6: 3.0}),
    ],
)
def test_bodies_that_cannot_exist_show_below_zero(what, change):
    parameters = np.array([1.0, 0, 0, 1.0, 0, 1.0, 0, 0, 0, 1.0])
    assert smallest_pseudo_inertia(parameters) > 0.1
    for index, value in change.items():
        parameters[index] = value
    assert smallest_pseudo_inertia(parameters) < 0, what


@pytest.mark.parametrize(("mass", "offset", "pedestal"), [(6.0, 0.05, 0.0), (30.0, 0.15, 0.0), (120.0, 0.0, 0.2)])
def test_the_masses_of_a_mount_of_two_axes_are_not_said_to_be_in_grams(
    mass: float, offset: float, pedestal: float
) -> None:
    inertia = f'<inertia ixx="{0.01 * mass}" ixy="0" ixz="0" iyy="{0.01 * mass}" iyz="0" izz="{0.01 * mass}"/>'
    body = f'<inertial><origin xyz="0 0 0.02"/><mass value="{mass / 2}"/>{inertia}</inertial>'
    mount = robot_from_urdf(
        "mount",
        f'<robot name="mount"><link name="base"/><link name="pan">{body}</link><link name="tilt">{body}</link>'
        f'<joint name="j1" type="continuous"><origin xyz="0 0 {pedestal}"/><axis xyz="0 0 1"/><parent link="base"/>'
        f'<child link="pan"/></joint><joint name="j2" type="continuous"><origin xyz="0 0 {offset}"/>'
        '<axis xyz="0 1 0"/><parent link="pan"/><child link="tilt"/></joint></robot>',
    )
    assert find_description_units(mount) is None
