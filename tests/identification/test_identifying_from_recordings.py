"""Identification from recordings whose torque Pinocchio made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy import signal
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice, ReferenceParameters, UnknownEffectError
from dynident.errors import DynidentError
from dynident.estimation import EquationFactors, EstimationError, Reduction, statistics
from dynident.identification import IdentificationChoices, extend, identify, identify_model
from dynident.identification.identified_models import fit_model
from dynident.identification.standard_parameters import compute_smallest_inertia_eigenvalue, draw_postures
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import build_model
from dynident.robot import to_pinocchio

ROBOT = arm("ur10")
PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
WITH_OFFSET = (*PLAIN, EffectChoice("offset"))
WIDE = Preprocessing(None, None, 5)
BAND = Preprocessing(10.0, 8.0, 3)
RATE = 100.0


def standard(robot, seed: int = 0) -> np.ndarray:
    """Inertias of the description and random Ia, Fc, Fv, b, in the order of `WITH_OFFSET`'s columns."""
    drawn = np.random.default_rng(seed).uniform(0.5, 5.0, (4, robot.n))
    return np.concatenate([robot.inertias.reshape(-1), drawn.ravel()])


def torque(robot, motion: Motion, seed: int = 0) -> np.ndarray:
    ia, fc, fv, b = standard(robot, seed)[10 * robot.n :].reshape(4, robot.n)
    rigid = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    return rigid + ia * motion.ddq + fc * np.sign(motion.dq) + fv * motion.dq + b


MOTION = fourier_motion(ROBOT, 20.0, RATE, 1)
OTHER_MOTION = fourier_motion(ROBOT, 12.0, RATE, 2)
NOISE = np.array([2.0, 2.0, 1.0, 0.5, 0.5, 0.5])


def noisy(motion: Motion, seed: int) -> np.ndarray:
    return torque(ROBOT, motion) + NOISE * np.random.default_rng(seed).normal(size=motion.q.shape)


TRAINING = record(ROBOT, MOTION, noisy(MOTION, 1), "training")
VALIDATION = record(ROBOT, OTHER_MOTION, noisy(OTHER_MOTION, 2), "validation")


def choices(*effects: EffectChoice, **more) -> IdentificationChoices:
    return IdentificationChoices(effects=effects or WITH_OFFSET, **{"preprocessing": BAND, **more})


@pytest.fixture(scope="module")
def identified():
    return identify(ROBOT, [TRAINING], [VALIDATION], choices(estimator="wls"))


@pytest.mark.parametrize("name", ["ur10", "scara"])
@pytest.mark.parametrize("estimator", ["ols", "wls"])
def test_noise_free_torque_gives_the_true_base_parameters(name, estimator):
    robot = arm(name)
    motion = fourier_motion(robot, 25.0, 1000.0, 3, base_frequency=0.08, amplitude=2.5)
    run = record(robot, motion, torque(robot, motion))
    found = identify(robot, [run], [], choices(preprocessing=WIDE, estimator=estimator))
    truth = found.model.base.grouping @ standard(robot)
    assert np.abs(found.values - truth).max() < 1e-6 * np.abs(truth).max()
    assert found.fit.relative_total < 1e-6
    assert found.inertia_matrix_positive_definite


@pytest.mark.parametrize("preprocessing", [Preprocessing(30.0, 20.0, 10), Preprocessing(None, 8.0, 10)])
def test_filters_wider_than_the_motion_do_not_bias_the_estimates(preprocessing):
    motion = fourier_motion(ROBOT, 25.0, 500.0, 3, base_frequency=0.08, amplitude=2.5)
    run = record(ROBOT, motion, torque(ROBOT, motion))
    found = identify(ROBOT, [run], [], choices(preprocessing=preprocessing))
    truth = found.model.base.grouping @ standard(ROBOT)
    assert np.abs(found.values - truth).max() < 1e-3 * np.abs(truth).max()
    assert found.fit.relative_total < 1e-4


def test_held_out_errors_are_those_of_the_noise(identified):
    rms = identified.held_out.rms
    # White noise of variance σ² behind a low-pass of 8 of 50 Hz.
    expected = NOISE * np.sqrt(8.0 / 50.0)
    np.testing.assert_allclose(rms, expected, rtol=0.3)
    assert identified.fit.relative_total < identified.held_out.relative_total * 1.1


def test_an_identification_knows_what_it_was_made_from(identified):
    assert identified.data.measurement_names == ("training",)
    assert identified.data.validation_names == ("validation",)
    assert identified.n_equations == identified.data.training.n_rows
    assert identified.equations_per_parameter == identified.n_equations / len(identified.values)
    assert [p.name for p in identified.parameters] == [c.name for c in identified.model.kept]
    for parameter in identified.parameters:
        assert parameter.unit
        assert parameter.grouping.startswith(parameter.name)
        assert parameter.standard_deviation > 0


def test_parameters_are_judged_by_their_own_intervals_and_not_by_the_surest_one(identified):
    smallest = min(p.relative_standard_deviation for p in identified.parameters)
    for p in identified.parameters:
        low, high = p.interval
        if low <= 0 <= high:
            assert p.judgement == "zero_in_interval"
        else:
            assert p.judgement == ("determined" if p.standard_deviation <= 0.1 * abs(p.value) else "uncertain")
        assert p.well_identified == (p.judgement == "determined")
        assert p.times_smallest == pytest.approx(p.relative_standard_deviation / smallest)
    unsure = [p.name for p in identified.parameters if p.judgement == "uncertain"]
    told = [warning for warning in identified.warnings if "are uncertain" in warning]
    assert len(told) == bool(unsure)
    assert all(name in told[0] for name in unsure[:12])
    # Known to a percent or two, and far more than ten times the surest one's.
    assert any(p.judgement == "determined" and p.times_smallest > 10 for p in identified.parameters)


def test_a_fit_that_leaves_much_unexplained_points_at_the_columns_and_the_description(identified):
    other = torque(ROBOT, OTHER_MOTION)[: len(MOTION.t)]
    other = np.resize(other, (len(MOTION.t), ROBOT.n))
    found = identify(ROBOT, [record(ROBOT, MOTION, other)], [], choices())
    assert found.fit.relative_total > 0.2
    assert any("order, signs and units" in warning for warning in found.warnings)
    assert not any("order, signs and units" in warning for warning in identified.warnings)


def test_standard_inertia_gives_the_torque_of_the_base_parameters(identified):
    q, dq, ddq = (s[:50] for s in (OTHER_MOTION.q, OTHER_MOTION.dq, OTHER_MOTION.ddq))
    known = identified.estimate.next_reference()
    np.testing.assert_array_equal(known.inertias.ravel(), identified.estimate.standard_inertia())
    robot = replace(ROBOT, inertias=known.inertias)
    inertial = np.array([c.effect in ("rigid_body", "rotor_inertia") for c in identified.model.kept])
    entries = identified.model.observation.evaluate(
        q, dq, ddq, reference=ReferenceParameters.massless(identified.model.robot), memory=np.zeros((50, 0))
    )
    found = identified.model.observation.compute_torque(entries, np.where(inertial, identified.values, 0.0))
    # Rotors that regroup into a link's inertia are told apart from it by how far a description is usually off.
    expected = pinocchio_torque(robot, q, dq, ddq) + known.rotors * ddq
    np.testing.assert_allclose(expected, found, atol=2e-3 * np.abs(found).max())


def test_motor_torque_is_predicted_with_the_friction_that_was_found(identified):
    known = identified.estimate.next_reference()
    fc, fv, b = known.dry, known.damping, known.constant
    found = {parameter.name: parameter.value for parameter in identified.parameters}
    for j in range(6):
        assert fc[j] == found[f"Fc{j + 1}"]
        assert fv[j] == found[f"Fv{j + 1}"]
        assert b[j] == found.get(f"b{j + 1}", 0.0)


def test_several_recordings_are_identified_together():
    one = identify(ROBOT, [TRAINING], [], choices())
    both = identify(ROBOT, [TRAINING, VALIDATION], [], choices())
    assert both.n_equations > one.n_equations
    assert np.median(both.statistics.standard_deviations / one.statistics.standard_deviations) < 0.95


def test_the_inertia_matrix_of_sound_parameters_is_positive_definite(identified):
    assert identified.inertia_matrix_positive_definite
    assert 0 < identified.worst_inertia_eigenvalue < 1


def test_the_inertia_matrix_is_looked_at_when_somebody_asks(monkeypatch):
    asked = []
    monkeypatch.setattr(fit_model, "compute_smallest_inertia_eigenvalue", lambda *_: asked.append(1) or 0.5)
    found = identify(ROBOT, [TRAINING], [], choices(estimator="wls"))
    assert len(found.parameters) == found.model.n_parameters
    assert not asked
    assert found.inertia_matrix_positive_definite
    assert len(asked) == 1


def test_the_smallest_inertia_eigenvalue_is_pinocchios():
    model = build_model(ROBOT, [EffectChoice("rigid_body")])
    values = model.base.grouping @ ROBOT.inertias.reshape(-1)
    oracle = to_pinocchio(ROBOT)
    data = oracle.createData()
    smallest = np.inf
    for q in draw_postures(ROBOT, 400, 0):
        upper = np.triu(pin.crba(oracle, data, q))
        matrix = upper + np.triu(upper, 1).T
        scale = 1 / np.sqrt(np.diag(matrix))
        smallest = min(smallest, np.linalg.eigvalsh(matrix * np.outer(scale, scale))[0])
    assert compute_smallest_inertia_eigenvalue(model, values) == pytest.approx(smallest, rel=1e-8)
    assert compute_smallest_inertia_eigenvalue(model, -values) < 0


def test_a_user_is_warned_that_nothing_was_held_out():
    assert any("no validation data" in w for w in identify(ROBOT, [TRAINING], [], choices()).warnings)


@pytest.mark.parametrize("joint", [0, 3, 4, 5])
def test_torque_of_the_wrong_sign_is_noticed_by_its_friction(joint):
    tau = noisy(MOTION, 1)
    tau[:, joint] *= -1
    found = identify(ROBOT, [record(ROBOT, MOTION, tau)], [VALIDATION], choices())
    accused = [w for w in found.warnings if "check the sign" in w]
    assert accused
    assert all(ROBOT.joint_names[joint] in w for w in accused)


@pytest.mark.parametrize("joint", [1, 2])
def test_torque_of_the_wrong_sign_against_gravity_is_noticed_by_the_inertia_matrix_and_the_validation(joint):
    tau = noisy(MOTION, 1)
    tau[:, joint] *= -1
    found = identify(ROBOT, [record(ROBOT, MOTION, tau)], [VALIDATION], choices())
    assert not found.inertia_matrix_positive_definite
    assert "positive definite" in found.warnings[0]
    assert any("error on validation data" in w for w in found.warnings)


def coverage(count: int) -> tuple[float, float]:
    """Share of true base parameters within two standard deviations: as promised, and with all rows independent."""
    model = build_model(ROBOT, WITH_OFFSET)
    truth = model.base.grouping @ standard(ROBOT)
    motion = fourier_motion(ROBOT, 30.0, RATE, 1)
    clean = torque(ROBOT, motion)
    taps = signal.firwin(31, 5.0, fs=RATE)
    rng = np.random.default_rng(7)
    within, within_raw = [], []
    for _ in range(count):
        white = rng.normal(size=(len(motion.t) + 30, 6))
        noise = 3.0 * NOISE * np.array([np.convolve(w, taps, mode="valid") for w in white.T]).T
        run = record(ROBOT, motion, clean + noise)
        found = identify_model(
            model,
            [run],
            [],
            choices(),
            Preprocessing(None, 8.0, 3),
            ReferenceParameters.massless(model.robot),
            lambda *_: None,
        )
        miss = np.abs(found.values - truth)
        within.append(miss <= 2 * found.statistics.standard_deviations)
        one_stretch = Reduction(
            found.data.training.n_columns,
            tuple(
                EquationFactors(e.columns, e.whole_factor[None], np.array([e.counts.sum()]))
                for e in found.data.training.equations
            ),
            np.array([[0.0, 30.0]]),
        )
        raw = statistics(one_stretch, found.estimate.solution).standard_deviations
        within_raw.append(miss <= 2 * raw)
    return float(np.mean(within)), float(np.mean(within_raw))


def test_two_standard_deviations_cover_the_truth_as_often_as_they_promise():
    promised, raw = coverage(40)
    assert 0.88 <= promised <= 0.99
    assert raw < promised - 0.15
    assert raw < 0.8


def test_a_joint_that_never_moved_is_an_error_that_names_its_parameters():
    q, dq, ddq = MOTION.q.copy(), MOTION.dq.copy(), MOTION.ddq.copy()
    q[:, 3], dq[:, 3], ddq[:, 3] = 0.4, 0.0, 0.0
    still = Motion(MOTION.t, q, dq, ddq)
    with pytest.raises(EstimationError, match=r"Ia4.*Fv4") as caught:
        identify(ROBOT, [record(ROBOT, still, torque(ROBOT, still))], [], choices(*PLAIN))
    assert caught.value.pointer == "/recordings"
    assert "lock" in caught.value.detail


def test_two_joints_that_always_move_alike_are_an_error_that_names_what_they_share():
    robot = arm("scara")
    motion = fourier_motion(robot, 20.0, RATE, 1)
    for values in (motion.q, motion.dq, motion.ddq):
        values[:, 1] = 0.5 * values[:, 0]
    effects = (*PLAIN, EffectChoice("transmission_coupling", (robot.joint_names[0],), (("side", 1.0),)))
    run = record(robot, motion, torque(robot, motion))
    with pytest.raises(EstimationError, match=r"Fvm1|Fcm1|Iam1"):
        identify(robot, [run], [], choices(*effects))


@pytest.mark.parametrize("seconds", [0.1, 0.5, 1.5])
def test_a_recording_that_is_too_short_says_so(seconds):
    rows = round(seconds * RATE)
    short = Motion(MOTION.t[:rows], MOTION.q[:rows], MOTION.dq[:rows], MOTION.ddq[:rows])
    with pytest.raises(DynidentError) as caught:
        identify(ROBOT, [record(ROBOT, short, torque(ROBOT, short))], [], choices())
    assert caught.value.title in ("Too few samples", "Not identifiable", "Too short")


def test_a_recording_of_another_robot_is_refused_by_the_names_of_its_joints():
    with pytest.raises(DynidentError, match="training has the joints") as caught:
        identify(arm("scara"), [TRAINING])
    assert caught.value.pointer == "/recordings/0"
    motion = fourier_motion(arm("scara"), 10.0, RATE, 1)
    own = record(arm("scara"), motion, torque(arm("scara"), motion))
    with pytest.raises(DynidentError) as caught:
        identify(arm("scara"), [own], [VALIDATION])
    assert caught.value.pointer == "/validation/0"


def test_no_recordings_at_all_are_refused():
    with pytest.raises(DynidentError, match="at least one measurement"):
        identify(ROBOT, [])


def test_an_unknown_effect_is_refused_by_its_place_in_the_request():
    with pytest.raises(UnknownEffectError) as caught:
        identify(ROBOT, [TRAINING], [], choices(EffectChoice("rigid_body"), EffectChoice("magic")))
    assert caught.value.pointer.startswith("/effects/1")


def test_no_effects_are_refused():
    with pytest.raises(DynidentError, match="at least one effect"):
        identify(ROBOT, [TRAINING], [], IdentificationChoices(effects=(), preprocessing=BAND))


@pytest.mark.parametrize(
    "twice", [EffectChoice("coulomb"), EffectChoice("coulomb", (ROBOT.joint_names[2],)), EffectChoice("rigid_body")]
)
def test_an_effect_chosen_twice_is_refused(twice):
    with pytest.raises(DynidentError, match="twice"):
        identify(ROBOT, [TRAINING], [], choices(*PLAIN, twice))


def test_effects_on_some_joints_only_are_identified_there():
    first = EffectChoice("offset", ROBOT.joint_names[:2])
    found = identify(ROBOT, [TRAINING], [], choices(*PLAIN, first))
    assert [p.name for p in found.parameters if p.effect == "offset"] == ["b1", "b2"]


@pytest.mark.parametrize(("field", "value"), [("model", "magic"), ("strategy", "magic"), ("estimator", "magic")])
def test_choices_that_are_not_available_say_what_is(field, value):
    with pytest.raises(DynidentError, match="choose from") as caught:
        IdentificationChoices(**{field: value})
    assert caught.value.pointer == f"/{field}"


def test_torque_of_nothing_but_zeros_is_refused_in_words():
    with pytest.raises(EstimationError, match="torque is zero everywhere"):
        identify(ROBOT, [record(ROBOT, MOTION, np.zeros_like(MOTION.q))], [VALIDATION], choices())


def test_nothing_but_friction_can_be_identified_without_the_links():
    found = identify(ROBOT, [TRAINING], [], choices(EffectChoice("coulomb"), EffectChoice("viscous")))
    assert len(found.values) == 12
    assert np.isnan(found.worst_inertia_eigenvalue)
    assert not any("positive definite" in w for w in found.warnings)


def test_auto_preprocessing_is_reported_with_its_reasons():
    found = identify(ROBOT, [TRAINING], [VALIDATION], choices(preprocessing=None))
    assert found.preprocessing.reasons
    assert found.choices.preprocessing is None


def test_progress_never_runs_backwards_and_may_cancel():
    seen: list[float] = []
    identify(ROBOT, [TRAINING], [VALIDATION], choices(), lambda share, message: seen.append(share))
    assert seen == sorted(seen)
    assert seen[0] >= 0
    assert seen[-1] <= 1.0

    def cancel(share: float, message: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        identify(ROBOT, [TRAINING], [], choices(), cancel)


def test_extending_adds_a_rung_to_the_ladder(identified):
    spring = EffectChoice("joint_spring", (ROBOT.joint_names[1],))
    grown = extend(identified, [spring], [TRAINING], [VALIDATION])
    assert grown.step.parent is identified
    assert grown.step.added == (spring,)
    assert [rung.model.n_parameters for rung in grown.ladder()] == [len(identified.values), len(identified.values) + 1]
    assert grown.fit.relative_total <= identified.fit.relative_total * (1 + 1e-6)
    fresh = identify(ROBOT, [TRAINING], [VALIDATION], choices(*WITH_OFFSET, spring, estimator="wls"))
    np.testing.assert_allclose(grown.values, fresh.values, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("nothing", [(), (EffectChoice("coulomb"),)])
def test_extending_by_nothing_new_is_refused(identified, nothing):
    with pytest.raises(DynidentError, match="already in the model"):
        extend(identified, nothing, [TRAINING])


def test_extending_by_what_the_model_can_say_already_is_refused(identified):
    # |q̇|¹ sign q̇ is viscous friction.
    viscous = EffectChoice("viscous_nonlinear", (), (("p", 1.0),))
    with pytest.raises(DynidentError, match="adds nothing"):
        extend(identified, [viscous], [TRAINING])


def test_extending_by_the_same_effect_twice_is_refused(identified):
    spring = EffectChoice("joint_spring", (ROBOT.joint_names[1],))
    with pytest.raises(DynidentError):
        extend(identified, [spring, replace(spring, joints=ROBOT.joint_names[1:3])], [TRAINING])


def test_temperature_dependent_friction_is_refused_where_a_recording_has_no_temperature():
    effect = EffectChoice("temperature_friction", (ROBOT.joint_names[1],))
    with pytest.raises(
        DynidentError, match=r"needs the temperature of every joint, but training has no columns"
    ) as caught:
        identify(ROBOT, [TRAINING], [], choices(*WITH_OFFSET, effect))
    assert caught.value.pointer == f"/effects/{len(WITH_OFFSET)}"
    plain = identify(ROBOT, [TRAINING], [], choices())
    with pytest.raises(DynidentError, match="warm_up_friction") as caught:
        extend(plain, [effect], [TRAINING])
    assert caught.value.pointer == "/effects/0"


def test_temperature_dependent_friction_is_found_where_temperature_was_recorded():
    warm = np.repeat((20.0 + 15.0 * MOTION.t / MOTION.t[-1])[:, None], 6, axis=1)
    tau = noisy(MOTION, 1)
    tau[:, 1] += (warm[:, 1] - 25.0) * (-0.4 * MOTION.dq[:, 1] + 0.2 * np.sign(MOTION.dq[:, 1]))
    run = record(ROBOT, MOTION, tau, temperature=warm)
    effect = EffectChoice("temperature_friction", (ROBOT.joint_names[1],))
    found = identify(ROBOT, [run], [], choices(*WITH_OFFSET, effect))
    named = {parameter.name: parameter for parameter in found.parameters}
    for name, value in (("Fvt2", -0.4), ("Fct2", 0.2)):
        assert named[name].value == pytest.approx(value, abs=max(0.03, 3 * named[name].standard_deviation))


def resting_joint(joint: int, seed: int) -> Motion:
    """A motion in which one joint rests."""
    moves = fourier_motion(ROBOT, 12.0, RATE, seed)
    rests = [signal.copy() for signal in (moves.q, moves.dq, moves.ddq)]
    rests[0][:, joint], rests[1][:, joint], rests[2][:, joint] = 0.4, 0.0, 0.0
    return replace(moves, q=rests[0], dq=rests[1], ddq=rests[2])


def test_a_joint_that_never_moved_is_named_with_what_cannot_be_told_of_it():
    motion = resting_joint(3, 5)
    with pytest.raises(EstimationError, match=f"Ia4, Fc4, Fv4 of {ROBOT.joint_names[3]} .the data do not determine"):
        identify(ROBOT, [record(ROBOT, motion, noisy(motion, 5))], [], choices(*PLAIN))


def test_a_run_in_which_a_joint_rests_makes_what_it_tells_of_the_others_surer(identified):
    motion = resting_joint(3, 5)
    both = identify(ROBOT, [TRAINING, record(ROBOT, motion, noisy(motion, 5), "rests")], [VALIDATION], choices())
    before, after = (np.sqrt(np.diag(one.statistics.covariance)) for one in (identified, both))
    assert np.median(after / before) < 0.9
    assert both.held_out.relative_total < 1.02 * identified.held_out.relative_total


@pytest.mark.parametrize(("moved", "described"), [("ur5", "ur5"), ("ur5", "ur10"), ("ur10", "ur5")])
def test_the_description_of_another_robot_is_told_by_its_masses(moved, described):
    robot, true = arm(described), arm(moved)
    motion = fourier_motion(true, 16.0, 100.0, 7)
    tau = pinocchio_torque(true, motion.q, motion.dq, motion.ddq)
    noise = 0.003 * np.abs(tau).max(axis=0) * np.random.default_rng(7).normal(size=tau.shape)
    found = identify(robot, [record(robot, motion, tau + noise)])
    sentences = [warning for warning in found.warnings if "times as heavy" in warning]
    assert len(sentences) == (moved != described)
    assert all(("0." in sentence) == (moved == "ur5") for sentence in sentences)
