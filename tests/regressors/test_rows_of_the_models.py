"""The filtered, energy and power models on torque that Pinocchio made, and their rows against dense computations."""

from __future__ import annotations

import tracemalloc

import casadi as ca
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import integrate, signal
from support.oracles import arm, crooked_urdf, fourier_motion, pinocchio_torque, random_states

from dynident import parallel
from dynident.effects import (
    CATALOGUE,
    EffectChoice,
    ReferenceParameters,
    Signals,
    build_columns,
    count_reference_parameters,
)
from dynident.estimation import Reduction, solve_ordinary
from dynident.recordings import Preprocessing, Recording, Segment, filtered_blocks, low_pass, recording_from_arrays
from dynident.recordings.low_pass_decimation import Samples
from dynident.recordings.recording import StoredRows
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.equation_forms import build_filtered_form, build_power_form
from dynident.regressors.filtered_energy_power_rows import (
    filter_with_pole,
    integrate_over_intervals,
    reduce_form,
    smooth_samples,
    stream_equations,
    take_differences,
)
from dynident.regressors.model_structure import Model, build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import robot_from_urdf

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
SLOW = Preprocessing(position_cutoff=None, torque_cutoff=5.0, decimation=20)
# What is left of noise-free data is (ωT)⁴ / 30 of the differences, times the condition number of W.
LIMITS = {"dynamic": 1e-8, "filtered": 1e-7, "energy": 1e-5, "power": 1e-5}


def truth_of(model: Model, seed: int = 0) -> np.ndarray:
    """Base parameters of the description's links with random Ia, Fc, Fv and b."""
    drawn = np.random.default_rng(seed).uniform(0.5, 5.0, 4 * model.robot.n)
    return model.base.grouping @ np.concatenate([model.robot.inertias.ravel(), drawn])


def noise_free(robot, seconds=60.0, rate=1000.0, seed=3, frequency=0.05, offset=0.0, **more) -> Recording:
    motion = fourier_motion(robot, seconds, rate, seed, base_frequency=frequency, amplitude=2.5)
    ia, fc, fv, b = np.random.default_rng(0).uniform(0.5, 5.0, (4, robot.n))
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + ia * motion.ddq + fc * np.sign(motion.dq)
    tau += fv * motion.dq + b + offset
    return recording_from_arrays(motion.t, motion.q, tau, joint_names=robot.joint_names, name="run", **more)


def reductions(model: Model, *runs: Recording, preprocessing=SLOW) -> dict[str, Reduction]:
    """The equations of every model on recordings."""
    known, reference = (model.robot, model.kept, model.signals), ReferenceParameters.massless(model.robot)
    power = build_power_form(*known)
    inputs = RegressorInputs(runs, preprocessing, reference)
    return {
        "dynamic": reduce_recordings(model.observation, inputs),
        "filtered": reduce_form(build_filtered_form(*known), filter_with_pole(20.0), inputs),
        "energy": reduce_form(power, integrate_over_intervals(0.5), inputs),
        "power": reduce_form(power, stream_equations, inputs),
    }


def error(reduction: Reduction, truth: np.ndarray) -> float:
    """||D (χ - truth)|| / ||D truth|| with D the norms of W's columns: by what each parameter does to the equations."""
    found = solve_ordinary(reduction)
    return float(np.linalg.norm(found.scales * (found.values - truth)) / np.linalg.norm(found.scales * truth))


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["ur10", "scara", "crooked"])
def test_every_model_finds_the_true_base_parameters_of_noise_free_torque(name):
    model = build_model(arm(name), EFFECTS)
    for which, reduction in reductions(model, noise_free(model.robot)).items():
        assert error(reduction, truth_of(model)) < LIMITS[which], which


@pytest.mark.slow
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 10_000),
    shape=st.sampled_from([(), (-1, 0, 1, 1), (-1, 0, 0, 2, 2), (-1, -1, 0, 1)]),
    sliding=st.sets(st.integers(0, 4), max_size=2),
)
def test_every_model_finds_the_true_base_parameters_of_arms_of_any_shape(seed, shape, sliding):
    n = len(shape) or 4
    robot = robot_from_urdf("drawn", crooked_urdf(n, seed, tuple(k for k in sliding if k < n), shape))
    model = build_model(robot, EFFECTS)
    # Three motions: one alone may leave a single equation, power or energy, next to singular.
    runs = [noise_free(robot, seconds=50.0, seed=seed + k, frequency=0.03 + 0.01 * k) for k in range(3)]
    for which, reduction in reductions(model, *runs).items():
        assert error(reduction, truth_of(model)) < LIMITS[which], which


@pytest.mark.parametrize("name", ["ur10", "franka_panda", "crooked", "dual_arm"])
def test_the_parts_of_the_filtered_model_add_up_to_the_dynamic_model(name):
    robot = arm(name)
    signals = Signals(robot)
    columns = build_columns([EffectChoice(one) for one in CATALOGUE if CATALOGUE[one].applicable(robot)], signals)
    columns = [column for column in columns if column.energy is not None]
    s = signals
    reference = np.random.default_rng(1).normal(size=count_reference_parameters(robot))
    for column in columns[::7]:
        # d/dt ∂e/∂q̇ + ∂u/∂q - ∂e/∂q by differentiation of the form's own rows.
        h = column.energy()
        momentum = ca.gradient(h, s.dq)
        u = ca.substitute(h, s.dq, ca.SX.zeros(robot.n))
        whole = ca.jtimes(momentum, s.q, s.dq) + ca.jtimes(momentum, s.dq, s.ddq) + ca.gradient(2 * u - h, s.q)
        present = ca.vertcat(*(s.in_runs(run) for run in s.find_run_signals(ca.vertcat(h, ca.densify(column.torque)))))
        gap = ca.Function("gap", [s.q, s.dq, s.ddq, s.reference, present], [whole - column.torque, whole])
        for state in zip(*random_states(robot, 3, 4), strict=True):
            off, size = (np.abs(np.array(value)).max() for value in gap(*state, reference, np.ones(present.shape)))
            assert off < 1e-9 * max(1.0, size), column.name


def test_filtered_rows_are_those_of_a_dense_computation():
    robot = arm("scara")
    model = build_model(robot, EFFECTS)
    run = noise_free(robot, seconds=12.0, rate=200.0, frequency=0.3)
    preprocessing = Preprocessing(10.0, 8.0, 4)
    form = build_filtered_form(robot, model.kept, model.signals)
    found = reduce_form(
        form, filter_with_pole(30.0), RegressorInputs([run], preprocessing, ReferenceParameters.massless(robot))
    )

    blocks = list(filtered_blocks(run, preprocessing))
    q, dq, tau, used = (np.concatenate([getattr(b, what) for b in blocks]) for what in ("q", "dq", "tau", "used"))
    evaluated = form.observation.evaluate(
        q,
        dq,
        np.zeros_like(q),
        reference=ReferenceParameters.massless(robot),
        memory=np.zeros((len(q), 0)),
    )
    dense = np.zeros((len(q), 2 * robot.n, model.n_parameters))
    dense[:, form.observation.entry_rows, form.observation.entry_columns] = evaluated
    momentum, force = dense[:, : robot.n], dense[:, robot.n :]
    rate = np.zeros_like(momentum)
    stencil = ((1, -2), (-8, -1), (8, 1), (-1, 2))
    rate[2:-2] = sum(w * momentum[2 + k : len(q) - 2 + k] for w, k in stencil) * 200.0 / 12.0
    whole = np.concatenate([rate + force, tau[:, :, None]], axis=2)
    first, last = np.flatnonzero(used)[[0, -1]] + [2, -2]
    whole[:first] = whole[last + 1 :] = 0.0
    b, a = signal.bilinear([900.0], [1.0, 60.0, 900.0], 200.0)
    behind = signal.lfilter(b, a, whole, axis=0)[first : last + 1]
    taps = low_pass(200.0, 8.0)
    settling = int(np.ceil(9.2 / 30.0 * 200.0))
    slow = np.apply_along_axis(np.convolve, 0, behind[settling:], taps, "valid")
    count = found.equations[0].counts.sum()
    # Which phase decimation takes is the stream's own: one of the four has all of its rows.
    fits = []
    for phase in range(4):
        rows = slow[phase::4][:count]
        gram = np.einsum("mij,mik->jk", rows, rows)
        mine = np.zeros_like(gram)
        for equation in found.equations:
            index = np.append(equation.columns, model.n_parameters)
            mine[np.ix_(index, index)] += equation.whole_factor.T @ equation.whole_factor
        fits.append(np.abs(mine - gram).max() / np.abs(gram).max())
    assert min(fits) < 1e-9


def test_the_energy_of_an_interval_is_the_work_done_in_it():
    robot = arm("scara")
    model = build_model(robot, EFFECTS)
    run = noise_free(robot, seconds=10.0, rate=500.0, frequency=0.2)
    preprocessing = Preprocessing(None, None, 10)
    form = build_power_form(robot, model.kept, model.signals)
    found = reduce_form(
        form, integrate_over_intervals(1.0), RegressorInputs([run], preprocessing, ReferenceParameters.massless(robot))
    )
    blocks = list(filtered_blocks(run, preprocessing))
    dq, tau = (np.concatenate([getattr(b, what) for b in blocks]) for what in ("dq", "tau"))
    work = integrate.cumulative_simpson((tau * dq).sum(axis=1), dx=1 / 500.0, initial=0.0)
    # Simpson's rule over 1 s at every phase; the reduction takes intervals every 1/8 s.
    wanted = np.mean((work[500:] - work[:-500]) ** 2)
    equation = found.equations[0]
    assert np.sum(equation.whole_factor[:, -1] ** 2) / equation.counts.sum() == pytest.approx(wanted, rel=0.05)
    rest = equation.whole_factor[:, -1] - equation.whole_factor[:, :-1] @ truth_of(model)[equation.columns]
    assert np.linalg.norm(rest) < 1e-4 * np.linalg.norm(equation.whole_factor[:, -1])


@pytest.mark.parametrize("which", ["filtered", "energy", "power"])
@pytest.mark.parametrize("read", [777, 2000])
def test_block_borders_leave_no_trace_in_any_model(which, read, monkeypatch):
    robot = arm("scara")
    model = build_model(robot, (*EFFECTS, EffectChoice("presliding", (robot.joint_names[0],), (("d0", 5e-3),))))
    run = noise_free(robot, seconds=40.0, rate=200.0, windows=((2.0, 17.0), (19.0, 36.0)))
    whole = reductions(model, run)[which]
    monkeypatch.setattr("dynident.recordings.position_filter.READ_LENGTH", read)
    monkeypatch.setattr(
        "dynident.recordings.low_pass_decimation.filtered_blocks",
        lambda *given, **more: filtered_blocks(*given, **more, block_length=331),
    )
    cut = reductions(model, run)[which]
    assert cut.n_rows == whole.n_rows
    np.testing.assert_array_equal(cut.spans, whole.spans)
    for one, other in zip(cut.equations, whole.equations, strict=True):
        size = np.abs(other.whole_factor).max()
        np.testing.assert_allclose(np.abs(one.whole_factor), np.abs(other.whole_factor), atol=1e-9 * size)


@pytest.mark.parametrize("which", ["filtered", "energy", "power"])
def test_nothing_is_filtered_or_integrated_from_one_run_into_the_next(which):
    robot = arm("scara")
    model = build_model(robot, EFFECTS)
    one, two = noise_free(robot, 20.0, 200.0, 1), noise_free(robot, 20.0, 200.0, 2)
    parts = [next(iter(run.source.rows(0, run.n_samples, run.n_samples))) for run in (one, two)]
    t = np.arange(one.n_samples) / 200.0
    both = recording_from_arrays(
        np.concatenate([t, t + 30.0]),
        np.concatenate([part.q for part in parts]),
        np.concatenate([part.tau for part in parts]),
        joint_names=robot.joint_names,
    )
    assert len(both.segments) == 2
    often = Preprocessing(None, 5.0, 10)
    together = reductions(model, both, preprocessing=often)[which]
    apart = [reductions(model, run, preprocessing=often)[which] for run in (one, two)]
    assert together.n_rows == sum(part.n_rows for part in apart)
    for k, equation in enumerate(together.equations):
        whole = equation.whole_factor
        grams = [part.equations[k].whole_factor.T @ part.equations[k].whole_factor for part in apart]
        np.testing.assert_allclose(whole.T @ whole, sum(grams), atol=1e-8 * np.abs(sum(grams)).max())
    assert error(together, truth_of(model)) < LIMITS[which]


class Endless:
    """Rows of a periodic motion of any length, made as they are read."""

    def __init__(self) -> None:
        self.robot = arm("scara")
        motion = fourier_motion(self.robot, 10.0, 100.0, 1)
        self.q, self.tau = motion.q, pinocchio_torque(self.robot, motion.q, motion.dq, motion.ddq)

    def rows(self, first, length, block_length):
        for start in range(first, first + length, block_length):
            index = np.arange(start, min(start + block_length, first + length)) % len(self.q)
            yield StoredRows(self.q[index], self.tau[index], None)


@pytest.mark.slow
def test_ten_times_the_data_takes_no_more_memory_in_any_model(monkeypatch: pytest.MonkeyPatch):
    # How many of the few blocks that another thread makes ahead are there at a time is chance.
    monkeypatch.setattr(parallel, "count_processors", lambda: 1)
    source = Endless()
    robot = source.robot
    model = build_model(robot, EFFECTS)
    power = build_power_form(robot, model.kept, model.signals)
    forms = [
        (build_filtered_form(robot, model.kept, model.signals), filter_with_pole(20.0)),
        (power, stream_equations),
        (power, integrate_over_intervals(1)),
    ]
    for form, treatment in forms:
        peaks = []
        for length in (40_000, 400_000):
            run = Recording("long", robot.joint_names, 100.0, (Segment(0, length, 0.0),), source)
            tracemalloc.start()
            reduce_form(
                form, treatment, RegressorInputs([run], Preprocessing(8.0, 6.0, 4), ReferenceParameters.massless(robot))
            )
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
        assert peaks[1] < 1.15 * peaks[0]


def test_an_interval_never_spans_rows_that_are_missing():
    t = np.concatenate([np.arange(0, 5.0, 0.1), np.arange(8.0, 12.0, 0.1)])
    pieces = [(0, t[:30], t[:30, None]), (0, t[30:70], t[30:70, None]), (0, t[70:], t[70:, None])]
    found = list(take_differences(pieces, length=10, step=2, spacing=0.1))
    lengths = np.concatenate([values[:, 0] for _, _, values in found])
    middles = np.concatenate([times for _, times, _ in found])
    np.testing.assert_allclose(lengths, 1.0)
    assert not ((middles > 4.5) & (middles < 8.4)).any()
    whole = np.concatenate([v for _, _, v in take_differences([(0, t, t[:, None])], length=10, step=2, spacing=0.1)])
    np.testing.assert_array_equal(whole[:, 0], lengths)


def test_rows_in_which_the_filter_still_settles_are_not_used():
    rate, pole = 100.0, 20.0
    used = np.ones(400, dtype=bool)
    used[150:160] = False
    values = np.ones((400, 1))
    (out,) = smooth_samples([Samples(0, True, np.arange(400) / rate, used, values)], pole, rate)
    settling = int(np.ceil(9.2 / pole * rate))
    np.testing.assert_array_equal(np.flatnonzero(out.used), [*range(settling, 150), *range(160 + settling, 400)])
    np.testing.assert_allclose(out.values[out.used], 1.0, atol=2e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_offsets_that_no_parameter_stands_for_spoil_energy_more_than_power(seed):
    robot = arm("scara")
    model = build_model(robot, EFFECTS[:-1])
    values = truth_of(build_model(robot, EFFECTS))[: model.n_parameters]
    run = noise_free(robot, seconds=120.0, rate=250.0, seed=seed, frequency=0.1)
    form = build_power_form(robot, model.kept, model.signals)
    inputs = RegressorInputs([run], Preprocessing(None, 5.0, 10), ReferenceParameters.massless(robot))
    power = error(reduce_form(form, stream_equations, inputs), values)
    short, long = (error(reduce_form(form, integrate_over_intervals(length), inputs), values) for length in (0.3, 4.0))
    assert short > 1.1 * power
    assert long > 2.0 * power
