"""When a joint moves, turns round or stands: against motions of which it is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter1d

from dynident.recordings import Preprocessing, Recording, filtered_blocks, recording_from_arrays
from dynident.recordings.filter_overshoots import find_filtered_phases, find_largest_near
from dynident.recordings.joint_phases import STANDS, Phase, compute_smear_width, find_phases

QUANTUM = 2 * np.pi / 2**18


def recorded(q: np.ndarray, rate: float, quantum: float = QUANTUM) -> Recording:
    rounded = np.round(q / quantum) * quantum
    tau = np.zeros_like(q)
    names = tuple(f"joint{k + 1}" for k in range(q.shape[1]))
    return recording_from_arrays(np.arange(len(q)) / rate, rounded, tau, joint_names=names, name="motion")


def swinging(rate: float, seconds: float = 10.0, dwell: float = 0.0) -> np.ndarray:
    """One joint to and fro by 0.5 rad every 2 s, resting for a while wherever it turns."""
    fine = np.arange(0.0, seconds, 1.0 / rate)
    period = 2.0 + 2 * dwell
    phase = fine % period
    moving = 1.0
    where = np.select(
        [phase < moving, phase < moving + dwell, phase < 2 * moving + dwell],
        [phase / moving, 1.0, 1.0 - (phase - moving - dwell) / moving],
        0.0,
    )
    return 0.5 * -np.cos(np.pi * where)[:, None]


@pytest.mark.parametrize("rate", [60.0, 125.0, 500.0, 1000.0])
def test_a_joint_that_turns_round_in_one_sweep_is_said_to_turn_and_one_that_rests_to_stand(rate):
    free, resting = recorded(swinging(rate), rate), recorded(swinging(rate, dwell=0.3), rate)
    inside = slice(1, -1)  # at either end of a recording nobody knows what came before
    assert not find_phases(free).halts[0][0].sticks[inside].any()
    assert len(find_phases(free).halts[0][0].starts) >= 9
    assert find_phases(resting).halts[0][0].sticks.all()


@pytest.mark.parametrize("rate", [125.0, 500.0])
def test_rows_stand_as_long_as_the_joint_does_and_a_filter_width_to_either_side(rate):
    made = recorded(swinging(rate, dwell=0.3), rate)
    t = np.arange(0.6, 1.8, 1e-3)
    phase = find_phases(made).phases_at(0, t, 0.1)[:, 0]
    standing = t[phase == Phase.STANDING]
    # It comes to rest at 1 s and leaves at 1.3 s; near either it is slow already.
    assert standing[0] == pytest.approx(0.9, abs=0.04)
    assert standing[-1] == pytest.approx(1.4, abs=0.04)
    assert (phase[t < 0.8] == Phase.MOVING).all()


def test_a_joint_that_never_moves_stands_throughout_whatever_its_noise():
    rng = np.random.default_rng(0)
    q = np.hstack([swinging(200.0), 0.3 * STANDS * rng.uniform(-1, 1, (2000, 1))])
    phase = find_phases(recorded(q, 200.0)).phases_at(0, np.arange(0, 10, 0.1), 0.05)
    assert (phase[:, 1] == Phase.STANDING).all()
    assert (phase[:, 0] == Phase.MOVING).mean() > 0.5


def test_a_slow_test_of_friction_moves_although_it_is_slower_than_other_joints_creep():
    t = np.arange(0, 20, 0.005)
    q = (0.008 * t)[:, None]
    phase = find_phases(recorded(q, 200.0)).phases_at(0, np.arange(1, 19, 0.1), 0.05)
    assert (phase == Phase.MOVING).all()


def test_a_stop_on_the_way_is_no_turn():
    """Where a joint rests and goes on in the same direction, friction has no sign while it rests."""
    t = np.arange(0, 4, 0.002)
    speed = np.where((t > 1.8) & (t < 2.2), 0.0, 0.4)
    q = np.cumsum(speed * 0.002)[:, None]
    halts = find_phases(recorded(q, 500.0)).halts[0][0]
    assert len(halts.starts) == 1
    assert halts.sticks.all()


@settings(max_examples=30, deadline=None)
@given(
    st.floats(0.3, 2.0),
    st.floats(0.05, 1.5),
    st.sampled_from([100.0, 250.0, 1000.0]),
    st.sampled_from([2**16, 2**19]),
)
def test_free_turns_are_never_taken_for_sticking(frequency, amplitude, rate, counts):
    t = np.arange(0, 12, 1 / rate)
    q = amplitude * np.sin(2 * np.pi * frequency * t)[:, None]
    halts = find_phases(recorded(q, rate, 2 * np.pi / counts)).halts[0][0]
    assert halts.sticks[1:-1].mean() <= 0.1


def test_the_width_of_a_halt_is_that_of_the_lower_filter():
    assert compute_smear_width(Preprocessing(10.0, 5.0), 1000.0) == pytest.approx(0.2005)
    assert compute_smear_width(Preprocessing(None, None), 100.0) == pytest.approx(0.015)


@pytest.mark.parametrize("cutoff", [10.0, 40.0])
def test_a_joint_reverses_where_only_the_filter_makes_it(cutoff):
    rate = 1000.0
    t = np.arange(0.0, 6.0, 1.0 / rate)
    # It brakes within 50 ms to a creep, and goes on. It never reverses, but a filter of high order overshoots.
    speed = np.interp(t, [0.0, 2.0, 2.05, 4.0, 4.05, 6.0], [10.0, 10.0, 0.03, 0.03, 10.0, 10.0])
    q = (np.cumsum(speed) / rate)[:, None]
    made = recording_from_arrays(t, q, np.zeros_like(q), joint_names=("joint1",), name="creep")
    filters = Preprocessing(cutoff, cutoff, filter_order=10)
    wrong = np.concatenate([block.t[block.dq[:, 0] < 0] for block in filtered_blocks(made, filters)])
    assert len(wrong) > 5
    assert len(find_phases(made).halts[0][0].starts) == 0
    phases = find_filtered_phases(made, filters)
    width = compute_smear_width(filters, rate)
    assert (phases.phases_at(0, wrong, width) == Phase.REVERSING).all()
    assert (phases.phases_at(0, np.array([1.0, 3.0, 5.0]), width) == Phase.MOVING).all()
    # Without a filter nothing overshoots.
    assert len(find_filtered_phases(made, Preprocessing(None, cutoff)).halts[0][0].starts) == 0


@pytest.mark.parametrize("rate", [100.0, 1000.0])
@pytest.mark.parametrize("make", ["coarse encoder", "noise", "ripple"])
def test_a_slow_joint_whose_filtered_speed_wavers_still_moves(rate, make):
    t = np.arange(0.0, 30.0, 1.0 / rate)
    q = 0.01 * t
    if make == "coarse encoder":
        q = np.round(q / (2 * np.pi / 4096)) * (2 * np.pi / 4096)
    elif make == "noise":
        q = q + 4e-4 * np.random.default_rng(1).normal(size=len(t))
    else:
        q = q + 3e-4 * np.sin(2 * np.pi * 8.0 * t)
    made = recording_from_arrays(t, q[:, None], np.zeros((len(t), 1)), joint_names=("joint1",), name=make)
    filters = Preprocessing(20.0, 20.0)
    assert any((block.dq < 0).any() for block in filtered_blocks(made, filters))
    width = compute_smear_width(filters, rate)
    before, after = (found.phases_at(0, t, width) for found in (find_phases(made), find_filtered_phases(made, filters)))
    assert (before == after).mean() > 0.99


def test_what_hardly_creeps_in_one_run_stands_there_and_is_no_slow_joint():
    rate = 400.0
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 8.0, 1.0 / rate)
    sweep = 0.8 * np.sin(2 * np.pi * 0.3 * t)
    # Some 0.4 mrad/s: an encoder that counts four times a second says nothing of the direction.
    creep = 0.8 + 3e-3 * t / t[-1]
    q = np.concatenate([sweep, creep])[:, None] + 0.2 * QUANTUM * rng.normal(size=(2 * len(t), 1))
    time = np.concatenate([t, t + 60.0])
    made = recording_from_arrays(
        time, np.round(q / QUANTUM) * QUANTUM, np.zeros_like(q), joint_names=("joint1",), name="two runs"
    )
    assert len(made.segments) == 2
    inside = np.arange(0.5, 7.5, 0.01)
    moving, creeping = (find_phases(made).phases_at(k, made.segments[k].start_time + inside, 0.0)[:, 0] for k in (0, 1))
    assert (moving == Phase.STANDING).mean() < 0.1
    assert (creeping == Phase.STANDING).all()


@pytest.mark.parametrize(("m", "reach"), [(2, 3), (50, 0), (50, 1), (100, 7), (100, 64)])
def test_the_largest_speed_near_each_row_is_that_of_all_rows_within_reach(m: int, reach: int) -> None:
    speed = np.random.default_rng(m + reach).normal(size=(m, 2))
    expected = maximum_filter1d(speed, 2 * reach + 1, axis=0, mode="nearest")
    np.testing.assert_array_equal(find_largest_near(speed, reach), expected)
