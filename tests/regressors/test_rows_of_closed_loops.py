"""The regressor of machines with closed loops and tied joints against MuJoCo's and Pinocchio's constraints."""

from __future__ import annotations

import numpy as np
import pytest
from support.closed_loop_robots import MACHINES, accelerations_of_pinocchio, machine, states, torque_of_mujoco

from dynident.effects import EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.recordings import Preprocessing, recording_from_arrays
from dynident.recordings.joint_phases import Phase
from dynident.regressors.base_parameters import find_base_parameters
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.equation_forms import build_filtered_form, build_power_form
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.row_phases import RowPhases
from dynident.robot import Robot

LINKS = [EffectChoice("rigid_body")]


def torque(robot: Robot, q, dq, ddq) -> np.ndarray:
    signals = Signals(robot)
    observation = Observation.from_columns(robot, build_columns(LINKS, signals), signals)
    entries = observation.evaluate(
        q, dq, ddq, reference=ReferenceParameters.massless(robot), memory=np.zeros((len(q), 0))
    )
    return observation.compute_torque(entries, robot.inertias.reshape(-1))


@pytest.mark.sweep
@pytest.mark.parametrize("name", MACHINES)
def test_the_torque_is_that_of_mujoco_with_its_constraints(name: str) -> None:
    robot = machine(name)
    q, dq, ddq = states(robot, 40)
    expected = torque_of_mujoco(robot, *robot.linkage.compute_motion(q, dq, ddq))
    found = torque(robot, q, dq, ddq)
    assert np.abs(found - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("name", ["five_bar", "delta"])
def test_pinocchios_constrained_dynamics_gives_the_accelerations_back(name: str) -> None:
    robot = machine(name)
    q, dq, ddq = states(robot, 20)
    whole = robot.linkage.compute_motion(q, dq, ddq)
    tau = np.zeros_like(whole[0])
    tau[:, list(robot.linkage.driven)] = torque(robot, q, dq, ddq)
    found = accelerations_of_pinocchio(robot, whole[0], whole[1], tau)
    assert np.abs(found - whole[2]).max() < 1e-6 * np.abs(whole[2]).max()


@pytest.mark.parametrize("name", MACHINES)
def test_velocities_and_accelerations_of_passive_joints_are_the_derivatives_of_their_positions(name: str) -> None:
    linkage = machine(name).linkage
    q, dq, ddq = states(machine(name), 20)
    _, speed, acceleration = linkage.compute_motion(q, dq, ddq)
    h = 1e-4
    before, at, after = (linkage.compute_positions(q + s * dq + 0.5 * s**2 * ddq) for s in (-h, 0.0, h))
    assert np.abs((after - before) / (2 * h) - speed).max() < 1e-5 * np.abs(speed).max()
    assert np.abs((after - 2 * at + before) / h**2 - acceleration).max() < 1e-4 * np.abs(acceleration).max()


@pytest.mark.parametrize("name", ["five_bar", "palletiser"])
def test_energy_and_power_models_are_those_of_the_torque(name: str) -> None:
    robot = machine(name)
    signals = Signals(robot)
    columns = build_columns(LINKS, signals)
    q0, v, a = states(robot, 1, seed=4)
    h, k = 1e-4, robot.inertias.reshape(-1)
    s = h * np.arange(-2, 3)[:, None]
    q, dq = q0 + s * v + 0.5 * s**2 * a, v + s * a
    expected = torque(robot, q0, v, a)[0]
    for form, wanted in (
        (build_filtered_form(robot, columns, signals), expected),
        (build_power_form(robot, columns, signals), np.array([expected @ v[0]])),
    ):
        one, n = form.observation, form.n_equations
        entries = one.evaluate(
            q, dq, np.zeros_like(q), reference=ReferenceParameters.massless(robot), memory=np.zeros((5, 0))
        )
        both = one.compute_torque(entries, k)
        stored, direct = both[:, :n], both[2, n:]
        rate = (8 * (stored[3] - stored[1]) - stored[4] + stored[0]) / (12 * h)
        assert np.abs(rate + direct - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_a_parallelogram_groups_as_the_same_machine_with_tied_joints() -> None:
    from support.closed_loop_robots import palletiser

    from dynident.robot.modified_dh import robot_from_modified_dh

    table = palletiser()
    del table["loops"]
    for row in table["joints"]:
        row.pop("start", None)
    # The rod stays parallel to the arm, and the forearm to the lever, the other way round.
    for place, tie, theta in ((2, {"lever": 1, "arm": -1}, "pi"), (4, {"arm": 1, "lever": -1}, 0)):
        table["joints"][place] = {k: v for k, v in table["joints"][place].items() if k != "passive"}
        table["joints"][place] |= {"tie": tie, "theta": theta}
    tied, closed = robot_from_modified_dh("tied", table), machine("palletiser")
    q, dq, ddq = states(closed, 30)
    # MDH: positions of passive joints differ by the constant that theta takes; their links do not.
    expected = torque(tied, q, dq, ddq)
    assert np.abs(torque(closed, q, dq, ddq) - expected).max() < 1e-11 * np.abs(expected).max()
    bases = []
    for robot in (tied, closed):
        signals = Signals(robot)
        bases.append(find_base_parameters(robot, build_columns(LINKS, signals), signals))
    assert bases[0].kept_names == bases[1].kept_names
    np.testing.assert_allclose(bases[0].grouping, bases[1].grouping, atol=1e-6)


def test_a_parallelogram_has_the_base_parameters_of_its_crank_with_the_follower_and_the_masses_of_the_coupler() -> None:
    from support.closed_loop_robots import bar

    from dynident.robot.modified_dh import robot_from_modified_dh

    crank, coupler = 0.3, 0.5
    table = {
        "gravity": [0, -9.81, 0],
        "joints": [
            {"name": "crank", "antecedent": "base", "start": 1.0, "limits": {"position": [0.4, 2.6]}}
            | {"mass_properties": bar(crank, 2.0)},
            {"name": "coupler", "d": crank, "passive": True, "start": -1.0, "mass_properties": bar(coupler, 3.0)},
            {"name": "follower", "antecedent": "base", "d": coupler, "passive": True, "start": 1.0}
            | {"mass_properties": bar(crank, 1.5)},
        ],
        "loops": [
            {
                "name": "pin",
                "kind": "planar",
                "between": [{"joint": "coupler", "at": [coupler, 0, 0]}, {"joint": "follower", "at": [crank, 0, 0]}],
            }
        ],
    }
    robot = robot_from_modified_dh("parallelogram", table)
    signals = Signals(robot)
    base = find_base_parameters(robot, build_columns(LINKS, signals), signals)
    # The coupler goes round without turning: by hand, its mass sits at the end of the crank, and nothing else of it is
    # felt; the follower turns as the crank does.
    assert base.groupings == ("ZZ1 + 0.09 M2 + ZZ3", "MX1 + 0.3 M2 + MX3", "MY1 + MY3")
    by_name = dict(zip(base.names, range(len(base.names)), strict=True))
    felt = {name for name, k in by_name.items() if np.abs(base.grouping[:, k]).max(initial=0.0) > 1e-9}
    assert felt == {"ZZ1", "MX1", "MY1", "M2", "ZZ3", "MX3", "MY3"}


def test_a_five_bar_has_the_torque_of_a_model_derived_by_hand() -> None:
    robot = machine("five_bar")
    q, dq, ddq = states(robot, 30)
    # Kinetic and potential energy of four bars whose centres and angles are written down, and Lagrange's equations by
    # differences of the energy along neighbouring motions.
    l1, l2, base = 0.3, 0.4, 0.25
    masses = robot.inertias[:, 9]
    inertia = robot.inertias[:, 5]
    first = robot.inertias[:, 6:8]

    def pose(q1: float, q2: float) -> tuple[np.ndarray, np.ndarray]:
        a = l1 * np.array([np.cos(q1), np.sin(q1)])
        b = np.array([base, 0.0]) + l1 * np.array([np.cos(q2), np.sin(q2)])
        middle, apart = 0.5 * (a + b), b - a
        up = np.array([-apart[1], apart[0]]) / np.linalg.norm(apart)
        tip = middle + np.sqrt(l2**2 - 0.25 * apart @ apart) * up
        angles = np.array([q1, np.arctan2(*(tip - a)[::-1]), q2, np.arctan2(*(tip - b)[::-1])])
        return np.array([[0.0, 0.0], a, [base, 0.0], b]), angles

    def lagrangian(q: np.ndarray, v: np.ndarray) -> float:
        e = 1e-5
        points, angles = pose(*q)
        (ahead, turned), (behind, back) = pose(*(q + e * v)), pose(*(q - e * v))
        speeds, turns = (ahead - behind) / (2 * e), (turned - back) / (2 * e)
        total = 0.0
        for k in range(4):
            c, s = np.cos(angles[k]), np.sin(angles[k])
            arm = np.array([c * first[k, 0] - s * first[k, 1], s * first[k, 0] + c * first[k, 1]])
            kinetic = 0.5 * masses[k] * speeds[k] @ speeds[k] + 0.5 * inertia[k] * turns[k] ** 2
            kinetic += turns[k] * (speeds[k] @ np.array([-arm[1], arm[0]]))
            total += kinetic - 9.81 * (masses[k] * points[k, 1] + arm[1])
        return total

    def by_hand(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        h, d = 1e-3, np.eye(2) * 1e-3
        momentum = [
            [(lagrangian(p, w + d[j]) - lagrangian(p, w - d[j])) / (2 * d[j, j]) for j in range(2)]
            for p, w in ((q + t * v + 0.5 * t**2 * a, v + t * a) for t in (h, -h))
        ]
        force = [(lagrangian(q + d[j], v) - lagrangian(q - d[j], v)) / (2 * d[j, j]) for j in range(2)]
        return (np.array(momentum[0]) - np.array(momentum[1])) / (2 * h) - np.array(force)

    expected = np.array([by_hand(*state) for state in zip(q, dq, ddq, strict=True)])
    assert np.abs(torque(robot, q, dq, ddq) - expected).max() < 1e-3 * np.abs(expected).max()


def test_nothing_is_felt_of_what_happens_where_the_sign_of_a_passive_joints_friction_is_uncertain() -> None:
    robot = machine("five_bar")
    model = build_model(robot, [*LINKS, EffectChoice("coulomb", ("left_rod",))])
    t, filters = np.arange(0.0, 20.0, 0.004), Preprocessing(8.0, 8.0, 8)
    q = np.array([2.15, 0.95]) + 0.35 * np.sin(2 * np.pi * np.array([0.23, 0.31]) * t[:, None])
    still = recording_from_arrays(t, q, np.zeros_like(q), joint_names=robot.joint_names, name="still")
    phases = RowPhases.from_recording(model.observation, still, filters)
    uncertain = ~phases.find_certain_samples(0, t)
    assert uncertain[:, 0].any()
    shaken = recording_from_arrays(t, q, 100.0 * uncertain, joint_names=robot.joint_names, name="shaken")
    reference = ReferenceParameters.massless(robot)
    of_still, of_shaken = (
        reduce_recordings(model.observation, RegressorInputs([r], filters, reference)) for r in (still, shaken)
    )
    for one, other in zip(of_still.equations, of_shaken.equations, strict=True):
        np.testing.assert_array_equal(one.whole_factor, other.whole_factor)
    # And rows beside these instants are equations.
    moving = (phases.phases_at(0, t[:: filters.decimation]) == Phase.MOVING).sum(axis=0)
    assert (np.array([one.counts.sum() for one in of_still.equations]) > 1.1 * moving).all()
