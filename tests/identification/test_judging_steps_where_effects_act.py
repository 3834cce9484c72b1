"""A step of the ladder is judged on the rows that its effect claims to explain, never by what holds joints at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from regressors.test_rows_beside_halts import EXACT, NAMES, PEAK, PLAIN, ROBOT, resting

from dynident.effects import EffectChoice
from dynident.estimation import compute_errors
from dynident.estimation.residual_errors import compute_evenness
from dynident.identification import Identification, IdentificationChoices, extend, identify
from dynident.identification.identified_models import held_out_gain
from dynident.identification.identified_models.held_out_gain import (
    compute_step_gains,
    find_best_of_errors,
    list_addition_warnings,
    list_confirming_rows,
)
from dynident.identification.identified_models.model_files import from_bytes, to_bytes
from dynident.number_format import format_percent
from dynident.presentation.ladder_tables import find_best, list_steps, make_step
from dynident.recordings import Recording, recording_from_arrays
from dynident.regressors.errors_by_phase import compute_errors_by_phase, compute_moving_errors, compute_phase_squares


def noisy(run: Recording, seed: int) -> Recording:
    rows = list(run.source.rows(0, run.segments[0].length, run.segments[0].length))
    q, tau = (np.concatenate([getattr(block, name) for block in rows]) for name in ("q", "tau"))
    tau = tau + 0.3 * np.random.default_rng(seed).standard_normal(tau.shape)
    return recording_from_arrays(np.arange(len(q)) / run.sampling_rate, q, tau, joint_names=NAMES, name=f"run {seed}")


FITTED, HELD_OUT = [noisy(resting(40.0, 1), 3)], [noisy(resting(30.0, 2), 4)]
FALSE = EffectChoice("stribeck", (NAMES[2],), PEAK.shape)


@pytest.fixture(scope="module")
def plain() -> Identification:
    return identify(ROBOT, FITTED, HELD_OUT, IdentificationChoices(effects=PLAIN, preprocessing=EXACT, estimator="wls"))


@pytest.fixture(scope="module")
def grown(plain: Identification) -> Identification:
    return extend(plain, [PEAK], FITTED, HELD_OUT)


def test_every_row_is_of_one_kind_and_blocks_add_up_to_all_of_them(grown: Identification) -> None:
    data, values = grown.data.held_out, grown.values + 0.1
    errors = compute_errors_by_phase(data, values)
    assert errors.starting.counts[0] > 0
    assert not errors.starting.counts[1:].any()
    for rows in ("moving", "reversing", "starting"):
        blocks = compute_phase_squares(data, values, rows).sum(axis=1)
        np.testing.assert_allclose(blocks, getattr(errors, rows).squares, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(compute_moving_errors(data, values).squares, errors.moving.squares)
    np.testing.assert_array_equal(compute_errors(data, values).squares, errors.all_rows.squares)


def test_an_effect_that_is_there_is_confirmed_where_it_acts_whatever_holds_the_joint_at_rest(
    plain: Identification, grown: Identification
) -> None:
    # Halts hold any torque up to many times the friction, and speak for neither model.
    assert plain.held_out.relative_total > 2.0 * plain.held_out_moving.relative_total
    assert "starting" in list_confirming_rows(grown)
    assert list_addition_warnings(grown) == ()
    assert find_best([make_step(plain), make_step(grown)]).best == 1


def test_an_effect_that_is_not_there_is_warned_of_and_its_step_is_not_the_best(grown: Identification) -> None:
    false = extend(grown, [FALSE], FITTED, HELD_OUT)
    assert list_confirming_rows(false) == ()
    (warning, *_) = list_addition_warnings(false)
    before, after = (model.held_out_moving.relative_total for model in (grown, false))
    assert f"where joints move from {format_percent(before)} to {format_percent(after)}" in warning
    assert find_best(list_steps(false)).best == 1


def test_both_models_are_judged_on_the_same_rows(plain: Identification, grown: Identification) -> None:
    moving = compute_step_gains(grown)[0]
    assert moving.rows == "moving"
    assert moving.before == pytest.approx(plain.held_out_moving.relative_total, rel=0.05)
    assert moving.after == pytest.approx(grown.held_out_moving.relative_total, rel=1e-9)


def test_a_model_from_a_file_is_judged_alike(grown: Identification) -> None:
    read = from_bytes(to_bytes(grown))
    for one, other in zip(compute_step_gains(read), compute_step_gains(grown), strict=True):
        assert (one.rows, one.before, one.after) == (
            other.rows,
            pytest.approx(other.before),
            pytest.approx(other.after),
        )
        assert one.t == pytest.approx(other.t, rel=1e-6)


def test_what_helps_elsewhere_and_hurts_where_joints_move_is_not_confirmed(
    grown: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    gains = [replace(gain, before=0.02, after=0.01, t=5.0) for gain in compute_step_gains(grown)]
    monkeypatch.setattr(held_out_gain, "compute_step_gains", lambda model: (replace(gains[0], after=0.021), gains[1]))
    assert list_confirming_rows(grown) == ()
    monkeypatch.setattr(held_out_gain, "compute_step_gains", lambda model: (replace(gains[0], after=0.02), gains[1]))
    assert list_confirming_rows(grown) == ("starting",)


def test_a_first_model_has_nothing_to_be_confirmed(plain: Identification) -> None:
    assert list_confirming_rows(plain) is None


@pytest.mark.parametrize(
    ("totals", "preferred", "best", "rises", "equal"),
    [
        ([0.05, 0.03], [False, False], 1, (), ()),
        ([0.05, 0.0499], [False, False], 0, (), (1,)),  # By less than anybody would notice, and not confirmed.
        ([0.05, 0.0501], [False, True], 1, (), (0,)),  # Confirmed at other rows.
        ([0.05, 0.06], [False, True], 0, (1,), ()),
        ([0.05, 0.03, 0.04, 0.02], [False] * 4, 3, (), ()),
        ([1.0, 1.004, 1.008, 1.012], [False, True, True, True], 1, (2, 3), (0,)),  # The same, step by step, is not.
        ([1.0, 0.9955, 1.0045], [False, False, True], 0, (2,), (1,)),  # Not the same as the smallest.
        ([1.0, 0.996, 0.992, 0.988], [False] * 4, 2, (), (3,)),
        ([1.0, 1.003, 1.02, 1.004], [False] * 4, 0, (2,), (1, 3)),  # Nobody would notice that the error is larger.
    ],
)
def test_the_best_step_is_that_of_the_smallest_error_or_of_the_same_and_confirmed(
    totals: list[float], preferred: list[bool], best: int, rises: tuple[int, ...], equal: tuple[int, ...]
) -> None:
    found = find_best_of_errors(totals, preferred)
    assert found is not None
    assert (found.best, found.rises, found.equal) == (best, rises, equal)


def test_t_is_of_roots_so_that_one_block_that_shows_much_does_not_hide_the_others() -> None:
    gains = np.array([[1.0] * 15 + [400.0], [1.0, -1.0] * 8])
    assert compute_evenness(gains)[0] > 1.8
    assert compute_evenness(gains)[1] == pytest.approx(0.0)
    assert (gains.mean(axis=1) / gains.std(axis=1, ddof=1) * 4)[0] < 1.1
