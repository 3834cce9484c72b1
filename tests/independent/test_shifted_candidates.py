"""The placebo shifts what it says it shifts, and asks the rule that the diagnosis asks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hiding.drawing import Wanted, draw_cases
from hiding.manners import Manners
from hiding.recorded import recorded
from placebo import named_at
from placebos.decision import Question
from placebos.shifting import IndexArray, ShiftedCandidates, Shifts, rolled, whole_runs, wrong_shares

from dynident.diagnosis import diagnose
from dynident.effects import EffectChoice, Signals, build_columns
from dynident.identification import identify
from dynident.recordings import Recording, recording_from_arrays
from dynident.regressors.dynamic_model_rows import FilteredSamples
from dynident.regressors.observation_matrix import Observation
from dynident.robot import robot_from_library

ROBOT = robot_from_library("scara")
SIGNALS = Signals(ROBOT)
COLUMNS = build_columns([EffectChoice(name) for name in ("coulomb", "viscous", "stribeck", "offset")], SIGNALS)
OBSERVATION = Observation.from_columns(ROBOT, COLUMNS, SIGNALS)
N_BASE = ROBOT.n
OWN = frozenset(column.key for column in COLUMNS[:N_BASE])
RNG = np.random.default_rng(3)


def _run(number: int, length: int) -> FilteredSamples:
    values, tau = (RNG.standard_normal((length, width)) for width in (len(OBSERVATION.entry_rows), ROBOT.n))
    held = RNG.uniform(size=(length, ROBOT.n))
    return FilteredSamples(np.arange(length) / 20.0, values, tau, number, held=held)


ROWS = [_run(0, 80), _run(1, 50)]
RECORDING = recording_from_arrays(
    np.arange(400) / 100.0,
    np.zeros((400, ROBOT.n)),
    np.zeros((400, ROBOT.n)),
    joint_names=ROBOT.joint_names,
    segment=np.repeat([1, 2], 200),
    name="two runs",
)


def _in_blocks(recording: Recording) -> Iterator[FilteredSamples]:
    for run in ROWS:
        for part in np.array_split(np.arange(len(run.t)), 3):
            yield FilteredSamples(run.t[part], run.values[part], run.tau[part], run.segment, held=run.held[part])


def _alike(recording: Recording, samples: FilteredSamples) -> IndexArray:
    return np.zeros(samples.tau.shape, dtype=np.intp)


def _shifted(shifts: Shifts) -> list[FilteredSamples]:
    return list(ShiftedCandidates(OBSERVATION, OWN, _in_blocks, shifts, _alike)(RECORDING))


def test_blocks_of_a_run_are_put_together() -> None:
    for joined, run in zip(whole_runs(_in_blocks(RECORDING)), ROWS, strict=True):
        assert np.array_equal(joined.values, run.values)
        assert joined.segment == run.segment


def test_columns_of_the_model_and_torque_stay_in_their_place() -> None:
    mine = OBSERVATION.entry_columns < N_BASE
    for shifted, run in zip(_shifted(Shifts(np.random.default_rng(1))), ROWS, strict=True):
        assert np.array_equal(shifted.values[:, mine], run.values[:, mine])
        assert np.array_equal(shifted.tau, run.tau)
        assert np.array_equal(shifted.held, run.held)


def test_columns_of_candidates_come_later_by_the_share_that_was_drawn() -> None:
    shifts = Shifts(np.random.default_rng(1))
    for shifted, run in zip(_shifted(shifts), ROWS, strict=True):
        for k in np.flatnonzero(OBSERVATION.entry_columns >= N_BASE):
            column = OBSERVATION.columns[OBSERVATION.entry_columns[k]]
            share = shifts.share(column.effect, column.link, RECORDING.name_segment(run.segment), np.empty(0))
            assert 0.1 < share < 0.9
            assert np.array_equal(shifted.values[:, k], np.roll(run.values[:, k], round(share * len(run.t))))


def test_effects_joints_and_runs_are_shifted_apart() -> None:
    shifts = Shifts(np.random.default_rng(1))
    possible = np.linspace(0.2, 0.8, 1000)
    shares = {shifts.share(effect, joint, run, possible) for effect in "ab" for joint in "cd" for run in "ef"}
    assert len(shares) == 8
    assert shifts.share("a", "c", "e", possible) == shifts.share("a", "c", "e", possible)


def test_a_periodic_run_is_not_shifted_by_a_period() -> None:
    t = np.arange(400) / 400
    shares = wrong_shares(np.column_stack([np.sin(2 * np.pi * 4 * t), np.cos(2 * np.pi * 8 * t)]))
    assert len(shares) > 20
    assert all(abs(shares - period).min() > 0.02 for period in (0.25, 0.5, 0.75))
    # Noise is never like itself.
    assert len(wrong_shares(RNG.standard_normal((400, 2)))) > 200


def test_rows_change_places_with_rows_of_their_own_kind() -> None:
    kinds = RNG.integers(0, 3, 90)
    values = np.column_stack([kinds, np.arange(90.0)])
    out = rolled(values, 0.4, kinds)
    assert np.array_equal(out[:, 0], kinds)
    assert sorted(out[:, 1]) == sorted(values[:, 1])
    assert np.mean(out[:, 1] == values[:, 1]) < 0.1


@pytest.mark.thorough
def test_what_is_hidden_is_named_at_its_time_and_not_at_another(tmp_path: Path) -> None:
    manners = Manners(motions=("fourier",), firmnesses=("stiff",), rates=(250.0,), paces=(1.0,))
    case = draw_cases(Wanted(2, 0, ("joint_spring",), ("ur10",), ("full",), manners))[0]
    recordings = recorded(case, tmp_path).recordings(held_out=False)
    plain = identify(robot_from_library(case.arm), recordings)
    question = Question.of(plain, recordings)
    names = {name.split(" on ")[0] for name in question.named(lambda _, rows: rows)}
    assert names == {choice.effect for choice in diagnose(plain, recordings).recommended} == {"joint_spring"}
    assert "joint_spring" not in {
        name.split(" on ")[0] for seed in range(3) for name in named_at(question, Shifts(np.random.default_rng(seed)))
    }
