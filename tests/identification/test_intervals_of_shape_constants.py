"""Shape constants come with an interval, or with words where no number says how sure they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.estimation import build_weighted_factor, statistics
from dynident.identification import (
    Identification,
    IdentificationChoices,
    extend,
    from_bytes,
    identify,
    reidentify,
    remove,
    to_bytes,
)
from dynident.identification.identified_models.correlated_and_essential_parameters import essential_parameters
from dynident.recordings import Preprocessing
from dynident.regressors.qr_accumulation import MOST_VALUES

ROBOT = arm("scara")
NAMES = ROBOT.joint_names
BASE = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
BAND = Preprocessing(None, 20.0, 3)
STRIBECK = EffectChoice("stribeck", (NAMES[0],))
VS, AMPLITUDE = 0.15, 4.0


def recorded(seed: int, amplitude: float = AMPLITUDE, noise: float = 0.3):
    motion = fourier_motion(ROBOT, 30.0, 200.0, 1)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 2 * np.sign(motion.dq) + motion.dq
    v = motion.dq[:, 0]
    tau[:, 0] += amplitude * np.exp(-((v / VS) ** 2)) * np.sign(v)
    tau += noise * np.random.default_rng(seed).normal(size=tau.shape)
    return record(ROBOT, motion, tau, f"run {seed}")


def identified(run, *effects: EffectChoice, **choices) -> Identification:
    asked = IdentificationChoices((*BASE, *effects), preprocessing=BAND, **choices)
    return identify(ROBOT, [run], [], asked)


def constant(found: Identification, name: str):
    return next(one for one in found.shape_constants if one.name == name)


RUN = recorded(0)
FOUND = identified(RUN, STRIBECK)


def test_a_stribeck_velocity_has_an_interval_that_holds_the_true_one():
    found = constant(FOUND, "vs")
    assert found.judgement == "determined"
    assert (found.effect, found.joints, found.unit) == ("stribeck", (NAMES[0],), "rad/s")
    assert found.interval is not None
    assert found.interval[0] < VS < found.interval[1]
    assert found.interval[0] < found.value < found.interval[1]
    assert found.interval[1] - found.interval[0] < 0.05


def test_its_deviation_is_the_spread_over_draws_of_the_noise():
    drawn = [constant(identified(recorded(seed), STRIBECK), "vs") for seed in range(1, 25)]
    spread = np.std([one.value for one in drawn], ddof=1)
    told = np.sqrt(np.mean([one.standard_deviation**2 for one in drawn]))
    assert 0.65 < told / spread < 1.5


def test_parameters_are_told_with_the_shape_uncertain():
    amplitude = next(p for p in FOUND.parameters if p.name == "Fst1")
    assert amplitude.interval[0] < AMPLITUDE < amplitude.interval[1]
    coulomb = next(k for k, p in enumerate(FOUND.parameters) if p.name == "Fc1")
    certain = statistics(FOUND.data.equations, FOUND.estimate.solution).standard_deviations
    assert FOUND.statistics.standard_deviations[coulomb] > 1.05 * certain[coulomb]


def test_what_is_one_of_a_few_kinds_is_said_to_be_chosen():
    found = constant(FOUND, "delta")
    assert (found.judgement, found.interval) == ("chosen", None)
    assert "discrete values" in found.note


def test_without_the_effect_in_the_data_the_constant_is_not_determined():
    found = constant(identified(recorded(5, amplitude=0.0, noise=1.0), STRIBECK), "vs")
    assert found.judgement in ("not_determined", "at_edge")
    assert found.interval is None
    assert found.note


def test_a_given_constant_that_the_data_would_have_elsewhere_is_said_to_be():
    given = replace(STRIBECK, shape=(("delta", 2.0), ("vs", 0.16)))
    found = constant(identified(RUN, given), "vs")
    assert found.value == 0.16
    assert found.judgement == "elsewhere"
    assert found.interval is not None
    assert found.interval[0] < VS < found.interval[1] < 0.16
    far = constant(identified(RUN, replace(STRIBECK, shape=(("delta", 2.0), ("vs", 0.4)))), "vs")
    assert (far.judgement, far.interval) == ("elsewhere", None)
    assert "smaller" in far.note


def test_an_extension_tells_the_same_from_rows_that_were_kept():
    plain = identified(RUN)
    grown = extend(plain, [STRIBECK], [RUN])
    assert RUN.n_samples * 10 < MOST_VALUES
    kept, anew = constant(grown, "vs"), constant(identified(RUN, *grown.choices.effects[3:]), "vs")
    assert kept.value == anew.value
    assert kept.standard_deviation == pytest.approx(anew.standard_deviation, rel=1e-6)


def test_files_keep_them():
    read = from_bytes(to_bytes(FOUND))
    assert read.shape_constants == FOUND.shape_constants
    assert read.data.shaped is not None
    np.testing.assert_array_equal(read.statistics.covariance, FOUND.statistics.covariance)


def test_solved_again_from_reduced_data_they_stay():
    again = reidentify(FOUND, replace(FOUND.choices, estimator="ols"))
    assert constant(again, "vs").interval == pytest.approx(constant(FOUND, "vs").interval, rel=0.1)
    same = reidentify(FOUND, FOUND.choices)
    assert constant(same, "vs").standard_deviation == pytest.approx(constant(FOUND, "vs").standard_deviation)
    np.testing.assert_allclose(same.statistics.covariance, FOUND.statistics.covariance, rtol=1e-8)


def test_with_another_effect_taken_out_they_stay():
    both = identified(RUN, EffectChoice("offset"), STRIBECK)
    left = remove(both, [EffectChoice("offset")])
    assert constant(left, "vs").standard_deviation == pytest.approx(constant(FOUND, "vs").standard_deviation, rel=0.02)
    assert not [one for one in remove(both, [EffectChoice("stribeck")]).shape_constants if one.name == "vs"]


def test_essential_parameters_are_told_with_the_shape_uncertain():
    noisy = identified(recorded(6, noise=2.0), STRIBECK)
    left = essential_parameters(noisy, ratio=3.0)
    assert left.steps
    kept = [k for k in range(noisy.model.n_parameters) if k not in left.identification.estimate.not_essential]
    data = noisy.data.equations.select_columns(kept)
    known = replace(left.identification.estimate.solution, values=left.identification.values[kept])
    factor = build_weighted_factor(data, known.noise)[:-1, :-1]
    certain = statistics(data, replace(known, factor=factor)).standard_deviations
    coulomb = next(k for k, column in enumerate(noisy.model.kept) if column.name == "Fc1")
    told = left.identification.statistics.standard_deviations[coulomb]
    assert told > 1.02 * certain[kept.index(coulomb)]


@pytest.mark.parametrize("method", [{"estimator": "irls"}, {"strategy": "sequential"}, {"model": "filtered"}])
def test_other_methods_tell_it_too(method):
    found = constant(identified(RUN, STRIBECK, **method), "vs")
    assert found.interval is not None
    assert found.standard_deviation == pytest.approx(constant(FOUND, "vs").standard_deviation, rel=0.5)
