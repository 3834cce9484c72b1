"""Rows in which a joint moves for a part of the time only: equations of that motion, whatever it is held by at rest."""

from __future__ import annotations

import numpy as np
import pytest
from support.oracles import arm, pinocchio_torque

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.estimation import Errors, compute_errors, solve_weighted
from dynident.identification import IdentificationChoices, extend, identify
from dynident.identification.identified_models.model_files import from_bytes, to_bytes
from dynident.recordings import Preprocessing, Recording, filtered_blocks, recording_from_arrays
from dynident.recordings.joint_phases import find_phases
from dynident.regressors.errors_by_phase import compute_moving_errors
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.row_cache import reduce_and_cache

ROBOT = arm("scara")
NAMES = ROBOT.joint_names
RATE, PERIOD, MOVES = 200.0, 2.0, 1.6
VS = 0.08
PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
PEAK = EffectChoice("stribeck", NAMES[:1], (("vs", VS), ("delta", 2.0)))
EXACT = Preprocessing(position_cutoff=None, torque_cutoff=8.0, decimation=5)
COULOMB, VISCOUS, EXCESS = 3.0, 2.0, 2.5


def resting(seconds: float, seed: int) -> Recording:
    """Moves with pauses; friction as the model has it, and at rest any torque at all, drawn anew for every pause."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    # Along each move the time of a swing goes from 0 to 1, without a jump of the acceleration at either end.
    share = np.minimum((t % PERIOD) / MOVES, 1.0)
    number = (t // PERIOD).astype(int)
    corners = np.cumsum(random.uniform(0.15, 0.5, (number[-1] + 2, ROBOT.n)) * random.choice([-1, 1], ROBOT.n), axis=0)
    corners = np.where(
        np.arange(len(corners))[:, None] % 2 == 1, corners[:1] + 0.4 + 0.2 * np.sin(corners), corners[:1]
    )
    smooth = share**4 * (35 - 84 * share + 70 * share**2 - 20 * share**3)
    q = corners[number] + (corners[number + 1] - corners[number]) * smooth[:, None]
    recorded = recording_from_arrays(t, q, np.zeros_like(q), joint_names=NAMES, name="shape")
    # The derivatives that the rows will have: what is tested is what the filter does with the torque.
    blocks = list(filtered_blocks(recorded, EXACT))
    q, dq, ddq = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("q", "dq", "ddq"))
    friction = COULOMB * np.sign(dq) + VISCOUS * dq
    friction[:, 0] += EXCESS * np.exp(-((dq[:, 0] / VS) ** 2)) * np.sign(dq[:, 0])
    halts = find_phases(recorded).halts[0]
    still = np.column_stack([one.is_near(t, 1e-6, 1e-6, one.sticks) for one in halts])
    held = random.uniform(-5.0, 5.0, (number[-1] + 1, ROBOT.n))
    tau = pinocchio_torque(ROBOT, q, dq, ddq) + np.where(still, held[number], friction)
    return recording_from_arrays(t, q, tau, joint_names=NAMES, name="run")


def told(rows: Errors) -> float:
    return float(rows.rms[0])


def test_rows_beside_halts_are_exact_whatever_the_joint_is_held_by_at_rest():
    run = resting(40.0, 1)
    model = build_model(ROBOT, (*PLAIN, PEAK))
    reduction, _ = reduce_and_cache(model, RegressorInputs([run], EXACT, ReferenceParameters.massless(ROBOT)))
    (beside,) = (e.separate_rows for e in reduction.equations[:1])
    assert beside is not None
    assert beside.counted.count > 100
    values = solve_weighted(reduction).values
    places = {(c.effect, c.link): k for k, c in enumerate(model.kept)}
    assert values[places["stribeck", NAMES[0]]] == pytest.approx(EXCESS, rel=1e-6)
    assert values[places["coulomb", NAMES[0]]] == pytest.approx(COULOMB, rel=1e-6)
    own = values[reduction.equations[0].columns]
    assert np.sqrt(beside.counted.sum_squares(own) / beside.counted.count) < 1e-8


def test_only_joints_whose_friction_shows_there_use_them_and_every_row_is_counted_once():
    run = resting(20.0, 2)
    with_peak, without = (
        reduce_and_cache(
            build_model(ROBOT, effects), RegressorInputs([run], EXACT, ReferenceParameters.massless(ROBOT))
        )[0]
        for effects in ((*PLAIN, PEAK), PLAIN)
    )
    counts = [
        [e.separate_rows.counted.count for e in one.equations if e.separate_rows is not None]
        for one in (with_peak, without)
    ]
    assert counts[0][0] > 0
    assert not any(counts[0][1:])
    assert not any(counts[1])
    for told_of in (compute_errors, compute_moving_errors):
        np.testing.assert_allclose(
            *(told_of(one, np.zeros(one.n_columns)).counts for one in (with_peak, without)), err_msg=told_of.__name__
        )
    np.testing.assert_allclose(
        *(compute_errors(one, np.zeros(one.n_columns)).measured for one in (with_peak, without)), rtol=1e-3
    )


def test_a_torque_that_is_late_predicts_no_jumps_of_friction_at_rest():
    run = resting(30.0, 5)
    rows = np.concatenate([block.q for block in filtered_blocks(run, EXACT)])
    tau = np.concatenate([block.tau for block in filtered_blocks(run, EXACT)])
    noisy = rows + np.random.default_rng(6).normal(0.0, 2e-5, rows.shape)
    late = np.concatenate([tau[:1], tau[:-1]])  # by 5 ms
    told_late = recording_from_arrays(np.arange(len(rows)) / RATE, noisy, late, joint_names=NAMES, name="late")
    filters = Preprocessing(position_cutoff=20.0, torque_cutoff=8.0, decimation=5)
    first = identify(ROBOT, [told_late], (), IdentificationChoices((*PLAIN, PEAK), preprocessing=filters))
    grown = extend(first, [EffectChoice("torque_delay")], [told_late])
    found = dict(zip([c.effect for c in grown.model.kept], grown.values, strict=True))
    assert found["torque_delay"] != 0.0
    assert (grown.fit.rms < 1.02 * first.fit.rms).all()
    assert grown.fit_moving.rms.sum() < first.fit_moving.rms.sum()


def test_a_model_that_is_extended_is_the_one_that_is_made_at_once_and_is_read_back_as_it_was():
    runs = resting(20.0, 3), resting(12.0, 4)
    first = identify(ROBOT, runs[:1], runs[1:], IdentificationChoices(PLAIN, preprocessing=EXACT))
    grown = extend(first, [PEAK, EffectChoice("offset", NAMES[:1])], runs[:1], runs[1:])
    more = extend(grown, [EffectChoice("offset", NAMES[1:2])], runs[:1], runs[1:])
    whole = identify(ROBOT, runs[:1], runs[1:], IdentificationChoices(more.model.effects, preprocessing=EXACT))
    for one, other in ((more.fit, whole.fit), (more.held_out, whole.held_out)):
        assert one is not None
        assert other is not None
        np.testing.assert_allclose(one.rms, other.rms, rtol=1e-6, atol=1e-9)
    again = from_bytes(to_bytes(more))
    assert again.fit_moving.rms.tolist() == more.fit_moving.rms.tolist()
    assert told(compute_errors(again.data.training, again.values)) == told(
        compute_errors(more.data.training, more.values)
    )
