"""`dynident.follow`: estimates while a recording is made; a payload and friction that change in it."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import dynident as dy
from dynident.api.model import NO_RECORDINGS, Model
from dynident.identification import identify
from dynident.recordings import Recording
from dynident.simulation import TrueEffect
from dynident.testing.trial_arm import record_trial

LOAD = {"Mp": 2.0, "MXp": 0.3, "MYp": -0.1, "MZp": 0.2, "XXp": 0.05, "YYp": 0.06, "ZZp": 0.05}
DRIVES = tuple(
    TrueEffect(effect, f"joint{j}", ((name, value),))
    for j in (1, 2, 3)
    for effect, name, value in (("coulomb", "Fc", 2.0), ("viscous", "Fv", 1.5))
)
STICKY = tuple(TrueEffect("coulomb", f"joint{j}", (("Fc", 4.0 if j == 2 else 2.0),)) for j in (1, 2, 3)) + tuple(
    TrueEffect("viscous", f"joint{j}", (("Fv", 1.5),)) for j in (1, 2, 3)
)

EMPTY = record_trial(DRIVES, noise=0.1, runs=2)
LOADED = record_trial((*DRIVES, TrueEffect("payload", "joint3", tuple(LOAD.items()))), noise=0.1, runs=2)
STUCK = record_trial(STICKY, noise=0.1, runs=2)
ROBOT = EMPTY.robot


def rows_of(recording: Recording) -> dict[str, np.ndarray]:
    (rows,) = recording.source.rows(0, recording.n_samples, recording.n_samples)
    return {"q": rows.q, "tau": rows.tau}


def splice(*recordings: Recording, gap: float = 0.0) -> dict[str, np.ndarray]:
    """One recording behind the other; all motions begin and end at rest in the same posture."""
    parts = [rows_of(recording) for recording in recordings]
    period = recordings[0].period
    lengths = [len(part["q"]) for part in parts]
    t = np.concatenate([np.arange(n) * period + k * (n * period + gap) for k, n in enumerate(lengths)])
    return {"t": t} | {name: np.concatenate([part[name] for part in parts]) for name in ("q", "tau")}


def in_blocks(rows: dict[str, np.ndarray], size: int = 50) -> list[dict[str, np.ndarray]]:
    return [{name: values[k : k + size] for name, values in rows.items()} for k in range(0, len(rows["t"]), size)]


@pytest.fixture(scope="module")
def model() -> Model:
    """A model of the arm without a load, from a motion of its own."""
    return Model(identify(ROBOT, [EMPTY.recordings[1]]), NO_RECORDINGS, NO_RECORDINGS)


def test_a_payload_that_is_picked_up_is_tracked(model: Model) -> None:
    rows = splice(EMPTY.recordings[0], LOADED.recordings[0])
    switch = len(rows["t"]) // 2 * EMPTY.recordings[0].period
    estimates = list(dy.follow(ROBOT, in_blocks(rows), model=model, memory=3.0))
    before = [e for e in estimates if 5.0 < e.time < switch - 1.0]
    behind = [e for e in estimates if e.time > switch + 10.0]
    assert before
    assert behind
    for estimate in before:
        assert estimate["MXp"] == pytest.approx(0.0, abs=0.05)
    for estimate in behind:
        assert estimate["MXp"] == pytest.approx(LOAD["MXp"], abs=0.05)
        assert estimate["MYp"] == pytest.approx(LOAD["MYp"], abs=0.05)
    assert all(np.all(e.error < 0.1) for e in (before[-1], behind[-1]))
    # Nothing of the first half is left, as a fit of the second half alone shows.
    assert behind[-1].standard_deviations is not None
    last = behind[-1]
    deviations = dict(zip([c.parameter for c in last.columns], last.standard_deviations, strict=True))
    assert abs(last["MXp"] - LOAD["MXp"]) < 6 * deviations["MXp"] + 0.02


def test_friction_that_rises_is_tracked_and_all_else_is_held(model: Model) -> None:
    rows = splice(EMPTY.recordings[0], STUCK.recordings[0])
    *_, last = dy.follow(ROBOT, in_blocks(rows), model=model, track=["coulomb"], memory=3.0)
    assert [column.effect for column in last.columns] == ["coulomb"] * 3
    values = dict(zip([column.link for column in last.columns], last.values, strict=True))
    assert values == pytest.approx({"joint1": 2.0, "joint2": 4.0, "joint3": 2.0}, abs=0.15)
    with pytest.raises(KeyError, match="the parameters are"):
        last["Fv9"]


def test_the_last_estimate_of_a_robot_is_the_model_of_the_whole_recording() -> None:
    rows = splice(EMPTY.recordings[0], gap=0.0)
    estimates = list(dy.follow(ROBOT, in_blocks(rows, 73), every=2.0))
    seconds = [e.seconds for e in estimates]
    assert all(b - a >= 0.0 for a, b in pairwise(seconds))
    batch = identify(ROBOT, [EMPTY.recordings[0]]).values
    last = estimates[-1]
    assert last.identification is not None
    np.testing.assert_allclose(last.estimate.values, batch, rtol=0, atol=1e-6 * np.abs(batch).max())
    assert all(e.identification is None for e in estimates[:-1])


def test_where_time_is_missing_a_new_run_begins() -> None:
    rows = splice(*EMPTY.recordings, gap=20.0)
    *_, last = dy.follow(ROBOT, in_blocks(rows, 70))
    assert last.identification is not None
    batch = identify(ROBOT, EMPTY.recordings).values
    np.testing.assert_allclose(last.estimate.values, batch, rtol=0, atol=0.05 * np.abs(batch).max())


def test_with_a_memory_old_rows_are_forgotten() -> None:
    rows = splice(EMPTY.recordings[0], STUCK.recordings[0])
    whole = list(dy.follow(ROBOT, in_blocks(rows)))[-1]
    recent = list(dy.follow(ROBOT, in_blocks(rows), memory=3.0))[-1]
    assert recent.identification is None
    values = [
        {p.link: p.value for p in estimate.estimate.parameters if p.effect == "coulomb"}["joint2"]
        for estimate in (whole, recent)
    ]
    assert values[0] == pytest.approx(3.0, abs=0.5)
    assert values[1] == pytest.approx(4.0, abs=0.2)


ROWS = {"t": np.arange(20) * 0.01, "q": np.zeros((20, 3)), "tau": np.zeros((20, 3))}


@pytest.mark.parametrize(
    "block",
    [
        {},
        {"t": ROWS["t"], "q": ROWS["q"]},
        {**ROWS, "speed": ROWS["q"]},
        {**ROWS, "q": np.zeros((20, 2))},
        {**ROWS, "t": np.zeros((20, 1))},
        {**ROWS, "t": ROWS["t"][::-1]},
        {**ROWS, "tau": np.full((20, 3), np.nan)},
        {**ROWS, "q": "abc"},
        {name: values[:3] for name, values in ROWS.items()},
    ],
)
def test_what_is_no_block_is_refused(block: dict[str, Any]) -> None:
    with pytest.raises(dy.DynidentError):
        list(dy.follow(ROBOT, [block]))


@pytest.mark.parametrize(
    "change",
    [
        lambda rows: {**rows, "temperature": np.full_like(rows["q"], 30.0)},
        lambda rows: {name: values[::2] for name, values in rows.items()},
        lambda rows: {**rows, "t": rows["t"][0] + 0.5 * (rows["t"] - rows["t"][0])},
    ],
    ids=["other signals", "slower", "faster"],
)
@pytest.mark.parametrize("size", [1, 50])
def test_a_later_block_of_another_kind_is_refused(change: Any, size: int) -> None:
    rows = splice(EMPTY.recordings[0])
    first, later = ({name: values[part] for name, values in rows.items()} for part in (slice(200), slice(200, 400)))
    blocks = [*in_blocks(first), *in_blocks(change(later), size)]
    assert list(dy.follow(ROBOT, in_blocks(first)))
    with pytest.raises(dy.DynidentError, match="this is not a block"):
        list(dy.follow(ROBOT, blocks))


def test_temperatures_have_to_be_numbers() -> None:
    with pytest.raises(dy.DynidentError, match="not a finite number"):
        list(dy.follow(ROBOT, [{**ROWS, "temperature": np.full((20, 3), np.nan)}]))


def test_rows_of_a_shaky_clock_are_followed() -> None:
    rows = splice(*EMPTY.recordings, gap=20.0)
    shaky = {**rows, "t": rows["t"] + 1e-3 * np.random.default_rng(0).uniform(-1, 1, len(rows["t"]))}
    assert list(dy.follow(ROBOT, in_blocks(shaky, 11), every=20.0))[-1].identification is not None


@pytest.mark.parametrize("options", [{"every": 0.0}, {"memory": -1.0}, {"track": ["teeth"]}, {"track": []}])
def test_impossible_options_are_refused(model: Model, options: dict[str, Any]) -> None:
    with pytest.raises(dy.DynidentError):
        list(dy.follow(ROBOT, [], model=model, **options))


def test_a_robot_that_has_not_moved_yet_gives_a_reason() -> None:
    (live, *_) = dy.follow(ROBOT, [ROWS], every=0.1, memory=1.0)
    assert live.estimate is None
    assert live.reason
