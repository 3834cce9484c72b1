"""Results by the names that users of statsmodels, scikit-learn and Pinocchio look for."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import scipy.stats
from support.oracles import arm, fourier_motion, pinocchio_torque
from support.poses_at_rest import poses

import dynident as dy
from dynident.estimation import build_weighted_factor
from dynident.estimation.parameter_covariance import find_occupied_blocks
from dynident.identification.identified_models.correlated_and_essential_parameters import essential_parameters
from dynident.identification.identified_models.model_files import from_bytes, to_bytes
from dynident.number_format import format_number
from dynident.recordings import recording_from_arrays
from dynident.robot import to_pinocchio

RNG = np.random.default_rng(42)


@pytest.fixture(scope="module")
def state(robot: dy.Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return RNG.uniform(-0.1, 0.1, robot.n), RNG.uniform(-1, 1, robot.n), RNG.uniform(-2, 2, robot.n)


# Parameters and their uncertainty.


def test_values_deviations_and_intervals_go_by_the_names_of_the_parameters(model: dy.Model) -> None:
    fc2 = model.parameters["Fc2"]
    assert model.params["Fc2"] == fc2.value
    assert model.bse["Fc2"] == fc2.standard_deviation
    np.testing.assert_allclose(model.conf_int()["Fc2"], fc2.interval)
    assert model.conf_int(0.99)["Fc2", "lower"] < fc2.interval[0]
    assert dict(model.params.items()).keys() == {one.name for one in model.parameters}
    np.testing.assert_array_equal(np.asarray(model.params), model.identification.values)


def test_results_that_hold_several_go_by_number_name_and_slice(model: dy.Model, runs: dy.Recordings) -> None:
    joint = model.robot.joint_names[1]
    assert model.errors[joint] is model.errors[1]
    assert model.parameters["Fc2"] in model.parameters[:]
    for several in (model.parameters, model.errors, model.ladder, runs, dy.compare(model, runs)):
        assert list(several[:1]) == [several[0]]
        assert type(several[:1]) is type(several)
        assert len(several[:0]) == 0
        with pytest.raises(KeyError, match="'nothing'"):
            several["nothing"]


def test_the_covariance_goes_by_two_names_and_agrees_with_the_deviations(model: dy.Model) -> None:
    covariance = model.covariance
    assert covariance["Fc1", "Fv1"] == covariance["Fv1", "Fc1"] != 0
    assert np.sqrt(covariance["Fc1", "Fc1"]) == pytest.approx(model.bse["Fc1"])
    assert np.asarray(covariance).shape == (len(model.params), len(model.params))
    with pytest.raises(KeyError, match=r"there is no parameter 'Fc9'\. There are: ZZ1"):
        covariance["Fc9", "Fc1"]


def test_a_parameter_that_is_only_in_sums_is_said_to_be_in_them(model: dy.Model) -> None:
    names = {one.name for one in model.parameters}
    whole, hidden = next(
        (one.name, word)
        for one in model.parameters
        for word in one.grouping.split()
        if word.isalnum() and word[0].isalpha() and word not in names
    )
    for table in (model.params, model.bse, model.parameters, model.covariance):
        with pytest.raises(KeyError, match=f"'{hidden}' cannot be identified by itself; .*{whole}"):
            table[hidden]


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("rnea", r"use predict\(q, dq, ddq\)"),
        ("crba", r"use mass_matrix\(q\)"),
        ("get_prediction", r"use predict\(.*interval=0\.95\)"),
        ("compare_lr_test", r"use compare_f_test\(smaller\)"),
        ("aba", r"use forward_dynamics\(q, dq, tau\)"),
    ],
)
def test_names_of_other_packages_lead_to_ours(name: str, right: str, model: dy.Model) -> None:
    with pytest.raises(AttributeError, match=right):
        getattr(model, name)


def test_correlations_and_t_values_are_those_of_the_covariance(model: dy.Model) -> None:
    correlation = np.asarray(model.correlation)
    np.testing.assert_allclose(np.diag(correlation), 1.0)
    expected = model.covariance["Fc1", "Fv1"] / (model.bse["Fc1"] * model.bse["Fv1"])
    assert model.correlation["Fc1", "Fv1"] == pytest.approx(expected)
    assert model.tvalues["Fc2"] == pytest.approx(model.params["Fc2"] / model.bse["Fc2"])


def test_models_and_diagnoses_are_pickled(model: dy.Model, found: dy.DiagnosedModel) -> None:
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again.identification.values, model.identification.values)
    # As from a file: a temporary file of a recording may be gone by then.
    with pytest.raises(dy.DynidentError, match="with_data"):
        again.extend("stribeck@elbow")
    assert len(copy.deepcopy(model).recordings) == len(copy.copy(model).recordings) == 1
    kept = pickle.loads(pickle.dumps(found))
    assert kept.recommended == found.recommended
    assert kept.why_not("stribeck@elbow") == found.why_not("stribeck", "elbow")


def test_no_step_is_best_where_filters_differ(robot: dy.Robot, runs: dy.Recordings, model: dy.Model) -> None:
    other = dy.identify(robot, runs[:1], validation=runs[1:], filters=dy.Filters(torque_cutoff=4.0, decimation=9))
    assert not any(dy.Ladder((model, other)).to_table()["best"])
    assert "best" not in repr(dy.Ladder((model, other)))
    assert "errors cannot be compared" in repr(dy.Ladder((model, other)))
    assert "cannot be compared" not in repr(dy.Ladder((model, model)))
    assert other.filters.reasons[-1].startswith("Given by the request")
    assert not any(reason.startswith(("Torque", "Decimation")) for reason in other.filters.reasons)


def test_warnings_say_what_a_slip_did(robot: dy.Robot, runs: dy.Recordings) -> None:
    bare = dy.identify(robot, runs[:1], validation=runs[:1], effects=["offset"])
    assert any("no links" in warning and "default" in warning for warning in bare.warnings)
    assert "samples of the fit" in bare.warnings[0]
    assert all(" ".join(warning.split()[:4]) in bare.summary() for warning in bare.warnings)


def test_joined_recordings_have_names_of_their_own(robot: dy.Robot, runs: dy.Recordings) -> None:
    data = [
        runs[:1].to_frame().drop(columns=["recording", "segment"]),
        runs[1:].to_frame().drop(columns=["recording", "segment"]),
    ]
    both = dy.read_recordings(data[0], robot=robot) + dy.read_recordings(data[1], robot=robot)
    assert both.names == ("recording", "recording_2")
    revised = dy.revise(runs[0], name="lap.2")
    assert (runs + revised).names == ("run1", "run2", "lap.2")
    assert set(both.to_table()["recording"]) == set(both.names)


def test_a_labelled_table_becomes_a_frame_with_an_index(model: dy.Model) -> None:
    pytest.importorskip("pandas")
    frame = model.covariance.to_frame("pandas")
    assert frame.loc["Fc1", "Fv1"] == model.covariance["Fc1", "Fv1"]
    params = model.params.to_frame("pandas")
    assert params.index.name == "parameter"
    assert params.attrs["units"]["Fc3"] == "N"


def test_the_summary_prints_every_parameter_within_a_hundred_columns(better: dy.Model) -> None:
    text = better.summary()
    assert repr(text) == str(text)
    assert max(map(len, text.splitlines())) <= 100
    assert all(f"\n  {one.name} " in text for one in better.parameters)
    assert all(joint in text for joint in better.robot.joint_names)


def test_long_names_leave_the_summary_within_a_hundred_columns(runs: dy.Recordings, robot: dy.Robot) -> None:
    joints = tuple(replace(one, name=f"the_{one.name}_of_the_left_manipulator_arm") for one in robot.joints)
    named = replace(robot, joints=joints, description=None)
    longer = [replace(one.recording, joint_names=named.joint_names) for one in runs]
    text = dy.identify(named, longer[:1], validation=longer[1:]).summary()
    assert max(map(len, text.splitlines())) <= 100


# Predicted torque.


def test_one_state_and_several_are_predicted_in_the_shape_in_which_they_are_given(
    model: dy.Model, state: tuple[np.ndarray, ...]
) -> None:
    one, many = model.predict(*state), model.predict(*(np.tile(values, (3, 1)) for values in state))
    assert one.shape == (4,)
    np.testing.assert_allclose(many, np.tile(one, (3, 1)))
    np.testing.assert_allclose(model.predict(*(values.tolist() for values in state)), one)
    np.testing.assert_allclose(model.predictor().step(*state), one)


def test_an_interval_holds_what_is_measured_and_that_of_the_model_is_narrower(robot: dy.Robot, model: dy.Model) -> None:
    motion = fourier_motion(arm("scara"), 20.0, 100.0, 7)
    moving = np.abs(motion.dq).min(axis=1) > 0.05
    q, dq, ddq = (values[moving] for values in (motion.q, motion.dq, motion.ddq))
    torque = pinocchio_torque(robot, q, dq, ddq) + 3 * np.sign(dq) + 2 * dq
    predicted = model.predict(q, dq, ddq, interval=0.95)
    # The shoulder has Stribeck friction that the model lacks; the others are complete.
    inside = (predicted.lower <= torque) & (torque <= predicted.upper)
    assert inside[:, 1:].mean() > 0.9
    assert (predicted.mean_half_width < predicted.half_width).all()
    np.testing.assert_allclose(predicted.torque, model.predict(q, dq, ddq))
    wider = model.predict(q, dq, ddq, interval=0.99)
    assert (wider.upper > predicted.upper).all()


def test_a_model_with_memory_wants_times_and_then_predicts_as_its_predictor_steps(model: dy.Model) -> None:
    remembering = model.extend("presliding@elbow:d0=0.002,law=dahl")
    motion = fourier_motion(arm("scara"), 2.0, 100.0, 3)
    with pytest.raises(dy.DynidentError, match=r"hysteresis on elbow.*dt=0\.001.*predictor"):
        remembering.predict(motion.q, motion.dq, motion.ddq)
    predictor = remembering.predictor()
    stepped = np.array([predictor.step(*row) for row in zip(motion.q, motion.dq, motion.ddq, strict=True)])
    np.testing.assert_allclose(remembering.predict(motion.q, motion.dq, motion.ddq, dt=0.01), stepped)
    np.testing.assert_allclose(remembering.predict(motion.q, motion.dq, motion.ddq, t=motion.t), stepped)
    predictor.reset()
    np.testing.assert_allclose(predictor.step(motion.q[0], motion.dq[0], motion.ddq[0]), stepped[0])


def test_with_times_the_derivatives_of_the_acceleration_are_formed(model: dy.Model) -> None:
    late = model.extend("torque_delay")
    motion = fourier_motion(arm("scara"), 10.0, 200.0, 3)
    with pytest.raises(dy.DynidentError, match="derivatives of the acceleration"):
        late.predict(motion.q, motion.dq, motion.ddq)
    delayed, punctual = (_with_last_values(late, [delay, 0.0]) for delay in (0.01, 0.0))
    plain = punctual.predict(motion.q, motion.dq, motion.ddq, dt=0.005)[:, 1]
    added = delayed.predict(motion.q, motion.dq, motion.ddq, t=motion.t)[:, 1] - plain
    # A delay takes off its share of the torque's rate, here away from the steps of friction.
    inside = np.abs(motion.dq[:, 1]) > 0.3
    assert inside.sum() > 300
    slope = np.polyfit(np.gradient(plain, motion.t)[inside], added[inside], 1)[0]
    assert slope == pytest.approx(-0.01, rel=0.05)


def _with_last_values(model: dy.Model, last: list[float]) -> dy.Model:
    below = model.identification
    values = np.append(below.values[: -len(last)], last)
    estimate = replace(below.estimate, solution=replace(below.estimate.solution, values=values))
    return dy.Model(replace(below, estimate=estimate))


# Terms of the equation of motion, against Pinocchio.


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> dy.Model:
    """A model of six revolute joints whose bodies can exist, so that Pinocchio can hold them."""
    robot = arm("ur10")
    motion = fourier_motion(robot, 20.0, 100.0, 5)
    torque = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 4 * np.sign(motion.dq) + 2 * motion.dq
    torque += RNG.normal(0.0, 0.1, torque.shape)
    run = recording_from_arrays(motion.t, motion.q, torque, joint_names=robot.joint_names)
    return dy.identify(robot, run, estimator="feasible")


def test_gravity_mass_matrix_and_coriolis_matrix_are_those_of_pinocchio(six: dy.Model) -> None:
    estimate = six.identification.estimate
    described = replace(six.robot, inertias=estimate.standard_inertia().reshape(-1, 10))
    model = to_pinocchio(described)
    # The rotors' inertia stands on the diagonal of the mass matrix.
    model.armature[:] = _rotors(six)
    data = model.createData()
    for _ in range(5):
        q, dq = RNG.uniform(-2, 2, 6), RNG.uniform(-2, 2, 6)
        mass = np.array(pin.crba(model, data, q))
        mass = np.triu(mass) + np.triu(mass, 1).T
        np.testing.assert_allclose(six.mass_matrix(q), mass, atol=1e-6 * np.abs(mass).max())
        gravity = pin.computeGeneralizedGravity(model, data, q)
        np.testing.assert_allclose(six.gravity(q), gravity, atol=1e-6 * np.abs(gravity).max())
        coriolis = np.array(pin.computeCoriolisMatrix(model, data, q, dq))
        np.testing.assert_allclose(six.coriolis(q, dq), coriolis, atol=1e-6 * np.abs(coriolis).max())
        tau = RNG.uniform(-50, 50, 6)
        acceleration = pin.aba(model, data, q, dq, tau - six.friction(q, dq))
        np.testing.assert_allclose(
            six.forward_dynamics(q, dq, tau), acceleration, rtol=1e-5, atol=1e-6 * np.abs(acceleration).max()
        )


def _rotors(model: dy.Model) -> np.ndarray:
    standard = model.identification.estimate.standard
    assert standard is not None
    columns = model.identification.model.columns
    by_name = {column.name: value for column, value in zip(columns, standard.values, strict=True)}
    return np.array([by_name.get(f"Ia{k + 1}", 0.0) for k in range(model.robot.n)])


def test_the_terms_add_up_to_the_torque(model: dy.Model, state: tuple[np.ndarray, ...]) -> None:
    q, dq, ddq = (np.stack([values, -values]) for values in state)
    mass, coriolis = model.mass_matrix(q), model.coriolis(q, dq)
    assert mass.shape == coriolis.shape == (2, 4, 4)
    inertial = np.einsum("mij,mj->mi", mass, ddq) + np.einsum("mij,mj->mi", coriolis, dq)
    total = inertial + model.gravity(q) + model.friction(q, dq)
    np.testing.assert_allclose(total, model.predict(q, dq, ddq), atol=1e-9)
    np.testing.assert_allclose(mass, np.swapaxes(mass, 1, 2), atol=1e-12)


def test_the_acceleration_is_the_one_whose_torque_is_given(model: dy.Model, state: tuple[np.ndarray, ...]) -> None:
    q, dq, ddq = (np.stack([values, -values]) for values in state)
    torque = model.predict(q, dq, ddq)
    np.testing.assert_allclose(model.forward_dynamics(q, dq, torque), ddq, atol=1e-9)
    np.testing.assert_allclose(model.forward_dynamics(q[0], dq[0], torque[0]), ddq[0], atol=1e-9)
    late = _with_last_values(model.extend("load_dependent_friction@elbow"), [0.3])
    with pytest.raises(dy.DynidentError, match="depends on the acceleration"):
        late.forward_dynamics(q, dq, torque)


def test_a_model_without_inertia_says_what_to_identify_for_a_simulation(
    robot: dy.Robot, runs: dy.Recordings, state: tuple[np.ndarray, ...]
) -> None:
    rubbing = dy.identify(robot, runs[:1], effects=["coulomb", "viscous"])
    with pytest.raises(dy.DynidentError, match="no inertia of the links; identify with the effect rigid_body"):
        rubbing.forward_dynamics(*state)
    given = arm("ur10")
    t, q, tau = poses(given, 60, 0)
    standing = dy.identify(given, recording_from_arrays(t, q, tau, joint_names=given.joint_names))
    with pytest.raises(dy.DynidentError, match="poses at rest, which show no inertia; identify from a motion"):
        standing.forward_dynamics(np.zeros(6), np.zeros(6), np.zeros(6))


def test_several_values_are_tested_at_once(model: dy.Model, robot: dy.Robot, runs: dy.Recordings) -> None:
    estimates = {name: model.params[name] for name in ("Fc1", "Fv1", "Fc2")}
    assert model.wald_test(estimates).f_value == pytest.approx(0.0, abs=1e-12)
    one = model.wald_test({"Fc2": 3.3})
    assert one.f_value == pytest.approx(((model.params["Fc2"] - 3.3) / model.bse["Fc2"]) ** 2)
    # One value contradicts the data exactly where its interval ends.
    off = model.params["Fc2"] + 2.0 * model.bse["Fc2"]
    _, end = model.conf_int(1.0 - model.wald_test({"Fc2": off}).p_value)["Fc2"]
    assert end == pytest.approx(off, rel=1e-9)
    # Hotelling's T² by its formula, with the blocks of time as samples.
    names, blocks = list(estimates), int(find_occupied_blocks(model.identification.data.equations).sum())
    shift = 2.0 * np.array([model.bse[name] for name in names])
    where = [list(model.params).index(name) for name in names]
    square = shift @ np.linalg.solve(np.asarray(model.covariance)[np.ix_(where, where)], shift)
    test = model.wald_test({name: estimates[name] + by for name, by in zip(names, shift, strict=True)})
    assert (test.df_diff, test.df_resid) == (3, blocks - 3)
    assert test.f_value == pytest.approx(square * (blocks - 3) / (3 * (blocks - 1)))
    assert test.p_value == pytest.approx(scipy.stats.f.sf(test.f_value, 3, blocks - 3))
    # Of two parameters that are said to be equal the error of both counts.
    equal, a, b = model.wald_test({"Fc1": "Fc2"}), *(list(model.params).index(name) for name in ("Fc1", "Fc2"))
    covariance = np.asarray(model.covariance)
    variance = covariance[a, a] + covariance[b, b] - 2 * covariance[a, b]
    assert equal.f_value == pytest.approx((model.params["Fc1"] - model.params["Fc2"]) ** 2 / variance)
    assert equal.df_diff == 1
    # The test of a model with these values agrees with it where every row counts as independent.
    independent = dy.IdentificationChoices(covariance="independent", estimator="wls", weigh_turns=False)
    plain = dy.identify(robot, runs[:1], choices=independent, filters=model.filters)
    values = {"Fc1": 2.9, "Fv1": 1.9}
    fixed = dy.identify(robot, runs[:1], choices=replace(independent, known=values), filters=model.filters)
    assert plain.wald_test(values).f_value == pytest.approx(plain.compare_f_test(fixed).f_value, rel=1e-6)
    for values, words in (
        ({"Fc9": 1.0}, "no parameter 'Fc9'"),
        (dict.fromkeys(model.params, 0.0), "too few to test"),
        ([1.0], "give values by the names"),
    ):
        with pytest.raises(dy.DynidentError, match=words):
            model.wald_test(values)
    with pytest.raises(dy.DynidentError, match="Fc1, Fv1 was held"):
        fixed.wald_test({"Fc1": 1.0, "Fv1": 2.0})


def test_a_covariance_of_few_blocks_is_said_to_be_singular(
    model: dy.Model, robot: dy.Robot, runs: dy.Recordings, desk: Path
) -> None:
    matrix = np.asarray(model.covariance)
    scale = np.sqrt(np.diag(matrix))
    rank = np.linalg.matrix_rank(matrix / np.outer(scale, scale), tol=1e-9, hermitian=True)
    assert (f"of rank {rank} of {len(matrix)}" in model.covariance.title) == (rank < len(matrix))
    short = dy.identify(robot, dy.read_recordings(desk / "run1.csv", robot=robot, windows=[(0.0, 5.0)]))
    assert "singular: of rank" in repr(short.covariance)
    full = dy.identify(robot, runs[:1], choices=dy.IdentificationChoices(covariance="by_joint"))
    assert "singular" not in full.covariance.title


def test_a_held_parameter_is_told_as_held(robot: dy.Robot, runs: dy.Recordings) -> None:
    held = dy.identify(robot, runs[:1], choices=dy.IdentificationChoices(known={"Fc2": 3.0, "Fv3": 0.0}))
    assert (held.params["Fc2"], held.params["Fv3"]) == (3.0, 0.0)
    assert held.bse["Fc2"] == held.bse["Fv3"] == 0.0
    assert held.conf_int()["Fv3"].tolist() == [0.0, 0.0]
    assert ", 2 held" in held.summary()
    assert not any("uncertain" in warning and "Fv3" in warning for warning in held.warnings)
    assert {held.parameters[name].judgement for name in ("Fc2", "Fv3")} == {"held"}
    again = dy.Model(from_bytes(to_bytes(held.identification)))
    assert again.parameters["Fv3"].judgement == "held"
    better = held.extend("offset@shoulder")
    assert (better.params["Fc2"], better.params["Fv3"]) == (3.0, 0.0)


def test_summaries_are_printed_and_called_alike(model: dy.Model, found: dy.DiagnosedModel) -> None:
    assert model.summary() == model.summary == str(model.summary)
    assert found.summary() == found.summary == found.diagnosis.summary


def test_condition_numbers_have_two_names(model: dy.Model) -> None:
    rows = build_weighted_factor(model.identification.data.equations.equally_weighted, np.ones(model.robot.n))[:-1, :-1]
    assert model.condition_number == pytest.approx(np.linalg.cond(rows))
    text = model.summary()
    assert f"condition number of W     {format_number(model.condition_number)} (SI units" in text
    assert f"scaled condition number   {format_number(model.scaled_condition_number)} (columns of equal size" in text


def test_a_robust_model_is_tested_with_the_weights_of_its_rows(robot: dy.Robot, desk: Path) -> None:
    pushed = pytest.importorskip("pandas").read_csv(desk / "run1.csv")
    pushed.loc[300:320, "tau2"] += 50.0
    data = dy.read_recordings(pushed, robot=robot)
    robust = dy.identify(robot, data, estimator="irls")
    known = dy.IdentificationChoices(known={"Fc2": 3.0})
    fixed = dy.identify(robot, data, estimator="irls", filters=robust.filters, choices=known)
    t = (robust.params["Fc2"] - 3.0) / robust.bse["Fc2"]
    assert robust.compare_f_test(fixed).f_value == pytest.approx(t**2, rel=1e-6)
    # Parameters that were set to zero have no deviation to be divided by.
    essential = dy.Model(essential_parameters(robust.identification).identification)
    assert essential.identification.estimate.not_essential
    assert 0.0 < essential.compare_f_test(fixed).p_value < 1.0


def test_what_is_there_is_more_than_noise_and_what_is_not_there_is_none(
    model: dy.Model, robot: dy.Robot, runs: dy.Recordings
) -> None:
    # The shoulder has Stribeck friction, the elbow has none.
    hidden = model.extend("stribeck@shoulder:vs=0.2")
    assert hidden.compare_f_test(model).p_value < 1e-6
    f_value, p_value, count = hidden.extend("stribeck@elbow:vs=0.3").compare_f_test(hidden)
    assert 0.01 < p_value < 1.0
    assert (count, f_value < 10) == (1, True)
    fixed = dy.identify(robot, runs[:1], filters=model.filters, choices=dy.IdentificationChoices(known={"Fc2": 3.0}))
    test = model.compare_f_test(fixed)
    t = (model.params["Fc2"] - 3.0) / model.bse["Fc2"]
    # One parameter with one known value: the square of its t.
    assert test.f_value == pytest.approx(t**2, rel=0.02)


def test_models_that_are_not_nested_are_refused(
    model: dy.Model, robot: dy.Robot, runs: dy.Recordings, desk: Path
) -> None:
    with pytest.raises(dy.DynidentError, match="does not have b1"):
        model.compare_f_test(model.extend("offset@shoulder"))
    with pytest.raises(dy.DynidentError, match="the same parameters"):
        model.compare_f_test(model)
    choices, data = dy.IdentificationChoices, runs[:1]
    # Other recordings, also those of the same name, and rows with other weights.
    shorter = dy.read_recordings(desk / "run1.csv", robot=robot, windows=[(0.0, 8.0)])
    assert shorter.names == data.names
    for other in (
        dy.identify(robot, runs[1:], filters=model.filters),
        dy.identify(robot, shorter, filters=model.filters),
        dy.identify(robot, data, filters=model.filters, choices=choices(weigh_turns=False)),
    ):
        with pytest.raises(dy.DynidentError, match="other recordings, filters"):
            model.compare_f_test(other)
    # Two models that know different values, and two that use the description in different ways.
    three, nine, bounded, believing, sure = (
        dy.identify(robot, data, filters=model.filters, choices=choices(**known))
        for known in (
            {"known": {"Fc2": 3.0}},
            {"known": {"Fc2": 9.0}},
            {"known": {"Fc2": 3.0}, "known_errors": {"Fc2": 0.1}},
            {"prior": "description"},
            {"prior": "description", "prior_error": 0.01},
        )
    )
    grown = three.extend("offset@shoulder")
    assert grown.compare_f_test(three).df_diff == 1
    for other in (nine, bounded):
        with pytest.raises(dy.DynidentError, match="have different known values or errors of Fc2"):
            grown.compare_f_test(other)
    believed = believing.extend("offset@shoulder")
    assert believed.compare_f_test(believing).df_diff == 1
    for other in (model, sure):
        with pytest.raises(dy.DynidentError, match="the description in different ways"):
            believed.compare_f_test(other)
    with pytest.raises(dy.DynidentError, match="give the smaller model"):
        model.compare_f_test("model.npz")  # type: ignore[arg-type]


def test_friction_with_memory_is_that_of_steady_sliding(model: dy.Model, state: tuple[np.ndarray, ...]) -> None:
    remembering = model.extend("presliding@elbow:d0=0.002,law=dahl")
    q, dq, _ = state
    path = q + np.outer(np.arange(400) * 0.002, dq)
    slid = remembering.predict(path, np.tile(dq, (400, 1)), np.zeros_like(path), dt=0.002)[-1]
    inertial = remembering.coriolis(path[-1], dq) @ dq + remembering.gravity(path[-1])
    np.testing.assert_allclose(remembering.friction(path[-1], dq), slid - inertial, atol=1e-6)


# Residuals and exports.


def test_residuals_are_measured_minus_predicted_by_joint(model: dy.Model, runs: dy.Recordings) -> None:
    residuals, compared = model.residuals(runs), dy.compare(model, runs)
    assert list(residuals.columns) == ["recording", "t", *model.robot.joint_names]
    np.testing.assert_array_equal(
        residuals["elbow"], np.concatenate([one.comparison.residual[:, 1] for one in compared])
    )
    assert residuals.units["quill"] == "N"
    assert set(model.residuals()["recording"]) == {"run1"}
    with pytest.raises(dy.DynidentError, match="recordings of the model"):
        dy.Model(model.identification).residuals()


def test_a_model_is_exported_in_the_format_of_the_ending(model: dy.Model, tmp_path: Path) -> None:
    for name in ("arm.urdf", "arm.xml", "arm.c", "arm.json", "arm.casadi"):
        file = model.export(tmp_path / name)
        assert (tmp_path / name).read_bytes() == file.content
    assert ElementTree.parse(tmp_path / "arm.urdf").getroot().tag == "robot"
    assert ElementTree.parse(tmp_path / "arm.xml").getroot().tag == "mujoco"
    assert "note: " in repr(model.export(tmp_path / "arm.urdf"))
    with pytest.raises(dy.DynidentError, match=r"must end in \.json, \.urdf, .* or \.dat"):
        model.export(tmp_path / "arm.txt")


def test_a_model_is_exported_without_an_effect_of_which_a_value_is_known(
    robot: dy.Robot, runs: dy.Recordings, tmp_path: Path
) -> None:
    known = dy.IdentificationChoices(known={"b1": 0.1, "Fc3": 3.0})
    model = dy.identify(robot, runs[:1], effects=["default", "offset@shoulder"], choices=known)
    model.export(tmp_path / "arm.urdf")
    friction = ElementTree.parse(tmp_path / "arm.urdf").find("joint[@name='quill']/dynamics")
    assert friction is not None
    assert float(friction.attrib["friction"]) == pytest.approx(3.0, rel=1e-3)


def test_a_model_that_is_not_to_be_used_is_exported_only_where_that_is_wanted(
    robot: dy.Robot, runs: dy.Recordings, tmp_path: Path
) -> None:
    poor = dy.identify(robot, runs[:1], effects=["viscous"])
    with pytest.raises(dy.DynidentError, match="anyway=True"):
        poor.export(tmp_path / "arm.json")
    assert poor.export(tmp_path / "arm.json", anyway=True).content


# Filters.


def test_a_filter_is_changed_and_the_others_are_chosen_from_the_data(robot: dy.Robot, runs: dy.Recordings) -> None:
    usual = dy.identify(robot, runs[:1])
    other = dy.identify(robot, runs[:1], filters=dy.Filters(torque_cutoff=5.0))
    assert other.filters.torque_cutoff == 5.0
    assert other.filters.position_cutoff == usual.filters.position_cutoff
    same = dy.identify(robot, runs[:1], filters=other.filters)
    np.testing.assert_array_equal(np.asarray(same.params), np.asarray(other.params))
    assert dy.Filters().torque_cutoff == "auto"


# Figures.


def test_figures_are_written_as_pictures_and_are_axes_of_matplotlib(runs: dy.Recordings, tmp_path: Path) -> None:
    figure = runs.plot()
    figure.save(tmp_path / "runs.png", dpi=50)
    assert (tmp_path / "runs.png").read_bytes().startswith(b"\x89PNG")
    figure.save(tmp_path / "runs.pdf")
    assert (tmp_path / "runs.pdf").read_bytes().startswith(b"%PDF")
    # Position and torque of four joints in two recordings.
    assert len(figure.axes) == 16
    figure.axes[0].set_xlabel("seconds")
    figure.axes[0].figure.savefig(tmp_path / "mine.png")
    assert (tmp_path / "mine.png").stat().st_size > 1000
    with pytest.raises(dy.DynidentError, match=r"must end in \.svg, \.png or \.pdf"):
        figure.save(tmp_path / "runs.jpg")
    with pytest.raises(dy.DynidentError, match="there is no folder"):
        figure.save(tmp_path / "no" / "runs.png")


def test_a_picture_without_its_renderer_says_what_to_install(
    runs: dy.Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "typst", None)
    monkeypatch.delitem(sys.modules, "dynident.reports.pdf_report", raising=False)
    words = r"typst, which is not installed; .*dynident\[science\].*save\('runs.svg'\)"
    with pytest.raises(dy.DynidentError, match=words):
        runs.plot().save(tmp_path / "runs.png")
