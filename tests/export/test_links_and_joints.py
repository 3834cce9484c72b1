"""URDF and MJCF, read back by the programs they are for, give the identified torque."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.exported_robots import OWN, moving, torque_of_mjcf, torque_of_urdf
from support.models_with_chosen_parameters import (
    PLAIN,
    FloatArray,
    drives,
    from_standard,
    made_up,
    measured,
    measured_like,
    path,
    predicted,
    with_bodies,
)
from support.oracles import arm, crooked_urdf, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.export.feasible_completion import complete_parameters
from dynident.export.feasible_links_and_joints import FeasibleLinks
from dynident.export.mjcf import to_mjcf
from dynident.export.urdf import ROTOR_TAG, to_urdf
from dynident.identification import Identification, identify
from dynident.robot import Robot, robot_from_urdf
from dynident.robot.pseudo_inertia import pseudo_inertia
from dynident.robot.robot_model import INERTIAL_NAMES

TREE = robot_from_urdf("tree", crooked_urdf(7, 3, (1, 5), (-1, 0, 1, 1, 0, 4, 5)))
ROBOTS = {"a serial arm": arm("ur10"), "a sliding joint": arm("scara"), "a tree": TREE, "axes askew": arm("crooked")}


def identified(robot: Robot, seed: int = 0) -> Identification:
    return from_standard(robot, drives(robot, seed))


def assert_same(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
def test_a_urdf_read_back_gives_the_identified_torque(robot: Robot) -> None:
    model, motion = identified(robot), path(robot)
    assert_same(torque_of_urdf(to_urdf(model).content.decode(), robot.gravity, motion), predicted(model, motion))


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
def test_mujoco_gives_the_identified_torque(robot: Robot) -> None:
    model, motion = identified(robot), path(robot)
    used = moving(motion)
    assert used.sum() > 20
    found = torque_of_mjcf(to_mjcf(model).content.decode(), motion)
    assert_same(found[used], predicted(model, motion)[used])


@settings(max_examples=12, deadline=None)
@given(st.data())
def test_arms_drawn_at_random_survive_both_formats(data: st.DataObject) -> None:
    n = data.draw(st.integers(1, 6))
    parents = tuple(data.draw(st.integers(-1, k - 1)) if k else -1 for k in range(n))
    sliding = tuple(data.draw(st.sets(st.integers(0, n - 1), max_size=2)))
    seed = data.draw(st.integers(0, 1000))
    robot = with_bodies(robot_from_urdf("drawn", crooked_urdf(n, seed, sliding, parents)), seed)
    model, motion = identified(robot, seed), path(robot, 60, seed)
    expected = predicted(model, motion)
    assert_same(torque_of_urdf(to_urdf(model).content.decode(), robot.gravity, motion), expected)
    used = moving(motion)
    assert_same(torque_of_mjcf(to_mjcf(model).content.decode(), motion)[used], expected[used])


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
@pytest.mark.parametrize("merged", [False, True])
def test_standard_parameters_are_feasible_and_give_the_base_parameters_exactly(robot: Robot, merged: bool) -> None:
    model = identified(robot, 4)
    found = complete_parameters(model, rotors_in_links=merged)
    assert found.exact
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(found.inertias)) > 0)
    for name in ("rotors", "coulomb", "viscous"):
        assert np.all(getattr(found, name) >= 0)
    of_joint = {"Ia": found.rotors, "Fc": found.coulomb, "Fv": found.viscous}
    standard = []
    for column in model.model.columns:
        j = robot.joint_names.index(column.link)
        rigid = column.effect == "rigid_body"
        place = INERTIAL_NAMES.index(column.parameter) if rigid else 0
        standard.append(found.inertias[j, place] if rigid else of_joint[column.parameter][j])
    base = model.model.base.grouping @ np.array(standard)
    np.testing.assert_allclose(base, model.values, rtol=1e-9, atol=1e-12)


def test_what_is_right_in_the_description_stays() -> None:
    robot = arm("ur10")
    found = complete_parameters(from_standard(robot))
    np.testing.assert_allclose(found.inertias, robot.inertias, atol=0.02)
    np.testing.assert_allclose(found.inertias[:, 9], robot.inertias[:, 9], rtol=0.01)


def test_rotors_that_can_be_said_of_the_links_are_no_rotors_in_a_urdf() -> None:
    robot = arm("ur10")
    text = to_urdf(identified(robot)).content.decode()
    joints = {joint.get("name"): joint for joint in ElementTree.fromstring(text).findall("joint")}
    have = [name for name, joint in joints.items() if joint.find(ROTOR_TAG) is not None]
    # Ia1 and Ia2 group with ZZ1 and ZZ2; those of the joints behind are base parameters of their own.
    assert have == list(robot.joint_names[2:])


def test_the_rest_of_the_users_urdf_stays_as_it_was() -> None:
    robot = robot_from_urdf("mine", OWN, locked_joints={"grip": 0.02})
    exported = to_urdf(identified(robot))
    text = exported.content.decode()
    for kept in (
        "<!-- my arm -->",
        'filename="package://mine/upper.stl"',
        "<transmission",
        "selfCollide",
        "xmlns:xacro",
    ):
        assert kept in text
    root = ElementTree.fromstring(text)
    links = {link.get("name"): link for link in root.iter("link")}
    assert links["base"].find("inertial/mass").get("value") == "5"
    assert [name for name, link in links.items() if link.find("inertial") is not None] == ["base", "upper", "fore"]
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    assert joints["shoulder"].find("dynamics").get("note") == "kept"
    assert joints["grip"].get("type") == "fixed"
    assert any("grip at 0.02" in note for note in exported.notes)
    assert re.search(r"<!--[^>]*grip at 0\.02", text, re.DOTALL)
    model, motion = identified(robot), path(robot)
    assert_same(torque_of_urdf(text, robot.gravity, motion), predicted(model, motion))


def test_the_base_of_a_description_in_grams_is_in_kilograms() -> None:
    def multiply(found: re.Match[str]) -> str:
        return f'{found[1]}="{1000.0 * float(found[2])}"'

    grams = re.sub(r'(value|i[xyz][xyz])="([\d.]+)"', multiply, OWN)
    exported = to_urdf(identified(robot_from_urdf("mine", grams, locked_joints={"grip": 0.02})))
    links = {link.get("name"): link for link in ElementTree.fromstring(exported.content.decode()).iter("link")}
    assert float(links["base"].find("inertial/mass").get("value")) == pytest.approx(5.0)
    assert float(links["base"].find("inertial/inertia").get("ixx")) == pytest.approx(1.0)
    assert any("masses seem to be in g" in note and "SI units" in note for note in exported.notes)


def test_a_link_may_be_called_as_mujocos_world() -> None:
    robot = robot_from_urdf("mine", OWN.replace('"world"', '"root"').replace('"fore"', '"world"'))
    model, motion = identified(robot), path(robot)
    found, rows = torque_of_mjcf(to_mjcf(model).content.decode(), motion), moving(motion)
    assert_same(found[rows], predicted(model, motion)[rows])


def test_every_joint_of_a_differential_has_a_rotor_of_its_own() -> None:
    several = '<joint name="shoulder"/><joint name="elbow"/><actuator name="m1"/><actuator name="m2"/>'
    robot = robot_from_urdf("mine", OWN.replace('<joint name="shoulder"/></trans', f"{several}</trans"))
    root = ElementTree.fromstring(to_urdf(identified(robot)).content.decode())
    own = {}
    for transmission in root.findall("transmission"):
        named = [joint.get("name") for joint in transmission.findall("joint")]
        values = [child.get("value") for child in transmission.iter("{http://drake.mit.edu}rotor_inertia")]
        assert len(values) == (1 if len(named) == 1 else 0)
        own |= dict(zip(named, values, strict=False))
    rotors = {joint.get("name"): joint.find(ROTOR_TAG) for joint in root.findall("joint")}
    assert {name: float(value) for name, value in own.items()} == {
        name: 0.0 if rotors[name] is None else float(rotors[name].get("inertia")) for name in robot.joint_names
    }


@pytest.mark.parametrize("locked", [{"elbow": 0.7}, {"shoulder": -0.4, "grip": 0.01}, {"shoulder": 1.1, "elbow": 2.5}])
def test_joints_are_fixed_where_they_were_locked(locked: dict[str, float]) -> None:
    robot = robot_from_urdf("mine", OWN, locked_joints=locked, gravity=[1.0, -2.0, -9.0])
    model, motion = identified(robot), path(robot)
    read = robot_from_urdf("read back", text := to_urdf(model).content.decode())
    assert read.joint_names == robot.joint_names
    assert_same(torque_of_urdf(text, robot.gravity, motion), predicted(model, motion))
    assert any("no gravity" in note for note in to_urdf(model).notes)


def test_effects_that_a_format_has_no_words_for_are_named_in_the_file() -> None:
    robot = arm("scara")
    known = from_standard(robot, drives(robot) | {f"b{j}": 0.5 for j in (1, 2, 4)}, (*PLAIN, "offset"))
    for write in (to_urdf, to_mjcf):
        exported = write(known)
        assert any("Torque offset" in note for note in exported.notes)
        assert "Torque offset is not in this file" in exported.content.decode()


def test_mujoco_has_springs() -> None:
    robot = arm("ur10")
    spring = {"ks2": 30.0, "bs2": -12.0}
    model = from_standard(robot, drives(robot) | spring, (*PLAIN, "joint_spring"))
    # Springs of the other joints are none at all.
    model = without_springs_but(model, "ks2", "bs2")
    motion = path(robot)
    used = moving(motion)
    found = torque_of_mjcf(to_mjcf(model).content.decode(), motion)
    assert_same(found[used], predicted(model, motion)[used])


def without_springs_but(model: Identification, *kept: str) -> Identification:
    names = [column.name for column in model.model.kept]
    joint = model.model.robot.joint_names[int(kept[0][-1]) - 1]
    effects = (*PLAIN, EffectChoice("joint_spring", (joint,)))
    smaller = made_up(model.model.robot, effects)
    own = [column.name for column in smaller.model.kept]
    return made_up(model.model.robot, effects, np.array([model.values[names.index(name)] for name in own]))


def test_a_spring_that_pushes_away_is_refused() -> None:
    model = without_springs_but(
        from_standard(arm("ur10"), drives(arm("ur10")) | {"ks2": -3.0}, (*PLAIN, "joint_spring")), "ks2"
    )
    with pytest.raises(DynidentError, match="stiffness -3"):
        to_mjcf(model)


def test_parameters_that_no_body_has_are_refused_with_the_link_and_the_way_out() -> None:
    poor = measured("ur10", noise=2.0)
    with pytest.raises(DynidentError) as refused:
        to_urdf(poor)
    assert "wrist" in refused.value.detail
    assert '"feasible"' in refused.value.detail
    for write in (to_urdf, to_mjcf):
        exported = write(poor, nearest=True)
        assert any("nearest" in note and "N m" in note for note in exported.notes)
    read = robot_from_urdf("read back", to_urdf(poor, nearest=True).content.decode())
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(read.inertias)) > 0)


def test_the_nearest_feasible_model_predicts_nearly_as_well() -> None:
    poor = measured("ur10", noise=2.0)
    found = complete_parameters(poor, nearest=True)
    assert not found.exact
    motion = path(poor.model.robot, 300)
    change = predicted(poor, motion) - predicted(made_up(poor.model.robot, PLAIN, found.values), motion)
    assert 0 < np.sqrt((change**2).mean()) < 2.0


def test_friction_that_drives_is_refused() -> None:
    robot = arm("scara")
    model = measured_like(from_standard(robot, drives(robot) | {"Fv2": -0.4}))
    with pytest.raises(DynidentError, match=r"Fv2 of elbow \(friction of -0.4"):
        to_urdf(model)
    assert 0 <= complete_parameters(model, nearest=True).viscous[1] < 1e-3


def test_a_rotor_below_zero_is_refused_by_name() -> None:
    robot = arm("ur10")
    model = from_standard(robot, drives(robot) | {"Ia5": -0.2})
    with pytest.raises(DynidentError, match=f"rotor of {robot.joint_names[4]}"):
        to_mjcf(model)


def test_a_model_without_links_is_told_what_can_hold_it() -> None:
    with pytest.raises(DynidentError, match="C code"):
        to_urdf(made_up(arm("scara"), ("coulomb", "viscous")))


def test_rounded_right_angles_do_not_show_in_the_torque() -> None:
    text = re.sub(r'axis xyz="[^"]*"', 'axis xyz="0 0 1"', crooked_urdf(4, 1, ()))
    robot = with_bodies(robot_from_urdf("rounded", re.sub(r'rpy="[^"]*"', 'rpy="1.5708 0 0"', text)))
    model, motion = identified(robot), path(robot)
    used = moving(motion)
    for write in (to_urdf, to_mjcf):
        assert not any("rounded" in note for note in write(model).notes)
    found = torque_of_mjcf(to_mjcf(model).content.decode(), motion)
    assert_same(found[used], predicted(model, motion)[used])
    # With a rotor of its own, the first joint's torque would differ by what the base parameters leave out.
    apart = FeasibleLinks.from_model(model, (), nearest=False)
    assert 1e-9 < apart.rounding_error < 1e-6
    assert any("rounded" in note for note in apart.notes)


@pytest.mark.parametrize("name", ["ur10", "scara"])
def test_what_the_feasible_estimator_gives_can_be_exported_exactly(name: str) -> None:
    model = measured(name, noise=2.0, estimator="feasible")
    assert complete_parameters(model).exact
    motion = path(model.model.robot)
    for text, used in (
        (
            torque_of_urdf(to_urdf(model).content.decode(), model.model.robot.gravity, motion),
            np.ones(len(motion.t), bool),
        ),
        (torque_of_mjcf(to_mjcf(model).content.decode(), motion), moving(motion)),
    ):
        assert_same(text[used], predicted(model, motion)[used])


def test_what_is_there_in_some_runs_only_is_no_part_of_the_links() -> None:
    robot = arm("scara")
    always, heavy = (
        from_standard(robot, drives(robot)),
        EffectChoice("rigid_body", (robot.joint_names[-1],), (), ("heavy",)),
    )
    sticky = EffectChoice("coulomb", (), (), ("heavy",))
    both = made_up(robot, (*PLAIN, heavy, sticky))
    names = [column.name for column in always.model.kept]
    values = np.array(
        [always.values[names.index(column.name)] if not column.runs else -0.3 for column in both.model.kept]
    )
    both = made_up(robot, (*PLAIN, heavy, sticky), values)
    found, alone = complete_parameters(both), complete_parameters(always)
    np.testing.assert_allclose(found.inertias, alone.inertias, atol=1e-6)
    np.testing.assert_allclose(found.coulomb, alone.coulomb)
    assert sum("in heavy" in note for note in to_urdf(both).notes) == 2


def test_a_link_that_is_a_point_is_refused_by_name_rather_than_by_mujoco() -> None:
    robot = arm("ur10")
    flat = robot.inertias.copy()
    flat[5] = [4e-4, 0, 0, 4e-4, 0, 0, 0, 0, 8e-3, 0.16]
    model = from_standard(replace(robot, inertias=flat), drives(robot))
    with pytest.raises(DynidentError, match=robot.joint_names[5]):
        to_mjcf(model)


def test_a_prior_is_what_open_parameters_stay_near_to() -> None:
    robot = arm("ur10")
    motion = fourier_motion(robot, 20.0, 100.0, 2)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    tau = tau + np.sign(motion.dq) + 1.5 * motion.dq + 0.3 * motion.ddq
    choices = replace(measured().choices, estimator="wls", prior="description")
    model = identify(robot, [record(robot, motion, tau)], [], choices)
    found = complete_parameters(model)
    assert found.exact
    np.testing.assert_allclose(found.inertias[:, 9], robot.inertias[:, 9], rtol=0.02)


@pytest.mark.parametrize("stated", ["", ' type="pr2_mechanism_model/SimpleTransmission"'])
def test_a_transmission_without_a_type_gets_one_since_drake_reads_no_other(stated: str) -> None:
    bare = OWN.replace("<transmission", f"<transmission{stated}")
    assert "<transmission" in bare
    assert "<type>" not in bare
    root = ElementTree.fromstring(to_urdf(identified(robot_from_urdf("mine", bare))).content.decode())
    kinds = {found.get("type") or found.findtext("type") for found in root.findall("transmission")}
    usual = {"transmission_interface/SimpleTransmission"}
    assert kinds == (usual if not stated else usual | {"pr2_mechanism_model/SimpleTransmission"})
