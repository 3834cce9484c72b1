"""The smallest set of parameters that determines the model, and how the others group into it."""

from __future__ import annotations

import copy
import re
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.oracles import ARMS, arm, crooked_urdf, pinocchio_rows, random_states

from dynident.effects import CATALOGUE, Column, EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.effects.effect_signals import DAHL, MemorySignal, RunSignal
from dynident.expressions import compiled_expressions
from dynident.expressions.compiled_expressions import Compiled
from dynident.regressors.base_parameters import evaluate_at_random_states, find_base_parameters, select_base
from dynident.regressors.model_structure import build_model, extend_model, find_inertial_base_parameters, get_model
from dynident.regressors.observation_matrix import Observation
from dynident.robot import robot_from_urdf

# Published ranks (Panda: Gaz et al. 2019; UR10: Gaz, Magrini and De Luca 2018) and numpy's for the others.
RANKS = {"franka_panda": 43, "ur10": 36}


@pytest.mark.parametrize("name", ARMS)
def test_the_number_of_base_inertial_parameters_is_the_rank_of_pinocchios_regressor(name):
    robot = arm(name)
    base = find_inertial_base_parameters(robot)
    rows = pinocchio_rows(robot, *random_states(robot, 60)).reshape(-1, 10 * robot.n)
    norms = np.linalg.norm(rows, axis=0)
    scaled = rows[:, norms > 1e-8 * norms.max()] / norms[norms > 1e-8 * norms.max()]
    singular = np.linalg.svd(scaled, compute_uv=False)
    assert base.count == base.rank == np.count_nonzero(singular > 1e-8 * singular[0])
    assert base.count == RANKS.get(name, base.count)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("effects", [("rigid_body",), ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset")])
def test_base_parameters_of_any_standard_parameters_give_the_same_torque(name, effects):
    robot = arm(name)
    model = build_model(robot, [EffectChoice(effect) for effect in effects])
    states = random_states(robot, 50, 99)
    standard = np.random.default_rng(1).normal(size=len(model.columns))
    entries = model.observation.evaluate(
        *states, reference=ReferenceParameters.massless(robot), memory=np.zeros((50, 0))
    )
    found = model.observation.compute_torque(entries, model.base.grouping @ standard)
    expected = pinocchio_rows(robot, *states) @ standard[: 10 * robot.n]
    _, dq, ddq = states
    if len(effects) > 1:
        ia, fc, fv, b = standard[10 * robot.n :].reshape(4, robot.n)
        expected = expected + ia * ddq + fc * np.sign(dq) + fv * dq + b
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@settings(max_examples=8, deadline=None)
@given(data=st.data(), n=st.integers(1, 5), seed=st.integers(0, 1000))
def test_grouping_holds_for_any_tree_of_crooked_joints(data, n, seed):
    parents = tuple(data.draw(st.integers(-1, k - 1)) for k in range(n))
    sliding = tuple(k for k in range(n) if data.draw(st.booleans()))
    robot = robot_from_urdf("tree", crooked_urdf(n, seed, sliding, parents))
    base = find_inertial_base_parameters(robot)
    states = random_states(robot, 40, 5)
    rows = pinocchio_rows(robot, *states).reshape(-1, 10 * n)
    standard = np.random.default_rng(2).normal(size=10 * n)
    expected = rows @ standard
    found = rows[:, list(base.kept)] @ (base.grouping @ standard)
    np.testing.assert_allclose(found, expected, atol=1e-7 * max(1.0, np.abs(expected).max()))


def random_matrix(seed: int, rank: int = 6, columns: int = 10) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(80, rank)) @ rng.normal(size=(rank, columns))


NAMES = tuple("abcdefghij")


@given(seed=st.integers(0, 10_000), scales=st.lists(st.floats(1e-3, 1e3), min_size=10, max_size=10))
@settings(max_examples=50, deadline=None)
def test_units_of_the_columns_do_not_change_the_choice(seed, scales):
    w = random_matrix(seed)
    plain, scaled = select_base(w, NAMES), select_base(w * scales, NAMES)
    assert plain.kept == scaled.kept
    # χ' = χ / scale, so that W' χ' = W χ; the base parameters scale like their leading column.
    chi = np.random.default_rng(seed).normal(size=10)
    np.testing.assert_allclose(
        scaled.grouping @ (chi / scales) * np.array(scales)[list(scaled.kept)],
        plain.grouping @ chi,
        rtol=1e-6,
        atol=1e-8,
    )


@given(seed=st.integers(0, 10_000), order=st.permutations(range(10)))
@settings(max_examples=50, deadline=None)
def test_the_order_of_columns_changes_the_choice_but_not_the_number_or_the_torque(seed, order):
    w = random_matrix(seed)
    base = select_base(w[:, order], tuple(NAMES[k] for k in order))
    assert base.count == 6
    assert base.kept == tuple(sorted(base.kept))
    chi = np.random.default_rng(seed).normal(size=10)
    np.testing.assert_allclose(
        w[:, order][:, list(base.kept)] @ (base.grouping @ chi), w[:, order] @ chi, atol=1e-8 * np.abs(w).max() * 30
    )


@given(seed=st.integers(0, 10_000), order=st.permutations(range(80)))
@settings(max_examples=25, deadline=None)
def test_the_order_of_rows_changes_nothing(seed, order):
    w = random_matrix(seed)
    assert select_base(w[order], NAMES).kept == select_base(w, NAMES).kept


def test_earlier_columns_are_preferred():
    w = np.random.default_rng(0).normal(size=(30, 3))
    base = select_base(np.column_stack([w[:, 0], w[:, 1], w[:, 0] + 2 * w[:, 1], w[:, 2]]), tuple("pqrs"))
    assert base.kept_names == ("p", "q", "s")
    assert base.groupings == ("p + r", "q + 2 r", "s")


def test_columns_without_effect_are_named_and_not_kept():
    w = np.random.default_rng(0).normal(size=(30, 3))
    w[:, 1] = 1e-12
    base = select_base(w, tuple("pqr"))
    assert base.without_effect == (1,)
    assert base.kept == (0, 2)
    assert not base.grouping[:, 1].any()


def test_no_columns_at_all_are_no_base_parameters():
    base = select_base(np.empty((20, 0)), ())
    assert (base.count, base.rank, base.groupings) == (0, 0, ())


def test_the_first_link_of_an_upright_arm_shows_only_its_inertia_about_the_axis():
    robot = arm("ur10")
    base = find_inertial_base_parameters(robot)
    names = [column.name for column in build_columns([EffectChoice("rigid_body")], Signals(robot))]
    first = [name for name in base.kept_names if name.endswith("1")]
    assert first == ["ZZ1"]
    first = {names[k] for k in base.without_effect if names[k].endswith("1")}
    assert first == {"XX1", "XY1", "XZ1", "YY1", "YZ1", "MX1", "MY1", "MZ1", "M1"}
    # The second axis crosses the first: a mass on it turns about neither.
    assert {names[k] for k in base.without_effect} - first == {"MZ2", "M2"}


def test_groupings_read_like_formulas():
    model = build_model(arm("ur10"), [EffectChoice(e) for e in ("rigid_body", "rotor_inertia", "coulomb", "viscous")])
    word = r"[A-Z][A-Za-z]*\d+"
    factor = r"\d+(?:\.\d+)?(?:e-?\d+)? "
    pattern = re.compile(rf"{word}(?: [+-] (?:{factor})?{word})*")
    for grouping in model.base.groupings:
        assert pattern.fullmatch(grouping), grouping
    written = dict(zip(model.base.kept_names, model.base.groupings, strict=True))
    assert "Ia1" in written["ZZ1"].split(" + ")
    assert written["Fc3"] == "Fc3"


def test_grouping_of_two_parallel_joints_is_the_textbooks():
    # Two parallel axes a distance d apart: Khalil's regrouping gives M2 d² to ZZ1 (and d M2 to MX1), by [9.60].
    robot = robot_from_urdf(
        "two",
        '<robot name="two"><link name="base"/><link name="a"/><link name="b"/>'
        '<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="2" effort="9"/></joint>'
        '<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="2" effort="9"/></joint></robot>',
    )
    base = find_inertial_base_parameters(robot)
    assert base.groupings == ("ZZ1 + 0.25 M2", "ZZ2", "MX2", "MY2")


def test_rounded_right_angles_add_no_ghost_parameters():
    exact = arm("ur10")
    tilt = "1.5708"
    axes = ("0 0 0", f"{tilt} 0 0", "0 0 0", "0 0 0", f"{tilt} 0 0", f"-{tilt} 0 0")
    offsets = ("0 0 0.128", "0 0.176 0", "0 -0.128 0.612", "0 0 0.5723", "0 0.1149 0", "0 0 0.1157")
    links = ['<robot name="rounded"><link name="l0"/>']
    for k, (rpy, xyz) in enumerate(zip(axes, offsets, strict=True)):
        links.append(
            f'<link name="l{k + 1}"/><joint name="j{k + 1}" type="revolute"><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
            '<limit lower="-3" upper="3" velocity="2" effort="90"/></joint>'
        )
    text = "".join(links) + "</robot>"
    robot = robot_from_urdf("rounded", text)
    right = robot_from_urdf("right", text.replace("1.5708", repr(np.pi / 2)))
    # Also where nothing has mended the angles on the way in: the tolerance alone has to do.
    unmended = robot_from_urdf("rough", text, rounding_tolerance=0.0)
    assert find_inertial_base_parameters(right).count == 36 == find_inertial_base_parameters(exact).count
    assert find_inertial_base_parameters(robot).count == 36
    assert find_inertial_base_parameters(unmended).count == 36


def test_a_choice_of_base_parameters_does_not_depend_on_the_random_states():
    robot = arm("franka_panda")
    signals = Signals(robot)
    columns = build_columns([EffectChoice("rigid_body"), EffectChoice("rotor_inertia")], signals)
    first, second = (find_base_parameters(robot, columns, signals, seed=seed) for seed in (0, 1))
    assert first.kept == second.kept
    np.testing.assert_allclose(first.grouping, second.grouping, atol=1e-6)


def test_first_order_columns_among_others_stand_in_their_places_and_are_compiled_once(monkeypatch):
    model = build_model(arm("ur10"), [EffectChoice("rigid_body"), EffectChoice("coulomb")])
    signals, joint = model.signals, model.robot.joint_names[:1]

    def columns(waves: float) -> list[Column]:
        ripple = EffectChoice("torque_ripple", joint, (("k", waves),))
        choices = [
            EffectChoice("torque_delay"),
            ripple,
            EffectChoice("payload"),
            EffectChoice("encoder_zero_error", joint),
        ]
        return build_columns(choices, signals)

    whole = Observation.from_columns(model.robot, [*model.kept, *columns(7.0)], signals)
    expected = evaluate_at_random_states(whole, 20)
    sizes: list[int] = []

    def compile_counted(serialised: str, *others: Any) -> Compiled:
        sizes.append(casadi.Function.deserialize(serialised).n_instructions())
        return Compiled(serialised, *others)

    # Another wave is other code; the derivatives of the whole torque, and the load's torque, are those that are there.
    monkeypatch.setattr(compiled_expressions, "_compile", lru_cache(compile_counted))
    extended = model.observation.extend(columns(7.0), signals)
    assert [column.key for column in extended.columns] == [column.key for column in whole.columns]
    np.testing.assert_allclose(evaluate_at_random_states(extended, 20), expected, rtol=1e-9, atol=1e-9)
    assert max(sizes) > 1000
    sizes.clear()
    evaluate_at_random_states(model.observation.extend(columns(9.5), signals), 20)
    assert len(sizes) == 1
    assert max(sizes) < 100


def test_models_of_one_robot_share_their_columns_and_not_the_states_that_are_added_to_one_of_them():
    robot, effects = arm("ur10"), [EffectChoice("rigid_body"), EffectChoice("coulomb")]
    first, second, built = get_model(robot, effects), get_model(robot, effects), build_model(robot, effects)
    assert second.observation is first.observation
    assert second.at_rest is first.at_rest
    np.testing.assert_array_equal(
        evaluate_at_random_states(first.observation, 20), evaluate_at_random_states(built.observation, 20)
    )
    presliding = EffectChoice("presliding", robot.joint_names[:1], (("d0", 0.01), ("law", 1.0)))
    columns = build_columns([presliding], first.signals)
    assert first.signals.memory_signals
    assert second.signals.memory_signals == ()
    assert build_columns([presliding], second.signals) == columns
    assert second.signals.memory_signals == first.signals.memory_signals
    # A state that only one of them has is named as none of the other's is.
    for signals, slip in ((first.signals, 0.02), (second.signals, 0.03)):
        signals.memory(MemorySignal(DAHL, 0, slip))
    names = {symbol.name() for one in (first, second) for symbol in casadi.symvar(one.signals.memory_symbols)}
    assert len(names) == 3
    assert get_model(arm("franka_panda"), effects).robot.n == 7
    again = type("Again", (type(CATALOGUE["coulomb"]),), {"id": "coulomb"})()
    with CATALOGUE.add_temporarily(again):
        assert get_model(robot, effects).observation is not first.observation
    assert get_model(robot, effects).observation is first.observation


def test_models_that_are_extended_alike_share_their_columns_and_not_the_states_that_are_added_to_one_of_them():
    robot, effects = arm("ur10"), [EffectChoice("rigid_body"), EffectChoice("coulomb")]
    presliding = EffectChoice("presliding", robot.joint_names[:1], (("d0", 0.01), ("law", 1.0)))
    models = [get_model(robot, effects) for _ in range(2)]
    first, second = (extend_model(model, [presliding]) for model in models)
    assert second.observation is first.observation
    assert second.at_rest is first.at_rest
    assert first.observation.parts[0] is models[0].observation
    # The model that was extended has no state of what was added, and the extended ones have none of each other's.
    assert models[0].signals.memory_signals == ()
    first.signals.memory(MemorySignal(DAHL, 1, 0.02))
    assert len(second.signals.memory_signals) == 1
    viscous = EffectChoice("viscous", robot.joint_names[:1])
    assert extend_model(second, [viscous]).observation is extend_model(first, [viscous]).observation
    again = type("Again", (type(CATALOGUE["presliding"]),), {"id": "presliding"})()
    with CATALOGUE.add_temporarily(again):
        assert extend_model(models[0], [presliding]).observation is not first.observation
    assert extend_model(models[0], [presliding], tolerance=1e-3).observation is not first.observation


def test_a_run_is_the_same_in_a_model_and_in_its_extensions():
    robot = arm("ur10")
    model = get_model(robot, [EffectChoice("rigid_body")])
    extended = extend_model(model, [EffectChoice("joint_spring")])
    monday, friday = RunSignal(("monday",)), RunSignal(("friday",))
    symbol, other = model.signals.in_runs(monday), extended.signals.in_runs(friday)
    assert extended.signals.find_run_signals(symbol + other) == (monday, friday)
    assert casadi.is_equal(extended.signals.in_runs(monday), symbol)


def wait_for_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let two threads make their next symbols at the same moment."""
    barrier, make = threading.Barrier(2), casadi.SX.sym

    def make_together(*arguments):
        with suppress(threading.BrokenBarrierError):
            barrier.wait(2.0)
        return make(*arguments)

    monkeypatch.setattr(casadi.SX, "sym", staticmethod(make_together))


def test_threads_that_name_states_and_runs_at_once_name_them_differently(monkeypatch):
    robot, effects = arm("ur10"), [EffectChoice("rigid_body")]
    models = [get_model(robot, effects) for _ in range(2)]
    states = [MemorySignal(DAHL, 0, slip) for slip in (0.02, 0.03)]
    runs = [RunSignal((name,)) for name in ("monday", "friday")]
    wait_for_each_other(monkeypatch)
    with ThreadPoolExecutor(2) as threads:
        own = list(threads.map(lambda model, state: model.signals.memory(state), models, states))
        assert len({symbol.name() for symbol in own}) == 2
        # Also where both have the same model.
        signals = models[0].signals
        first, second = threads.map(signals.in_runs, runs)
        assert first.name() != second.name()
        first, second = threads.map(signals.in_runs, [RunSignal(("sunday",))] * 2)
        assert casadi.is_equal(first, second)
    monkeypatch.undo()
    # Each is the state of its own signal in every model.
    known = get_model(robot, effects).signals
    for state, symbol in zip(states, own, strict=True):
        assert casadi.is_equal(known.memory(state), symbol)
        assert known.find_memory_signals(symbol) == (state,)


def test_threads_that_build_the_same_at_once_get_what_the_first_has_built():
    models, barrier = [get_model(arm("ur10"), [EffectChoice("rigid_body")]) for _ in range(2)], threading.Barrier(2)

    def build():
        barrier.wait(10.0)
        return object(), casadi.SX(0)

    with ThreadPoolExecutor(2) as threads:
        first, second = threads.map(lambda model: model.signals.build_once("key of this test", build), models)
    assert first is second


def test_effects_may_be_chosen_by_lists():
    robot = arm("ur10")
    joint = robot.joint_names[0]
    listed = EffectChoice("stribeck", [joint], [["vs", 0.1], ["delta", 2.0]], ["monday"])
    assert listed == EffectChoice("stribeck", (joint,), (("vs", 0.1), ("delta", 2.0)), ("monday",))
    assert EffectChoice("stribeck", [joint], {"vs": 0.1, "delta": 2.0}, ["monday"]) == listed
    assert len({listed, replace(listed, joints=[joint])}) == 1
    assert get_model(robot, [EffectChoice("offset", [joint])]).n_parameters == 1


def test_what_is_written_into_a_robot_makes_another_model_of_it():
    robot, effects = arm("ur10"), [EffectChoice("rigid_body")]
    before = get_model(robot, effects).n_parameters
    # A copy, because other tests have the same robot.
    robot = copy.deepcopy(robot)
    assert get_model(robot, effects).n_parameters == before
    robot.gravity[:] = 0.0
    weightless = get_model(robot, effects)
    assert weightless.n_parameters == build_model(robot, effects).n_parameters < before
    for array in (robot.joints[2].placement, robot.joints[3].axis):
        known = get_model(robot, effects).observation
        assert known is get_model(robot, effects).observation
        array[:3] *= -1.0
        assert get_model(robot, effects).observation is not known
