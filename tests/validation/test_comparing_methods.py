"""Different methods on the same data, in one table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.measured_arm import ROBOT

from dynident.errors import DynidentError
from dynident.identification import identify
from dynident.identification.methods.base_classes import ESTIMATORS, MODELS, STRATEGIES
from dynident.number_format import format_percent
from dynident.regressors.row_phases import RowPhases
from dynident.validation import Method, available_methods, get_method, validate_methods
from dynident.validation.method_comparison import judge_methods


def test_every_available_choice_is_among_the_methods(identified):
    methods = available_methods(identified.choices)
    assert methods[0] == get_method(identified.choices)
    assert len(set(methods)) == len(methods)
    assert {one.model for one in methods} == set(MODELS.names)
    assert {one.strategy for one in methods} == set(STRATEGIES.names)
    assert {one.estimator for one in methods} == set(ESTIMATORS.names)


def test_the_table_has_what_each_method_gives_when_asked_for_alone(identified, training, unseen):
    methods = [Method(estimator="auto"), Method(estimator="ols"), Method(strategy="sequential")]
    table = validate_methods(identified, [training], [unseen], methods)
    for method, row in zip(methods, table.results, strict=True):
        alone = identify(ROBOT, [training], [unseen], method.apply_to(identified.choices))
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
    rows = identified.in_memory.held_out
    squares = measured = 0.0
    gap = table.results[1].values - table.results[0].values
    phases = RowPhases.from_recording(identified.model.observation, unseen, identified.preprocessing)
    for samples in rows.samples[0]:
        used = phases.find_used_rows(samples.segment, samples.t)
        squares += np.sum(identified.model.observation.compute_torque(samples.values, gap)[used] ** 2)
        measured += np.sum(samples.tau[used] ** 2)
    assert table.results[1].torque_distance == pytest.approx(np.sqrt(squares / measured))


def test_the_torque_deviation_is_that_of_drawn_parameters(identified, training, unseen):
    row = validate_methods(identified, [training], [unseen], [Method()]).results[0]
    rng = np.random.default_rng(1)
    gaps = rng.multivariate_normal(np.zeros(len(row.values)), identified.statistics.covariance, size=300)
    rows = identified.in_memory.held_out.samples[0]
    squares = [
        sum(np.sum(identified.model.observation.compute_torque(s.values, gap) ** 2) for s in rows) for gap in gaps
    ]
    measured = sum(np.sum(s.tau**2) for s in rows)
    assert row.torque_deviation == pytest.approx(np.sqrt(np.mean(squares) / measured), rel=0.1)


def test_a_method_that_is_worse_but_no_more_than_it_says_does_not_disagree(identified, training, unseen):
    """The single equation of the power model tells less of the same motion."""
    methods = [Method(), Method(estimator="ols"), Method(model="power")]
    table = validate_methods(identified, [training], [unseen], methods)
    first, second, power = table.results
    assert power.torque_deviation > 3 * first.torque_deviation
    assert power.torque_distance < 2 * power.torque_deviation
    assert table.judged.verdict == "pass", table.judged.reason
    # Far worse, but by no more than its uncertainty: it is named as useless, and its error is none of the range.
    squares = 2500.0 * power.held_out_moving.squares
    moving = replace(power.held_out_moving, squares=squares)
    useless = replace(power, held_out_moving=moving, torque_distance=0.3, torque_deviation=0.4)
    named = f"power, global, wls ({format_percent(moving.relative_total, decimals=1)}, own uncertainty 40.0\u202f%)"
    judged = judge_methods(identified, [first, second, useless], held_out=True)
    assert judged.verdict == "pass"
    assert judged.reason.startswith("2 methods predict")
    assert f"within their own uncertainty on these data: {named}" in judged.reason
    assert judge_methods(identified, [first, useless], held_out=True).verdict == "not_evaluated"
    # The model's own method is what is judged: it is never set aside, however uncertain it is.
    failed = judge_methods(identified, [replace(useless, torque_distance=0.0), first, second], held_out=True)
    assert failed.verdict == "fail"
    assert "worse than the best" in failed.reason
    assert "No evidence" not in failed.reason


def test_a_method_that_cannot_be_used_has_its_reason_in_the_table(identified, training, unseen):
    """Nothing that belongs to friction alone has been recorded."""
    if "separate_friction" not in STRATEGIES.names:
        pytest.skip("the strategy is not available")
    methods = [Method(), Method(strategy="separate_friction"), Method(estimator="ols")]
    table = validate_methods(identified, [training], [unseen], methods)
    assert table.results[1].values is None
    assert "friction" in table.results[1].problem
    assert table.judged.verdict == "pass"


def test_methods_that_disagree_fail_and_are_named(identified, training, unseen):
    table = validate_methods(identified, [training], [unseen], [Method(), Method(estimator="ols")])
    first, second = table.results
    far = replace(second, distance=second.distance + 5.0)
    judged = judge_methods(identified, [first, far], held_out=True)
    assert judged.verdict == "fail"
    assert f"dynamic, global, ols ({far.distance_rms:.1f}" in judged.reason
    squares = 4.0 * second.held_out_moving.squares
    worse = replace(second, held_out_moving=replace(second.held_out_moving, squares=squares), torque_distance=0.5)
    judged = judge_methods(identified, [first, worse], held_out=True)
    assert judged.verdict == "fail"
    assert f"dynamic, global, ols ({format_percent(worse.held_out_moving.relative_total, decimals=1)})" in judged.reason


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


def test_other_equations_that_predict_worse_do_not_fail_a_good_model(identified, training, unseen):
    table = validate_methods(
        identified, [training], [unseen], [Method(), Method(estimator="ols"), Method(model="energy")]
    )
    *own, energy = table.results
    squares = 9.0 * energy.held_out_moving.squares
    worse = replace(
        energy,
        held_out_moving=replace(energy.held_out_moving, squares=squares),
        torque_distance=0.5,
        torque_deviation=0.01,
        distance=energy.distance + 9.0,
    )
    judged = judge_methods(identified, [*own, worse], held_out=True)
    assert judged.verdict == "pass"
    assert "energy" in judged.reason
