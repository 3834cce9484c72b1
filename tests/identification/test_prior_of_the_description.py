"""The description's inertias as a prior: against dense algebra, and what it is said to be good for."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import lstsq, null_space
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import EstimationError, build_weighted_factor, solve
from dynident.identification import Identification, IdentificationChoices, extend, identify, reidentify, remove
from dynident.identification.description_prior import NormalPrior, build_normal_prior, build_prior, split_prior
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    compute_test_of_values,
    essential_parameters,
)
from dynident.identification.identified_models.model_files import from_bytes, to_bytes
from dynident.identification.identified_models.recursive_identification import RecursiveIdentification
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import build_model
from dynident.robot import Robot
from dynident.robot.pseudo_inertia import estimate_inertia_errors, smallest_pseudo_inertia

LINKS = (EffectChoice("rigid_body"),)
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
CHOICES = IdentificationChoices(EFFECTS, prior="description", preprocessing=Preprocessing(15.0, 15.0, 5))
LAST = "wrist_3_joint"


def heavier(robot: Robot, factor: float = 1.1) -> Robot:
    """The same robot with a description that is a tenth off."""
    assert robot.inertias is not None
    return replace(robot, inertias=factor * robot.inertias)


def run(amplitude: float = 1.2, still: tuple[int, ...] = (), duration: float = 10.0, payload=None, name: str = "run"):
    robot = arm("ur10")
    motion = fourier_motion(robot, duration, 200.0, seed=2, amplitude=amplitude)
    q, dq, ddq = motion.q.copy(), motion.dq.copy(), motion.ddq.copy()
    for joint in still:
        q[:, joint], dq[:, joint], ddq[:, joint] = 0.3, 0.0, 0.0
    loaded = robot
    if payload is not None:
        inertias = robot.inertias.copy()
        inertias[-1] += payload
        loaded = replace(robot, inertias=inertias)
    tau = pinocchio_torque(loaded, q, dq, ddq) + 1.5 * np.sign(dq) + 2.0 * dq + 0.2 * ddq
    tau = tau + 0.3 * np.random.default_rng(7).normal(size=tau.shape)
    return record(robot, replace(motion, q=q, dq=dq, ddq=ddq), tau, name)


@cache
def short(prior: str | None, free: tuple[str, ...] = (), estimator: str = "wls") -> Identification:
    """A motion of a few degrees, which determines little."""
    choices = replace(CHOICES, prior=prior, free_links=free, estimator=estimator)
    return identify(heavier(arm("ur10")), [run(amplitude=0.1)], [run(amplitude=1.5, name="wide")], choices)


def test_a_description_that_is_stated_to_be_better_is_believed_more():
    robot = heavier(arm("ur10"))
    training, wide = [run(amplitude=0.1)], [run(amplitude=1.5, name="wide")]
    vague, usual, sure = (
        identify(robot, training, wide, replace(CHOICES, prior_error=share)) for share in (1.0, 0.2, 0.01)
    )
    truth = usual.model.base.grouping @ np.pad(robot.inertias.ravel(), (0, len(usual.model.columns) - 60))
    links = [k for k, column in enumerate(usual.model.kept) if column.effect == "rigid_body"]
    far = [np.linalg.norm(found.values[links] - truth[links]) for found in (vague, usual, sure)]
    assert far[0] > far[1] > far[2]
    assert from_bytes(to_bytes(sure)).choices.prior_error == 0.01
    with pytest.raises(DynidentError) as refused:
        replace(CHOICES, prior_error=0.0)
    assert refused.value.pointer == "/prior_error"


def test_base_parameters_are_believed_as_sums_of_what_is_believed_of_standard_ones():
    robot = arm("ur10")
    model = build_model(robot, LINKS)
    known = build_prior(model, CHOICES.trust)
    mean = model.base.grouping @ robot.inertias.reshape(-1)
    covariance = (model.base.grouping * estimate_inertia_errors(robot).reshape(-1) ** 2) @ model.base.grouping.T
    np.testing.assert_allclose(np.linalg.inv(known.factor.T @ known.factor), covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(np.linalg.lstsq(known.factor, known.right)[0], mean, atol=1e-9)


def test_nothing_is_believed_of_sums_with_something_unknown_in_them():
    model = build_model(arm("ur10"), EFFECTS)
    known = build_prior(model, replace(CHOICES, free_links=(LAST,)).trust)
    belief = build_normal_prior(model, replace(CHOICES, free_links=(LAST,)).trust)
    # Wide beliefs of the unknown instead of none: what these leave known has to be the same.
    grouping = np.where(belief.stated | model.base.written, model.base.grouping, 0.0)
    wide = (grouping * np.where(belief.stated, belief.size, 1e4) ** 2) @ grouping.T
    size = np.sqrt(np.diag((grouping * np.where(belief.stated, belief.size, 0.0) ** 2) @ grouping.T))
    information = (known.factor * size).T @ (known.factor * size)
    np.testing.assert_allclose(information, np.linalg.inv(wide) * np.outer(size, size), atol=1e-4)
    names = [column.name for column in model.kept]
    for name in ("ZZ6", "MX6", "Fc3", "Ia4", "ZZ1"):
        assert np.abs(known.factor[:, names.index(name)] * belief.size[model.base.kept[names.index(name)]]).max() < 1e-9


def test_the_two_parts_of_a_belief_are_the_whole_of_it():
    model = build_model(arm("ur10"), LINKS)
    belief = build_normal_prior(model, CHOICES.trust)
    both = split_prior(model, belief)
    in_units = both.base.factor @ (model.base.grouping * belief.size)
    everything = np.vstack([in_units, both.rest])
    np.testing.assert_allclose(everything.T @ everything, np.eye(len(belief.size)), atol=1e-8)
    assert isinstance(belief, NormalPrior)


def test_a_prior_makes_a_poor_motion_predict_a_good_one():
    with_prior, without = short("description"), short(None)
    assert with_prior.held_out.relative_total < 0.3 * without.held_out.relative_total
    # The description, a tenth off, is put right where the motion shows it.
    assert with_prior.held_out.relative_total < 0.06


def test_parameters_that_rest_on_the_prior_are_named_and_not_called_well_identified():
    found = short("description")
    warning = next(warning for warning in found.warnings if "less than the prior does" in warning)
    poor = {p.name for p in found.parameters if not p.well_identified}
    named = {name.strip(" .") for name in warning.rsplit(":", 1)[1].split(",")}
    assert len(named) > 5
    assert named <= poor
    assert "an assumption" in warning
    assert found.condition_number == pytest.approx(short(None).condition_number)
    assert any("condition number" in text and "motion alone" in text for text in found.warnings)


def test_a_prior_is_weighed_as_rows_are():
    found = short("description")
    known = build_prior(found.model, found.choices.trust)
    c = found.model.n_parameters
    rows = np.vstack([build_weighted_factor(found.data.equations, found.estimate.solution.noise), known.rows])
    expected = np.linalg.lstsq(rows[:, :c], rows[:, c])[0]
    np.testing.assert_allclose(found.values, expected, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(solve(found.data.equations, found.estimate.solution.noise, known).values, found.values)


def test_a_joint_that_does_not_move_is_filled_in_by_the_prior_but_its_friction_is_not():
    robot, still = arm("ur10"), run(still=(0,))
    moving = robot.joint_names[1:]
    plain = replace(CHOICES, effects=(LINKS[0], *(replace(choice, joints=moving) for choice in EFFECTS[1:])))
    with pytest.raises(EstimationError, match=r"not identifiable.*ZZ1"):
        identify(robot, [still], choices=replace(plain, prior=None))
    found = identify(robot, [still], choices=plain)
    zz1 = next(p for p in found.parameters if p.name == "ZZ1")
    described = found.model.base.grouping @ [
        *robot.inertias.reshape(-1),
        *np.zeros(len(found.model.columns) - 10 * robot.n),
    ]
    assert zz1.value == pytest.approx(described[found.parameters.index(zz1)], abs=zz1.standard_deviation)
    assert not zz1.well_identified
    with pytest.raises(EstimationError, match="not identifiable") as raised:
        identify(robot, [still], choices=CHOICES)
    assert "Fc1" in raised.value.detail
    assert "Fc2" not in raised.value.detail


PAYLOAD = np.array([0.06, 0, 0, 0.06, 0, 0.01, 0, 0, 0.4, 4.0])


@pytest.mark.parametrize("estimator", ["wls", "feasible"])
def test_a_payload_that_is_in_all_runs_is_told_from_the_last_link_by_the_prior(estimator):
    carrying = run(payload=PAYLOAD, name="carrying")
    payload = EffectChoice("payload", runs=("carrying",))
    choices = replace(CHOICES, effects=(*EFFECTS, payload), estimator=estimator)
    with pytest.raises(EstimationError, match="not identifiable"):
        identify(arm("ur10"), [carrying], choices=replace(choices, prior=None))
    found = identify(arm("ur10"), [carrying], choices=choices)
    mass = next(p for p in found.parameters if p.name == "Mp6")
    assert abs(mass.value - 4.0) < 3 * mass.standard_deviation
    assert mass.standard_deviation < 0.8


def test_a_free_last_link_takes_up_a_payload():
    found = identify(arm("ur10"), [run(payload=PAYLOAD)], choices=replace(CHOICES, free_links=(LAST,),
                                                                          estimator="feasible"))  # fmt: skip
    names = [column.name for column in found.model.columns]
    mass, deviation = (
        values[names.index("M6")]
        for values in (found.estimate.standard.values, found.estimate.standard.standard_deviations)
    )
    truth = arm("ur10").inertias[5, 9] + 4.0
    assert abs(mass - truth) < 3 * deviation
    assert deviation < 1.0
    believed = identify(arm("ur10"), [run(payload=PAYLOAD)], choices=replace(CHOICES, estimator="feasible"))
    assert abs(believed.estimate.standard.values[names.index("M6")] - truth) > abs(mass - truth)


def test_a_prior_comes_back_from_a_file():
    found = short("description", (LAST,))
    again = from_bytes(to_bytes(found))
    assert again.choices == found.choices
    assert [p.well_identified for p in again.parameters] == [p.well_identified for p in found.parameters]


def impossible(**change) -> Robot:
    robot = arm("ur10")
    return replace(robot, inertias=change["inertias"])


def mended(place: tuple[int, int], value: float) -> np.ndarray:
    made = arm("ur10").inertias.copy()
    made[place] = value
    return made


@pytest.mark.parametrize(
    ("inertias", "says"),
    [
        (None, "gives no inertias"),
        (np.zeros((6, 10)), "gives no inertias"),
        (np.tile([0.1, 0, 0, 0.1, 0, 0.1, 0, 0, 0, 1.0], (6, 1)), "placeholders"),
        (mended((2, 3), np.nan), "which cannot be used"),
        (mended((1, 9), -2.0), "mass of -2 kg"),
    ],
)
def test_a_description_that_says_nothing_is_no_prior(inertias, says):
    with pytest.raises(DynidentError, match=says) as raised:
        identify(impossible(inertias=inertias), [run()], choices=CHOICES)
    assert raised.value.pointer == "/prior"


def test_a_free_link_that_does_not_exist_is_an_error():
    with pytest.raises(DynidentError, match="wrist_3_joint") as raised:
        identify(arm("ur10"), [run()], choices=replace(CHOICES, free_links=("elbow",)))
    assert raised.value.pointer == "/free_links/0"


def test_a_free_link_without_a_prior_is_an_error():
    with pytest.raises(DynidentError, match="there is no prior") as raised:
        IdentificationChoices(free_links=(LAST,))
    assert raised.value.pointer == "/free_links"


def test_a_prior_needs_the_global_strategy():
    with pytest.raises(DynidentError, match="global") as raised:
        identify(arm("ur10"), [run()], choices=replace(CHOICES, strategy="sequential"))
    assert raised.value.pointer == "/prior"


# Single parameters that are known.


def test_a_known_parameter_moves_its_column_to_the_known_side():
    robot, recording = arm("ur10"), run(amplitude=1.2)
    known = {"Ia3": 0.25, "Fc1": 1.4, "XY6": 0.0, "YZ6": 1e-5, "ZZ1": 7.0}
    choices = replace(CHOICES, prior=None, known=known, estimator="wls", covariance="independent")
    fixed = identify(robot, [recording], choices=choices)
    names = [column.name for column in fixed.model.kept]
    held, others = [names.index(name) for name in known], [k for k, name in enumerate(names) if name not in known]
    assert {name: fixed.values[k] for name, k in zip(known, held, strict=True)} == known
    # Least squares under equations, by SciPy: the free parameters are the null space of the constraints.
    equations = fixed.data.equations
    rows = build_weighted_factor(equations, fixed.estimate.solution.noise)
    w, y, start = rows[:, :-1], rows[:, -1], np.zeros(len(names))
    start[held] = list(known.values())
    moving = null_space(np.eye(len(names))[held])
    expected = start + moving @ lstsq(w @ moving, y - w @ start)[0]
    np.testing.assert_allclose(fixed.values, expected, rtol=1e-8, atol=1e-9)
    # [12.8] of the free parameters alone; a held one has no variance and no covariance.
    variance = (fixed.statistics.noise / fixed.estimate.solution.noise) ** 2
    np.testing.assert_allclose(variance, variance[0], rtol=1e-3)
    covariance = variance[0] * moving @ np.linalg.inv(moving.T @ w.T @ w @ moving) @ moving.T
    np.testing.assert_allclose(fixed.statistics.covariance, covariance, rtol=0.01, atol=1e-3 * covariance.max())
    assert not fixed.statistics.covariance[held].any()
    assert [p.judgement for p in fixed.parameters if p.name in known] == ["held"] * len(known)
    assert all(p.interval == (p.value, p.value) for p in fixed.parameters if p.name in known)
    assert max(p.times_smallest for p in fixed.parameters) < 1e6
    again = from_bytes(to_bytes(fixed))
    assert again.choices == fixed.choices
    assert [p.judgement for p in again.parameters] == [p.judgement for p in fixed.parameters]
    assert "held" not in {identify(robot, [recording], choices=replace(choices, known={})).parameters[0].judgement}
    assert others


def test_friction_that_would_drive_the_motion_is_no_known_value():
    robot, recording = arm("ur10"), run(amplitude=1.2)
    for name in ("Fc1", "Fv2"):
        with pytest.raises(DynidentError, match=f"known {name} is -1, but friction below zero would drive") as raised:
            identify(robot, [recording], choices=replace(CHOICES, prior=None, known={name: -1.0}))
        assert raised.value.pointer == "/known"
    # Beside another law of friction a part may be negative: only their sum brakes.
    effects = (*CHOICES.effects, EffectChoice("viscous_nonlinear", ("shoulder_lift_joint",), (("p", 2.0),)))
    found = identify(robot, [recording], choices=replace(CHOICES, prior=None, effects=effects, known={"Fv2": -0.1}))
    assert found.values[[column.name for column in found.model.kept].index("Fv2")] == pytest.approx(-0.1)


@pytest.mark.parametrize("estimator", ["wls", "ols", "feasible", "irls"])
def test_a_value_with_an_error_is_weighed_against_the_data(estimator: str):
    robot, recording = arm("ur10"), run(amplitude=1.2)
    free = replace(CHOICES, prior=None, estimator=estimator)
    alone = identify(robot, [recording], choices=free)
    k = [column.name for column in alone.model.kept].index("Ia3")
    estimate, deviation = alone.values[k], alone.statistics.standard_deviations[k]
    sure, vague = (
        identify(robot, [recording], choices=replace(free, known={"Ia3": 0.5}, known_errors={"Ia3": error})).values[k]
        for error in (0.001 * deviation, 1000 * deviation)
    )
    assert abs(sure - 0.5) < 0.01 * abs(estimate - 0.5)
    assert abs(vague - estimate) < deviation


@pytest.mark.parametrize("estimator", ["auto", "ols", "wls", "irls", "feasible", "ekf"])
@pytest.mark.parametrize("prior", [None, "description"])
def test_every_estimator_holds_a_known_value(estimator: str, prior: str | None):
    known = {"ZZ1": 7.6, "XY6": 0.0, "Fc2": 1.6}
    choices = replace(CHOICES, prior=prior, estimator=estimator, known=known)
    fixed = identify(arm("ur10"), [run()], choices=choices)
    of_name = {parameter.name: parameter for parameter in fixed.parameters}
    assert {name: of_name[name].value for name in known} == known
    assert {of_name[name].standard_deviation for name in known} == {0.0}
    assert {of_name[name].judgement for name in known} == {"held"}
    deviations = [p.standard_deviation for name, p in of_name.items() if name not in known]
    assert np.isfinite(deviations).all()
    assert min(deviations) > 0
    # 1.5 N m of true friction is near the value held: the others stay where they were.
    free = identify(arm("ur10"), [run()], choices=replace(choices, known={}))
    moved = of_name["Fc3"].value - free.values[[column.name for column in free.model.kept].index("Fc3")]
    assert abs(moved) < 0.2


def test_values_of_everything_leave_nothing_to_estimate():
    names = [column.name for column in build_model(arm("ur10"), LINKS).kept]
    choices = replace(CHOICES, effects=LINKS, prior=None, known=dict.fromkeys(names, 0.5))
    assert set(identify(arm("ur10"), [run()], choices=choices).values) == {0.5}


def test_a_held_parameter_needs_no_motion_and_is_no_candidate_of_the_elimination():
    still, robot = run(still=(5,)), arm("ur10")
    with pytest.raises(EstimationError, match="not identifiable"):
        identify(robot, [still], choices=replace(CHOICES, prior=None))
    lost = [c.name for c in build_model(robot, EFFECTS).kept if c.name[-1] == "6"]
    known = dict.fromkeys(lost, 0.0)
    fixed = identify(robot, [still], choices=replace(CHOICES, prior=None, known=known))
    assert {parameter.name for parameter in fixed.parameters if parameter.judgement == "held"} == set(known)
    path = essential_parameters(fixed)
    assert path.steps
    assert not {step.name for step in path.steps} & set(known)
    # A value that is held, and is not zero, is still held in the smaller model.
    fixed = identify(robot, [run()], choices=replace(CHOICES, prior=None, known={"YZ5": 0.4}))
    path = essential_parameters(fixed)
    assert next(p for p in path.identification.parameters if p.name == "YZ5").value == 0.4


def test_a_standard_parameter_that_is_grouped_is_refused_with_its_sums():
    robot, recording = arm("ur10"), run(amplitude=1.2)
    with pytest.raises(
        DynidentError, match=r"Ia1 is not a parameter by itself: .* only in ZZ1 = ZZ1 \+ .*Ia1"
    ) as raised:
        identify(robot, [recording], choices=replace(CHOICES, prior=None, known={"Ia1": 0.33}))
    assert raised.value.pointer == "/known"
    # A product of inertia and a first moment may be negative.
    identify(robot, [recording], choices=replace(CHOICES, prior=None, known={"XY3": -0.01, "MX3": -0.1}))


def test_a_known_value_that_the_data_contradict_is_said_to_be_so():
    robot, recording = arm("ur10"), run(amplitude=1.2)
    choices = replace(CHOICES, prior=None, known={"Fc1": 15.0, "Fc2": 1.5})
    wrong, right = (
        [warning for warning in identify(robot, [recording], choices=each).warnings if "contradict" in warning]
        for each in (choices, replace(choices, known={"Fc2": 1.5}))
    )
    assert len(wrong) == 1
    assert "known Fc1 = 15" in wrong[0]
    assert not right


def test_what_is_known_of_an_effect_goes_with_it():
    identified = identify(arm("ur10"), [run()], choices=replace(CHOICES, prior=None, known={"Ia3": 0.2, "Fv1": 2.0}))
    smaller = remove(identified, [EffectChoice("viscous")])
    assert smaller.choices.known == {"Ia3": 0.2}
    without = replace(identified.choices, effects=tuple(e for e in EFFECTS if e.effect != "viscous"))
    again = reidentify(identified, without)
    assert again.choices.known == {"Ia3": 0.2}
    np.testing.assert_allclose(again.values, smaller.values)
    with pytest.raises(DynidentError, match="no parameter 'Fv9'"):
        reidentify(identified, replace(without, known={"Fv9": 1.0}))


def test_choices_are_alike_in_whatever_order_values_are_known():
    one, other = (replace(CHOICES, prior=None, known=known) for known in ({"Fc1": 1, "Fc2": 2}, {"Fc2": 2, "Fc1": 1}))
    assert len({one, other}) == 1


@pytest.mark.parametrize(
    ("known", "pointer", "says"),
    [
        ({"known": {"Fc9": 1.0}}, "/known", "no parameter 'Fc9'"),
        (
            {"known": {"Fc1": 1.0}, "strategy": "sequential"},
            "/known",
            "known values are held while all parameters.*global",
        ),
        ({"known": {"M2": 3.0}}, "/known", "M2 is not a parameter by itself"),
        ({"known": {"M1": 3.0}}, "/known", "M1 is not a parameter by itself: no motion shows it"),
        ({"known": {"Ia3": -0.2}}, "/known", "known Ia3 is -0.2, but no mass"),
        ({"known_errors": {"Fc1": 1.0}}, "/known_errors", "no value of it"),
        ({"known": {"Fc1": 1.0}, "known_errors": {"Fc1": 0.0}}, "/known_errors/Fc1", "above 0"),
        (
            {"known": {"Fc1": 1.0}, "prior": "description_entropic", "estimator": "feasible"},
            "/known",
            "entropic",
        ),
    ],
)
def test_what_cannot_be_known_is_refused(known, pointer, says):
    with pytest.raises(DynidentError, match=says) as raised:
        identify(arm("ur10"), [run()], choices=replace(CHOICES, **{"prior": None, **known}))
    assert raised.value.pointer == pointer


def test_feasible_parameters_are_found_beside_any_feasible_value_that_is_known():
    robot, recording = arm("ur10"), run()
    choices = replace(CHOICES, prior=None, estimator="feasible")
    free = identify(robot, [recording], choices=choices)
    assert smallest_pseudo_inertia(free.estimate.standard.to_inertias(free.model)).min() > -1e-9
    values = {parameter.name: parameter.value for parameter in free.parameters}
    for name in ("ZZ1", "MX2", "XX3"):
        for share in (0.98, 1.0, 1.02):
            known = {name: share * values[name]}
            held = identify(robot, [recording], choices=replace(choices, known=known))
            assert {p.name: p.value for p in held.parameters if p.judgement == "held"} == known
    with pytest.raises(DynidentError, match="no physically feasible parameters") as raised:
        identify(robot, [recording], choices=replace(choices, known={"ZZ6": 0.0, "MX6": 1.0}))
    assert raised.value.pointer == "/known"


def test_all_parameters_can_be_known_beside_bounds():
    robot, recording = arm("ur10"), run()
    choices = replace(CHOICES, prior=None, estimator="feasible")
    free = identify(robot, [recording], choices=choices)
    rest = {p.name: p.value for p in free.parameters if p.effect != "rigid_body"}
    links = robot.inertias.ravel()
    truth = np.where(free.model.base.written, free.model.base.grouping, 0.0)[:, : len(links)] @ links
    # Rotors of 0.2 kg m² are in the sums of links, too; without any the bodies are those of the description.
    known = {**dict(zip(free.model.base.kept_names, truth.tolist(), strict=True)), **rest}
    held = identify(robot, [recording], choices=replace(choices, known=known))
    assert {parameter.judgement for parameter in held.parameters} == {"held"}
    assert {p.name: p.value for p in held.parameters} == known
    assert {p.standard_deviation for p in held.parameters} == {0.0}
    # Values that the user held at zero are no limits that were met.
    held = identify(robot, [recording], choices=replace(choices, known={"Ia3": 0.0}))
    assert not any("Held at zero" in warning and "Ia3" in warning for warning in held.warnings)


def test_the_kalman_filter_says_nothing_of_deviations_where_all_is_known():
    robot, recording = arm("ur10"), run(duration=5.0)
    free = identify(robot, [recording], choices=replace(CHOICES, prior=None))
    known = {parameter.name: parameter.value for parameter in free.parameters}
    held = identify(robot, [recording], choices=replace(CHOICES, prior=None, known=known, estimator="ekf"))
    (sentence,) = (warning for warning in held.warnings if "Kalman" in warning)
    assert "processed" in sentence
    assert "nan" not in sentence


def test_a_known_sum_is_known_of_models_in_which_it_is_the_same_sum():
    robot, recording = arm("ur10"), run()
    effects = tuple(choice for choice in EFFECTS if choice.effect != "rotor_inertia")
    choices = replace(CHOICES, prior=None, effects=effects, known={"ZZ1": 7.0, "Fc1": 1.5})
    smaller = identify(robot, [recording], choices=choices)
    larger = extend(smaller, (EffectChoice("rotor_inertia"),), [recording])
    assert larger.choices.known == {"Fc1": 1.5}
    assert larger.warnings[0].startswith("The known ZZ1 is estimated in this model")
    # A rotor that is taken out counts as zero: the sum is the same.
    known = {"ZZ1": 7.6, "Fc1": 1.5}
    whole = identify(robot, [recording], choices=replace(CHOICES, prior=None, known=known))
    smaller = remove(whole, (EffectChoice("rotor_inertia"),))
    assert smaller.choices.known == known
    assert not any("estimated in this model" in warning for warning in smaller.warnings)
    joint = (robot.joint_names[0],)
    ripples = [EffectChoice("torque_ripple", joint, (("k", order),)) for order in (3.0, 7.0)]
    one = replace(CHOICES, prior=None, effects=(*EFFECTS, ripples[0]), known={"Ac1": 0.0})
    both = extend(identify(robot, [recording], choices=one), (ripples[1],), [recording])
    assert both.choices.known == {}
    assert "another parameter has its name" in both.warnings[0]
    with pytest.raises(DynidentError, match="2 parameters of the model have the name Ac1") as raised:
        identify(robot, [recording], choices=replace(one, effects=(*EFFECTS, *ripples)))
    assert raised.value.pointer == "/known"
    with pytest.raises(DynidentError, match="2 parameters of the model have the name Ac1"):
        compute_test_of_values(both, {"Ac1": 0.0})


def test_what_a_file_of_an_earlier_version_knew_of_parts_of_sums_is_not_taken_for_the_sums():
    known = {"ZZ1": 7.6, "Fc1": 1.5}
    identified = identify(arm("ur10"), [run()], choices=replace(CHOICES, prior=None, known=known))
    assert from_bytes(to_bytes(identified)).choices.known == known
    with np.load(io.BytesIO(to_bytes(identified))) as file:
        arrays = {name: file[name] for name in file.files if not name.endswith("known_held")}
    header = json.loads(arrays["0/header"].tobytes())
    del header["known_sums"]
    header["choices"]["known"]["M2"] = 3.0
    arrays["0/header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    former = io.BytesIO()
    np.savez(former, **arrays)
    read = from_bytes(former.getvalue())
    assert read.choices.known == {"Fc1": 1.5}
    assert [warning.split(" was ")[0] for warning in read.warnings[:2]] == ["The known ZZ1", "The known M2"]
    larger = extend(read, (EffectChoice("offset"),), [run()])
    assert [p.name for p in larger.parameters if p.judgement == "held"] == ["Fc1"]


def test_a_recording_under_way_refuses_what_cannot_be_known():
    robot, recording = arm("ur10"), run()
    for known, says in (({"Fc9": 3.0}, "no parameter 'Fc9'"), ({"Fc1": -3.0}, "would drive the motion")):
        live = RecursiveIdentification(robot, replace(CHOICES, prior=None, known=known))
        with pytest.raises(DynidentError, match=says):
            live.push(recording)
    # Parameters of an effect that needs a first fit are in the final model alone.
    effects = (*EFFECTS, EffectChoice("stribeck", (robot.joint_names[0],)))
    live = RecursiveIdentification(robot, replace(CHOICES, prior=None, effects=effects, known={"Fst1": 0.0}))
    live.push(recording)
    assert live.estimate().estimate is not None
    (stribeck,) = (parameter for parameter in live.finish().identification.parameters if parameter.name == "Fst1")
    assert stribeck.judgement == "held"
