"""Different methods on the same data, in one table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_arm import BAND, ROBOT

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, identify
from dynident.identification.choices import AVAILABLE_ESTIMATORS, AVAILABLE_MODELS, AVAILABLE_STRATEGIES
from dynident.validation import Method, available_methods, method_of, validate_methods


def test_every_available_choice_is_among_the_methods(identified):
    methods = available_methods(identified.choices)
    assert methods[0] == method_of(identified.choices)
    assert len(set(methods)) == len(methods)
    assert {one.model for one in methods} == set(AVAILABLE_MODELS)
    assert {one.strategy for one in methods} == set(AVAILABLE_STRATEGIES)
    assert {one.estimator for one in methods} == set(AVAILABLE_ESTIMATORS)


def test_the_table_has_what_each_method_gives_when_asked_for_alone(identified, training, unseen):
    methods = [Method(), Method(estimator="ols"), Method(strategy="sequential")]
    table = validate_methods(identified, [training], [unseen], methods)
    for method, row in zip(methods, table.results, strict=True):
        alone = identify(ROBOT, [training], [unseen], method.of(identified.choices))
        assert row.values == pytest.approx(alone.values)
        assert row.held_out.relative == pytest.approx(alone.held_out.relative)
        deviations = np.hypot(alone.statistics.standard_deviations, identified.statistics.standard_deviations)
        assert row.distance == pytest.approx(np.abs(alone.values - identified.values) / deviations, abs=1e-9)
    assert table.results[0].distance_rms == 0.0
    assert table.results[1].torque_distance > 0
    assert table.held_out


def test_ordinary_and_weighted_least_squares_agree(identified, training, unseen):
    judged = validate_methods(identified, [training], [unseen], [Method(), Method(estimator="ols")]).judged
    assert judged.verdict == "pass"
    assert "2 methods" in judged.reason


def test_the_torque_distance_is_that_of_the_predicted_torques(identified, training, unseen):
    table = validate_methods(identified, [training], [unseen], [Method(), Method(estimator="ols")])
    rows = identified.rows[1]
    squares = measured = 0.0
    gap = table.results[1].values - table.results[0].values
    for samples in rows.samples[0]:
        squares += np.sum(identified.model.observation.torque(samples.values, gap) ** 2)
        measured += np.sum(samples.tau**2)
    assert table.results[1].torque_distance == pytest.approx(np.sqrt(squares / measured))


def test_a_method_that_cannot_be_used_has_its_reason_in_the_table(identified, training, unseen):
    """Nothing that belongs to friction alone has been recorded."""
    if "separate_friction" not in AVAILABLE_STRATEGIES:
        pytest.skip("the strategy is not available")
    methods = [Method(), Method(strategy="separate_friction"), Method(estimator="ols")]
    table = validate_methods(identified, [training], [unseen], methods)
    assert table.results[1].values is None
    assert "friction" in table.results[1].problem
    assert table.judged.verdict == "pass"


def test_methods_that_disagree_fail_and_are_named(identified, training, unseen):
    """Torque that no model of this kind explains: ordinary least squares spreads it over all joints."""
    source = training.source
    tau = source.tau.copy()
    tau[:, 0] += 300.0 * np.sin(40.0 * source.q[:, 1])
    spoilt = replace(training, source=replace(source, tau=tau))
    effects = (*identified.choices.effects, EffectChoice("offset"))
    model = identify(ROBOT, [spoilt], [unseen], IdentificationChoices(effects=effects, preprocessing=BAND))
    table = validate_methods(model, [spoilt], [unseen], [Method(), Method(estimator="ols")])
    assert table.judged.verdict == "fail"
    assert "dynamic, global, ols" in table.judged.reason


def test_one_method_alone_is_not_evaluated(identified, training):
    table = validate_methods(identified, [training], methods=[Method()])
    assert table.judged.verdict == "not_evaluated"
    assert not table.held_out


def test_unknown_methods_and_missing_recordings_are_refused(identified, training):
    with pytest.raises(DynidentError) as refused:
        validate_methods(identified, [training], methods=[Method(estimator="magic")])
    assert refused.value.pointer == "/estimator"
    with pytest.raises(DynidentError, match="measurements"):
        validate_methods(identified, [])


@pytest.mark.slow
def test_all_available_methods_agree_on_a_robot_that_fits_the_model(identified, training, unseen):
    table = validate_methods(identified, [training], [unseen])
    solved = [row for row in table.results if row.held_out is not None]
    assert all(row.problem for row in table.results if row.held_out is None)
    assert len(solved) >= 4
    for row in solved:
        if row.method.model in ("dynamic", "filtered") and row.method.prior is None:
            assert row.held_out.relative_total < 1.3 * identified.held_out.relative_total, row.method.words
