"""Where a motion is repeated, the noise floor that follows from it, and what a comparison is then worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, NOISE, ROBOT, WITH_OFFSET, experiment, nothing, on_joint, recorded
from support.oracles import Motion, fourier_motion

from dynident.diagnosis import compare, diagnose, judge
from dynident.diagnosis.comparison.noise_floor import estimate_noise_floor, estimate_noise_from_repetitions
from dynident.diagnosis.comparison.repeated_motion import (
    compute_repeated_share,
    find_own_repeats,
    find_periods,
    load_tracks,
    split_tracks,
)
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import low_pass, recording_from_arrays

IN_BAND = NOISE * np.sqrt(np.sum(low_pass(200.0, BAND.torque_cutoff) ** 2))


@pytest.fixture(scope="module")
def run():
    return experiment()


def piece(motion: Motion, first: int, last: int) -> Motion:
    return Motion(motion.t[first:last], motion.q[first:last], motion.dq[first:last], motion.ddq[first:last])


def own(motion: Motion, segment=None):
    t = np.asarray(motion.t)
    return find_own_repeats(split_tracks(t, np.zeros(len(t)) if segment is None else segment, motion.q))


def test_the_period_of_a_motion_is_found_between_two_samples():
    motion = fourier_motion(ROBOT, 31.0, 25.0, 5, base_frequency=1 / 9.87)
    (repeat,) = own(motion)
    assert repeat.lag == pytest.approx(9.87, abs=1e-3)
    assert repeat.duration == pytest.approx(31.0 - 9.87, abs=0.2)


def test_periods_are_found_between_the_ways_from_and_to_rest():
    motion = fourier_motion(ROBOT, 20.0, 25.0, 5)
    away = np.sin(np.linspace(0, np.pi / 2, 75))[:, None]
    q = np.concatenate([away * motion.q[0], motion.q, away[::-1] * motion.q[-1]])
    (repeat,) = find_own_repeats(split_tracks(np.arange(len(q)) / 25.0, np.zeros(len(q)), q))
    assert repeat.lag == pytest.approx(10.0, abs=0.01)
    assert repeat.start == pytest.approx(3.0, abs=0.3)


def test_a_motion_that_never_comes_back_has_no_period():
    assert own(fourier_motion(ROBOT, 15.0, 25.0, 5)) == ()
    assert own(fourier_motion(ROBOT, 40.0, 25.0, 5, base_frequency=0.02, harmonics=30)) == ()


def test_one_period_in_each_of_several_segments_is_a_repetition():
    once = fourier_motion(ROBOT, 10.0, 25.0, 5)
    q = np.tile(once.q, (3, 1))
    segment = np.repeat([0.0, 1.0, 2.0], len(once.t))
    t = np.arange(len(q)) / 25.0 + 40.0 * segment
    found = find_own_repeats(split_tracks(t, segment, q))
    assert [(repeat.a, repeat.b) for repeat in found] == [(0, 1), (1, 2)]
    assert all(repeat.duration > 9.0 for repeat in found)


def test_the_noise_floor_of_a_periodic_run_is_the_noise_itself_whatever_the_model_lacks():
    spring = on_joint(2, lambda q, v, load: 12.0 * np.sin(3 * q))
    lacking = experiment(spring)
    found = estimate_noise_floor(compare(lacking.identification, lacking.training), lacking.training, BAND)
    assert found.source == "repeated_periods"
    assert found.period == pytest.approx(10.0, abs=0.01)
    assert found.repetitions == pytest.approx(4.0, abs=0.2)
    np.testing.assert_allclose(found.values, IN_BAND, rtol=0.15)
    assert found.lack_of_fit is not None
    assert found.lack_of_fit.f[2] > 3
    assert found.lack_of_fit.p_value[2] < 1e-6


def test_a_model_that_lacks_nothing_passes_the_lack_of_fit_test(run):
    found = estimate_noise_from_repetitions(compare(run.identification, run.training))
    assert found is not None
    assert (found.lack_of_fit.p_value > 0.001).all()
    assert (found.lack_of_fit.f < 1.4).all()


def test_slow_disturbances_are_in_the_floor_of_repeated_periods_only(run):
    motion = fourier_motion(ROBOT, 20.0, 200.0, 12)
    drifting = recorded(
        motion, lambda m, load: 6.0 * np.sin(2 * np.pi * m.t / 13.0)[:, None] * np.eye(6)[1], 4, "drift"
    )
    comparison = compare(run.identification, drifting)
    periods = estimate_noise_floor(comparison, drifting, BAND)
    assert periods.values[1] > 2.5 * IN_BAND[1]
    once = recorded(piece(motion, 0, 2000), nothing, 4, "once")
    other = estimate_noise_floor(compare(run.identification, once), once, BAND)
    assert (other.source, other.period, other.lack_of_fit) == ("high_frequency", 0.0, None)
    np.testing.assert_allclose(other.values, IN_BAND, rtol=0.1)


def test_a_held_out_run_of_the_same_motion_is_told_from_one_of_another(run):
    same = recorded(fourier_motion(ROBOT, 20.0, 200.0, 100), nothing, 8, "again")
    comparison = compare(run.identification, same)
    found = judge(comparison, same, BAND, [run.training])
    assert found.repeated is not None
    assert found.repeated.name == "training"
    assert found.repeated.share > 0.95
    assert "tests noise, not generalisation" in found.notes[0]
    other = judge(compare(run.identification, run.validation), run.validation, BAND, [run.training])
    assert other.repeated is None
    assert not any("generalisation" in note for note in other.notes)


def test_the_same_motion_with_another_payload_is_no_mere_repetition(run):
    same = recorded(fourier_motion(ROBOT, 20.0, 200.0, 100), nothing, 8, "again")
    loaded = replace(same, payload={"mass": 2.0})
    assert judge(compare(run.identification, loaded), loaded, BAND, [run.training]).repeated is None


def test_the_same_path_at_another_speed_is_another_motion():
    slow, fast = (fourier_motion(ROBOT, 20.0, 50.0, 5, base_frequency=f, fastest=9.0) for f in (0.1, 0.12))
    first, second = (split_tracks(m.t, np.zeros(len(m.t)), m.q) for m in (slow, fast))
    assert compute_repeated_share(second, first) < 0.2
    assert compute_repeated_share(first, first) == 1.0


def test_tracks_of_a_recording_lie_in_its_windows(run):
    inside = run.training.with_windows(((2.0, 8.0), (20.0, 31.0)))
    found = load_tracks(inside)
    assert [(round(track.t[0]), round(track.t[-1])) for track in found] == [(2, 8), (20, 31)]
    expected = fourier_motion(ROBOT, 40.0, 200.0, 100)
    for track in found:
        np.testing.assert_allclose(track.q[:, 0], np.interp(track.t, expected.t, expected.q[:, 0]), atol=1e-6)


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_driving_the_same_again_is_no_evidence_for_a_name(seed):
    """What no effect of the catalogue says comes again in every period: whatever resembles it there gains each time."""

    def law(motion: Motion, load):
        tau = np.zeros_like(load)
        tau[:, 1] = 14.0 * np.sin(1.5 * motion.q[:, 4]) * np.cos(2.0 * motion.q[:, 3])
        return tau

    run = recorded(fourier_motion(ROBOT, 32.5, 200.0, seed, base_frequency=1 / 6.5), law, seed, "five periods")
    lacking = identify(ROBOT, [run], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    found = diagnose(lacking, [run])
    assert found.recommended == ()
    assert (found.unknown[0].joint, found.unknown[0].variable) == (NAMES[1], "other_joints")


def test_periods_of_one_segment_are_none_of_another_that_has_the_same_times():
    again = fourier_motion(ROBOT, 20.0, 200.0, 5)
    once = fourier_motion(ROBOT, 20.0, 200.0, 6, base_frequency=0.05, harmonics=10)
    t, q = (np.concatenate([getattr(motion, name) for motion in (once, again)]) for name in ("t", "q"))
    segment = np.repeat([0, 1], len(once.t))
    both = recording_from_arrays(t, q, np.zeros_like(q), joint_names=NAMES, segment=segment)
    first, second = find_periods(both)
    assert first == ()
    assert [(repeat.a, repeat.b) for repeat in second] == [(0, 0)]
    assert second[0].lag == pytest.approx(10.0, abs=0.01)
    # A diagnosis asks for them some twenty times.
    assert find_periods(both) is find_periods(both)


def test_a_clean_comparison_is_at_the_noise_floor_and_a_lacking_one_above_it(run):
    clean = judge(compare(run.identification, run.validation), run.validation, BAND)
    assert (clean.over_noise < 1.3).all()
    lacking = experiment(on_joint(2, lambda q, v, load: 12.0 * np.sin(3 * q)))
    found = judge(compare(lacking.identification, lacking.validation), lacking.validation, BAND)
    assert found.over_noise[2] > 2
    assert any(NAMES[2] in note and "lacks an effect" in note for note in found.notes)
    # What a missing effect leaves is remembered longer than filtered noise.
    assert found.effective_samples[2] < 0.5 * clean.effective_samples[2]
