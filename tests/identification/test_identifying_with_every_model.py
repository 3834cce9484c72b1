"""An identification with each of the models: results, growth, storage, diagnosis, and what cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.diagnosis import compare, diagnose
from dynident.effects import EffectChoice, ReferenceParameters
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, extend, identify, identify_model
from dynident.identification.equations.filtered_energy_power_wrench import find_constants
from dynident.identification.identified_models.model_files import from_bytes, to_bytes
from dynident.identification.identified_models.remove_and_solve_again import remove
from dynident.progress import ignore_progress
from dynident.recordings import Preprocessing, find_motion_band
from dynident.regressors.model_structure import build_model
from dynident.reports import ReportedRecording, html_report

ROBOT = arm("scara")
RATE = 200.0
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
SPRING = EffectChoice("joint_spring", (ROBOT.joint_names[0],))
MODELS = ("dynamic", "filtered", "energy", "power")
NOISE = np.array([1.0, 0.7, 2.0, 0.2])
BAND = Preprocessing(12.0, 8.0, 6)


def clean_motion(seed: int, seconds: float):
    """A motion and its torque without noise."""
    motion = fourier_motion(ROBOT, seconds, RATE, seed, base_frequency=0.08, amplitude=2.0)
    ia, fc, fv, b = np.random.default_rng(0).uniform(0.5, 5.0, (4, ROBOT.n))
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    tau += ia * motion.ddq + fc * np.sign(motion.dq) + fv * motion.dq + b
    return motion, tau


def run(seed: int, seconds: float = 60.0, noise: float = 1.0, stiffness: float = 0.0, **more):
    motion, tau = clean_motion(seed, seconds)
    tau[:, 0] += stiffness * motion.q[:, 0]
    tau += noise * NOISE * np.random.default_rng(seed).normal(size=tau.shape)
    return record(ROBOT, motion, tau, f"run {seed}", **more)


TRAINING, VALIDATION = [run(1), run(2)], [run(3)]
SPRUNG, SPRUNG_VALIDATION = [run(1, stiffness=30.0), run(2, stiffness=30.0)], [run(3, stiffness=30.0)]


def choices(model: str, **more) -> IdentificationChoices:
    return IdentificationChoices(**{"effects": EFFECTS, "model": model, "preprocessing": BAND, **more})


def truth(found) -> np.ndarray:
    drawn = np.random.default_rng(0).uniform(0.5, 5.0, 4 * ROBOT.n)
    return found.model.base.grouping @ np.concatenate([ROBOT.inertias.ravel(), drawn])


@pytest.fixture(scope="module")
def found():
    return {model: identify(ROBOT, TRAINING, VALIDATION, choices(model)) for model in MODELS}


def test_all_models_have_the_same_base_parameters_and_errors_of_the_same_torque(found):
    names = [p.name for p in found["dynamic"].parameters]
    for one in found.values():
        assert [p.name for p in one.parameters] == names
        np.testing.assert_array_equal(one.held_out.measured, found["dynamic"].held_out.measured)
        assert one.fit.rms.shape == one.noise.shape == one.effective_rows.shape == (ROBOT.n,)


def test_noisy_torque_is_within_what_every_model_promises(found):
    for which, one in found.items():
        off = (one.values - truth(one)) / one.statistics.standard_deviations
        assert np.sqrt(np.mean(off**2)) < 2.0, which
        assert np.abs(off).max() < 5.0, which


@pytest.mark.slow
def test_95_per_cent_intervals_of_every_model_cover_the_truth_for_every_class_of_parameters(thorough):
    model = build_model(ROBOT, EFFECTS)
    effects = np.array([column.effect for column in model.kept])
    motion, clean = clean_motion(1, 60.0)
    off = {which: [] for which in MODELS}
    for seed in range(40 if thorough else 20):
        drawn = np.random.default_rng(seed)
        recording = record(ROBOT, motion, clean + NOISE * drawn.normal(size=clean.shape))
        for which in MODELS:
            asked = choices(which, pole=50.0, interval=0.3)
            one = identify_model(
                model, [recording], [], asked, BAND, ReferenceParameters.massless(ROBOT), ignore_progress
            )
            off[which].append((one.values - truth(one)) / one.statistics.standard_deviations)
    for which, found_off in off.items():
        inside = np.abs(np.array(found_off)) < 1.96
        for effect in dict.fromkeys(effects):
            # 80 cases or more: 95 % within three standard deviations of a share of so many.
            assert 0.877 < inside[:, effects == effect].mean() <= 1.0, (which, effect)
        assert 0.92 < inside.mean() < 0.985, which


def test_one_equation_is_less_exciting_than_one_a_joint(found):
    # §12.7; and the filtered model is the dynamic one, rightly processed.
    held_out = {which: one.held_out.relative_total for which, one in found.items()}
    assert held_out["filtered"] == pytest.approx(held_out["dynamic"], rel=0.05)
    assert held_out["power"] >= held_out["dynamic"]
    assert held_out["energy"] >= held_out["dynamic"]
    assert len(found["filtered"].data.equations.equations) == ROBOT.n
    assert len(found["power"].data.equations.equations) == len(found["energy"].data.equations.equations) == 1


def test_the_constants_of_a_model_are_chosen_once_and_their_reason_is_told(found):
    filtered, energy = found["filtered"], found["energy"]
    assert filtered.choices.pole == pytest.approx(2 * np.pi * 8.0, abs=0.1)
    assert energy.choices.interval == pytest.approx(1 / (8 * find_motion_band(TRAINING)))
    for one, word in ((filtered, "a = 50.3 rad/s"), (energy, "intervals of")):
        assert word in one.preprocessing.reasons[-1]
        again, preprocessing = find_constants(one.choices.row_options, TRAINING, one.preprocessing)
        assert (again, preprocessing) == (one.choices.row_options, one.preprocessing)
    given = identify(ROBOT, TRAINING, [], choices("filtered", pole=15.0))
    assert given.choices.pole == 15.0
    assert not any("F(s)" in reason for reason in given.preprocessing.reasons)


@pytest.mark.parametrize("model", MODELS[1:])
def test_an_identification_of_any_model_is_the_same_after_storage(found, model):
    one = found[model]
    again = from_bytes(to_bytes(one))
    assert again.choices == one.choices
    np.testing.assert_array_equal(again.values, one.values)
    np.testing.assert_array_equal(again.statistics.noise, one.statistics.noise)
    np.testing.assert_allclose(again.noise, one.noise)
    np.testing.assert_allclose(again.effective_rows, one.effective_rows)
    assert again.n_equations == one.n_equations


@pytest.mark.sweep
@pytest.mark.parametrize("model", MODELS)
def test_effects_are_added_to_and_taken_out_of_any_model(model):
    plain = identify(ROBOT, SPRUNG, SPRUNG_VALIDATION, choices(model))
    grown = extend(plain, [SPRING], SPRUNG, SPRUNG_VALIDATION)
    whole = identify(ROBOT, SPRUNG, SPRUNG_VALIDATION, choices(model, effects=(*EFFECTS, SPRING)))
    np.testing.assert_allclose(grown.values, whole.values, rtol=1e-6, atol=1e-6)
    assert grown.held_out.relative_total < plain.held_out.relative_total
    stiffness = next(p for p in grown.parameters if p.name == "ks1")
    assert stiffness.value == pytest.approx(30.0, abs=max(1.5, 5 * stiffness.standard_deviation))
    smaller = remove(grown, [SPRING])
    np.testing.assert_allclose(smaller.values, plain.values, rtol=1e-6, atol=1e-6)
    again = remove(from_bytes(to_bytes(grown)), [SPRING])
    np.testing.assert_allclose(again.values, plain.values, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("model", ["filtered", "power"])
def test_a_report_is_written_of_any_model(found, model):
    page = html_report(found[model], [ReportedRecording(VALIDATION[0], compare(found[model], VALIDATION[0]), True)])
    assert all(name in page for name in ROBOT.joint_names)
    assert {"filtered": "in F(s)", "power": "has one equation"}[model] in page


@pytest.mark.slow
@pytest.mark.parametrize("model", ["filtered", "power"])
def test_what_is_missing_is_found_whatever_the_model(model):
    plain = identify(ROBOT, SPRUNG, SPRUNG_VALIDATION, choices(model))
    assert "joint_spring" in {choice.effect for choice in diagnose(plain, SPRUNG).recommended}


def test_a_model_of_one_equation_says_that_torque_was_not_fitted(found):
    assert [which for which in MODELS if any("§12.6" in w for w in found[which].warnings)] == ["energy", "power"]


def test_joints_that_swing_together_are_told_apart_by_torque_and_not_by_power():
    motion = fourier_motion(ROBOT, 20.0, RATE, 1, base_frequency=0.2, amplitude=1.0)
    # All joints in one line: viscous friction of each has the same power, whatever its share.
    together = replace(
        motion, **{name: np.repeat(getattr(motion, name)[:, :1], ROBOT.n, 1) for name in ("q", "dq", "ddq")}
    )
    tau = pinocchio_torque(ROBOT, together.q, together.dq, together.ddq) + 2.0 * together.dq
    recording = record(ROBOT, together, tau)
    friction = (EffectChoice("viscous"), EffectChoice("coulomb"))
    assert identify(ROBOT, [recording], [], choices("dynamic", effects=friction)).values.shape == (2 * ROBOT.n,)
    with pytest.raises(DynidentError, match="torques that do no work") as caught:
        identify(ROBOT, [recording], [], choices("power", effects=friction))
    assert caught.value.pointer == "/model"
    assert "Fv1" in caught.value.detail
    assert "dynamic" in caught.value.detail


@pytest.mark.parametrize(
    ("field", "value"), [("pole", 0.0), ("pole", float("nan")), ("interval", -1.0), ("interval", float("inf"))]
)
def test_impossible_constants_are_refused(field, value):
    with pytest.raises(DynidentError, match="it must be") as caught:
        choices("filtered", **{field: value})
    assert caught.value.pointer == f"/{field}"


@pytest.mark.parametrize(("model", "field", "value"), [("filtered", "pole", 0.01), ("energy", "interval", 300.0)])
def test_constants_that_leave_no_equation_are_named(model, field, value):
    with pytest.raises(DynidentError, match="no rows are left") as caught:
        identify(ROBOT, TRAINING, [], choices(model, **{field: value}))
    assert caught.value.pointer == f"/{field}"


def test_windows_that_leave_nothing_are_an_error_in_every_model():
    short = run(1, windows=((5.0, 5.1),))
    for model in MODELS:
        with pytest.raises(DynidentError, match=r"no rows are left|at most"):
            identify(ROBOT, [short], [], choices(model))
