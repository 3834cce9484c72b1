"""The filters that are chosen from the data, and those that a user asks for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal
from support.recording_data import JOINTS, motion

from dynident.recordings import (
    Preprocessing,
    RecordingError,
    choose_preprocessing,
    preprocessing_from_request,
    recording_from_arrays,
)
from dynident.recordings.preprocessing import _Bands, _choose_cutoffs, find_motion_band
from dynident.recordings.signal_spectra import estimate_spectra


def recorded(speed: float = 1.0, noise: float = 0.0, n_rows: int = 9000, rate: float = 200.0, windows=()):
    columns = motion(n_rows, rate=rate / speed)
    rng = np.random.default_rng(0)
    q = np.stack([columns[f"q{joint}"] for joint in (1, 2, 3)], axis=1)
    tau = np.stack([columns[f"tau{joint}"] for joint in (1, 2, 3)], axis=1)
    noisy = q + noise * rng.normal(size=q.shape)
    return recording_from_arrays(np.arange(n_rows) / rate, noisy, tau, joint_names=JOINTS, windows=windows)


def test_a_faster_motion_gets_a_wider_filter():
    slow, fast = choose_preprocessing([recorded()]), choose_preprocessing([recorded(speed=4.0)])
    assert 2.5 < fast.position_cutoff / slow.position_cutoff < 5.0


def test_noise_of_the_encoder_narrows_the_filter_and_is_the_reason_given():
    clean, noisy = choose_preprocessing([recorded()]), choose_preprocessing([recorded(noise=1e-3)])
    assert noisy.position_cutoff < 0.7 * clean.position_cutoff
    assert "noise" in noisy.reasons[0]
    assert "noise" not in clean.reasons[0]


def test_the_acceleration_has_a_filter_of_its_own_where_its_noise_is_small():
    quiet, between, noisy = (choose_preprocessing([recorded(noise=noise)]) for noise in (0.0, 1e-5, 1e-3))
    assert quiet.find_acceleration_cutoff(200.0) == 3.0 * quiet.torque_cutoff
    assert between.position_cutoff > between.torque_cutoff
    assert noisy.position_cutoff == noisy.torque_cutoff
    assert between.find_acceleration_cutoff(200.0) is noisy.find_acceleration_cutoff(200.0) is None
    # Chosen cut-offs are rounded down, so that 1.4 times the torque's may come out as less.
    for cutoff in np.linspace(2.0, 20.0, 1000):
        chosen = _choose_cutoffs([_Bands(cutoff / 15.0, 1e3, 0.0, 1e3, 1.0)], 500.0)
        assert chosen.find_acceleration_cutoff(500.0) == 3.0 * chosen.torque_cutoff
    # No further than the sampling rate allows.
    assert Preprocessing(11.0, 7.8).find_acceleration_cutoff(40.0) == pytest.approx(14.0)
    assert Preprocessing(14.0, 10.0).find_acceleration_cutoff(40.0) is None


def test_the_noise_that_is_left_in_the_acceleration_is_a_few_percent():
    noise = 1e-3
    choice = choose_preprocessing([recorded(noise=noise)])
    frequency = np.linspace(0.0, 100.0, 20001)
    gain = (400.0 * np.sin(np.pi * frequency / 200.0)) ** 4 * np.square(
        np.abs(
            signal.sosfreqz(signal.butter(4, choice.position_cutoff, fs=200.0, output="sos"), frequency, fs=200.0)[1]
        )
        ** 2
    )
    left = np.sqrt(noise**2 / 100.0 * np.trapezoid(gain, frequency))
    columns = motion(9000)
    own = np.std(np.gradient(columns["dq_true"], 1 / 200.0, axis=0), axis=0)
    assert left < 0.15 * np.median(own)


def test_noise_of_the_pose_of_a_base_narrows_the_filter_of_all():
    rng, t = np.random.default_rng(0), np.arange(6000) / 200.0
    names = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll", *(f"joint{k}" for k in range(12)))
    q = np.stack([0.3 * np.sin(2 * np.pi * rng.uniform(0.3, 1.2) * t + k) for k in range(18)], axis=1)
    q[:, :6] *= 0.1

    def choose(noise_of_base: float) -> Preprocessing:
        noisy = q + rng.normal(size=q.shape) * np.where(np.arange(18) < 6, noise_of_base, 1e-5)
        return choose_preprocessing([recording_from_arrays(t, noisy, np.zeros_like(q), joint_names=names)])

    # Twelve encoders without noise do not outvote the six coordinates of the base.
    clean, noisy = choose(1e-6), choose(5e-4)
    assert noisy.position_cutoff < 0.4 * clean.position_cutoff
    assert "motion of the base" in noisy.reasons[0]
    assert "m or rad rms" in noisy.reasons[0]


def test_positions_are_filtered_as_the_noisier_of_base_and_joints_asks() -> None:
    rng, t = np.random.default_rng(0), np.arange(6000) / 200.0
    base = np.stack([0.03 * np.sin(2 * np.pi * (0.5 + 0.05 * k) * t) for k in range(6)], axis=1)
    base += 4e-4 * rng.normal(size=base.shape)
    # The joints are slow and have little noise: theirs is the lower torque cut-off and the higher one of positions.
    joints = np.stack([0.5 * np.sin(2 * np.pi * 0.12 * t + k) for k in range(4)], axis=1)
    joints += 1e-6 * rng.normal(size=joints.shape)
    names = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll", "a", "b", "c", "d")
    both = recording_from_arrays(t, np.hstack([base, joints]), np.zeros((6000, 10)), joint_names=names)
    parts = [
        choose_preprocessing([recording_from_arrays(t, q, np.zeros(q.shape), joint_names=own)])
        for q, own in ((base, names[:6]), (joints, names[6:]))
    ]
    choice = choose_preprocessing([both])
    assert parts[1].torque_cutoff < parts[0].torque_cutoff < parts[1].position_cutoff
    assert choice.torque_cutoff == parts[1].torque_cutoff
    assert choice.position_cutoff == parts[0].position_cutoff


def test_axes_that_somebody_called_like_a_base_are_joints() -> None:
    rng, t = np.random.default_rng(0), np.arange(6000) / 200.0
    q = np.stack([0.3 * np.sin(2 * np.pi * f * t) for f in (0.5, 0.7, 0.4)], axis=1) + 0.02 * rng.normal(size=(6000, 3))
    choices = [
        choose_preprocessing([recording_from_arrays(t, q, np.zeros(q.shape), joint_names=names)])
        for names in (("base_x", "base_y", "base_z"), ("x", "y", "z"), ("base_x", "base_y", "base_yaw"))
    ]
    assert choices[0] == choices[1]
    assert choices[0] != choices[2]


@pytest.mark.parametrize(
    ("sway", "frequency", "noise", "is_left_out"),
    [(0.0, 0.3, 1e-6, True), (0.0, 0.3, 1e-3, True), (0.02, 0.3, 1e-3, True), (0.2, 0.3, 0.01, False)],
)
def test_a_base_that_stands_or_hardly_sways_leaves_the_filter_to_the_joints(
    sway: float, frequency: float, noise: float, is_left_out: bool
) -> None:
    rng, t = np.random.default_rng(0), np.arange(15000) / 500.0
    names = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll", *(f"joint{k}" for k in range(6)))
    joints = 0.5 * np.sin(2 * np.pi * rng.uniform(0.5, 1.2, 6) * t[:, None] + np.arange(6))
    base = sway * np.sin(2 * np.pi * frequency * t)[:, None] * np.ones(6)

    def choose(noise_of_base: float, moved: np.ndarray) -> Preprocessing:
        q = np.hstack([moved + noise_of_base * rng.normal(size=base.shape), joints])
        q[:, 6:] += 1e-5 * rng.normal(size=joints.shape)
        return choose_preprocessing([recording_from_arrays(t, q, np.zeros_like(q), joint_names=names)])

    without, chosen = choose(0.0, np.zeros_like(base)), choose(noise, base)
    if is_left_out:
        assert (chosen.position_cutoff, chosen.decimation) == (without.position_cutoff, without.decimation)
    else:
        # Narrowed by the base's noise, but not below the band of the joints' motion, 1.2 Hz.
        assert 1.0 <= chosen.torque_cutoff < without.torque_cutoff
        assert "of the base" in chosen.reasons[0]


def test_rows_are_decimated_to_at_least_four_times_the_cutoff():
    choice = choose_preprocessing([recorded()])
    assert 4.0 <= 200.0 / choice.decimation / choice.torque_cutoff < 6.0
    assert all(reason.endswith(".") for reason in choice.reasons)


def test_the_noise_floor_of_the_spectrum_is_that_of_the_noise():
    found = estimate_spectra(recorded(noise=1e-3))
    np.testing.assert_allclose(np.sqrt(found.noise * 100.0), 1e-3, rtol=0.1)


def test_the_power_of_the_spectrum_is_that_of_the_signal():
    columns, found = motion(9000), estimate_spectra(recorded())
    step = found.frequency[1]
    np.testing.assert_allclose(found.velocity.sum(axis=0) * step, columns["dq_true"].var(axis=0), rtol=0.2)


def test_rows_outside_the_windows_do_not_count():
    recording = recorded()
    (rows,) = recording.source.rows(0, 9000, 9000)
    rows.q[6000:] += 0.01 * np.random.default_rng(0).normal(size=(3000, 3))
    inside = choose_preprocessing([recording.with_windows(((0.0, 29.9),))])
    assert inside.position_cutoff > 1.5 * choose_preprocessing([recording]).position_cutoff


def test_several_recordings_get_one_filter_that_suits_all():
    both = choose_preprocessing([recorded(), recorded(speed=3.0)])
    assert both.position_cutoff == choose_preprocessing([recorded(speed=3.0)]).position_cutoff


@pytest.mark.parametrize("request_", ["auto", None, {}, {"position_cutoff": "auto"}])
def test_what_is_left_open_is_chosen(request_):
    assert preprocessing_from_request(request_, [recorded()]) == choose_preprocessing([recorded()])


def test_any_subset_of_the_choices_may_be_given():
    recording = recorded()
    given = preprocessing_from_request({"position_cutoff": 4.0}, [recording])
    assert (given.position_cutoff, given.torque_cutoff, given.decimation) == (4.0, 4.0, 12)
    given = preprocessing_from_request({"torque_cutoff": 3.0, "decimation": 7, "filter_order": 6}, [recording])
    assert (given.torque_cutoff, given.decimation, given.filter_order) == (3.0, 7, 6)
    assert given.position_cutoff == choose_preprocessing([recording]).position_cutoff
    given = preprocessing_from_request({"position_cutoff": None, "torque_cutoff": None}, [recording])
    assert (given.position_cutoff, given.torque_cutoff, given.decimation) == (None, None, 1)


@pytest.mark.parametrize(
    ("request_", "field", "words"),
    [
        ({"position_cutoff": 150.0}, "/position_cutoff", "100 Hz"),
        ({"torque_cutoff": 100.0}, "/torque_cutoff", "Nyquist"),
        ({"position_cutoff": -1}, "/position_cutoff", "must be 0.0001 to"),
        ({"position_cutoff": float("nan")}, "/position_cutoff", "must be"),
        ({"torque_cutoff": "wide"}, "/torque_cutoff", "number"),
        ({"decimation": 0}, "/decimation", "must be 1 to"),
        ({"decimation": 2.5}, "/decimation", "whole"),
        ({"decimation": True}, "/decimation", "number"),
        ({"decimation": 20, "torque_cutoff": 8.0}, "/decimation", "at most 12"),
        ({"filter_order": 0}, "/filter_order", "1 to 12"),
        ({"cutoff": 3.0}, "/cutoff", "position_cutoff"),
        ("best", "", "auto"),
        ([4.0], "", "auto"),
    ],
)
def test_impossible_choices_are_refused_by_name(request_, field, words):
    with pytest.raises(RecordingError, match=words) as caught:
        preprocessing_from_request(request_, [recorded()])
    assert caught.value.pointer == f"/preprocessing{field}"


def test_a_recording_too_short_for_a_spectrum_says_so():
    with pytest.raises(ValueError, match="too few to choose the filters"):
        choose_preprocessing([recorded(n_rows=20)])


def test_a_recording_in_which_nothing_moves_says_so():
    still = np.zeros((500, 1))
    with pytest.raises(RecordingError, match="No joint moves"):
        choose_preprocessing([recording_from_arrays(np.arange(500) / 100.0, still, still, joint_names=("a",))])


def test_a_choice_is_impossible_on_its_own_too():
    with pytest.raises(RecordingError):
        Preprocessing(5.0, 5.0, decimation=0)


@pytest.mark.parametrize("noise", [1e-7, 2e-4])
@pytest.mark.parametrize("periods", [1, 2, 6, 40])
@pytest.mark.parametrize("base", [0.05, 0.1, 0.2, 0.25, 0.3, 0.5, 0.7, 1.0, 2.0])
def test_lines_of_any_base_frequency_are_the_motion(base: float, periods: int, noise: float) -> None:
    """A periodic motion has nothing between its lines, nor below the first: its band ends after the last."""
    if not 3.0 <= periods / base <= 130.0:
        pytest.skip("no motion that anybody records")
    rng = np.random.default_rng(3)
    t = np.arange(round(200.0 * periods / base)) / 200.0
    rates = 2 * np.pi * base * np.arange(1, 6)
    # The third line is missing in the first joint, the second and third in the last.
    sizes = np.array([[1, 1, 0, 1, 0.7], [0.6, 1, 1, 0.8, 1], [1, 0, 0, 1, 1.0]]) / rates
    phases = rng.uniform(0, 2 * np.pi, (3, 5))
    q = (0.3 * sizes[:, :, None] * np.sin(rates[:, None] * t + phases[:, :, None])).sum(axis=1).T
    q = q + noise * rng.normal(size=q.shape)
    run = recording_from_arrays(t, q, rng.normal(size=q.shape), joint_names=JOINTS)
    band = find_motion_band([run])
    resolution = 2.5 / min(20.0, periods / base)
    assert 4 * base - resolution < band < 5 * base + resolution
    assert choose_preprocessing([run]).torque_cutoff >= 3.8 * band  # rounded down


def test_a_hum_far_from_the_lines_is_not_the_motion() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(8000) / 200.0
    q = sum(0.2 / k * np.sin(2 * np.pi * 0.5 * k * t + k)[:, None] * np.ones(3) for k in range(1, 6))
    hum = 2e-3 * np.sin(2 * np.pi * 23.0 * t)[:, None]
    run = recording_from_arrays(
        t, q + hum + 1e-5 * rng.normal(size=q.shape), rng.normal(size=q.shape), joint_names=JOINTS
    )
    assert find_motion_band([run]) < 2.7
