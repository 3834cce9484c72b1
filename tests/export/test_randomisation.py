"""Drawn models: feasible, with the covariance of the estimates, and with a disturbance that covers recorded drift."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from support.models_with_chosen_parameters import predicted
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.export import (
    ModelDistribution,
    TorqueDisturbance,
    build_distribution,
    compute_drift_coverage,
    export_model,
    measure_disturbance,
)
from dynident.export.torque_disturbance import CENTRAL_90, DRAWS, count_independent_spans, widen_for_short_data
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.identification.identified_models.torque_prediction import compute_gravity
from dynident.recordings import Recording

ROBOT = arm("ur10")
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
RATE = 200.0
LACKING = TorqueDisturbance(np.array([3.0, 4.0, 2.0, 0.5, 0.4, 0.3]), np.array([0.3, 0.6, 0.4, 0.2, 0.3, 0.5]))


def record_arm(seed: int, duration: float) -> Recording:
    """A motion with friction, and a torque that no effect describes."""
    motion = fourier_motion(ROBOT, duration, RATE, seed)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 8.0 * motion.dq + 5.0 * np.sign(motion.dq) + 1.5
    tau += motion.ddq + LACKING.draw(1, len(tau), 1 / RATE, seed)[0]
    return record(ROBOT, motion, tau, f"run{seed}")


def write(values: FloatArray) -> str:
    return " ".join(map(repr, values.tolist()))


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    return [record_arm(seed, 20.0) for seed in (3, 4, 5)]


@pytest.fixture(scope="module")
def model(runs: list[Recording]) -> Identification:
    return identify(ROBOT, runs[:1], runs[1:2], IdentificationChoices(EFFECTS, estimator="feasible"))


@pytest.fixture(scope="module")
def distribution(model: Identification, runs: list[Recording]) -> ModelDistribution:
    return build_distribution(model, measure_disturbance(model, runs[1:2], nearest=True), nearest=True)


def test_every_draw_is_a_robot_that_mujoco_takes(distribution: ModelDistribution) -> None:
    draws = distribution.draw(2000)
    assert draws.mass.min() > 0
    for values in (draws.armature, draws.frictionloss, draws.damping):
        assert values.min() >= 0
    full = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
    moments = np.linalg.eigvalsh(draws.inertia[..., full])
    # Principal moments are positive and none exceeds the sum of the others.
    assert (moments[..., 0] + moments[..., 1] >= moments[..., 2] * (1 - 1e-9)).all()
    simulated = mujoco.MjModel.from_xml_string(
        "<mujoco><compiler inertiafromgeom='false' balanceinertia='false'/><worldbody>"
        + "".join(
            f"<body name='b{j}'><joint type='hinge'/><inertial pos='{write(draws.centre[7, j])}' "
            f"mass='{draws.mass[7, j]}' fullinertia='{write(draws.inertia[7, j])}'/></body>"
            for j in range(ROBOT.n)
        )
        + "</worldbody></mujoco>"
    )
    np.testing.assert_allclose(np.sort(simulated.body_inertia[1:], axis=1), moments[7], rtol=1e-4, atol=1e-12)


def test_draws_have_the_base_parameters_of_their_links(distribution: ModelDistribution, model: Identification) -> None:
    """The torque of drawn links by Pinocchio is that of the drawn base parameters at rest: gravity."""
    draws, base = distribution.draw(5, seed=2), distribution.draw_base_parameters(5, seed=2)
    q = np.random.default_rng(0).uniform(-1, 1, (20, ROBOT.n))
    full = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
    for k in range(5):
        centre, mass, inertia = draws.centre[k], draws.mass[k], draws.inertia[k][:, full]
        outer = np.einsum("ni,nj->nij", centre, centre)
        shift = np.trace(outer, axis1=1, axis2=2)[:, None, None] * np.eye(3) - outer
        about_origin = inertia + mass[:, None, None] * shift
        rows, columns = np.triu_indices(3)
        inertias = np.column_stack([about_origin[:, rows, columns], mass[:, None] * centre, mass])
        zero = np.zeros_like(q)
        gravity = pinocchio_torque(replace(ROBOT, inertias=inertias), q, zero, zero)
        estimate = replace(model.estimate, solution=replace(model.estimate.solution, values=base[k]))
        np.testing.assert_allclose(compute_gravity(estimate, q), gravity, rtol=0, atol=1e-6 * np.abs(gravity).max())


def test_draws_as_arrays_of_jax_are_robots_that_mjx_computes_at_once(
    distribution: ModelDistribution, model: Identification
) -> None:
    jax = pytest.importorskip("jax", reason="NO jax: draws are not computed with it here")
    mjx = pytest.importorskip("mujoco.mjx", reason="NO mujoco.mjx: draws are not computed with it here")
    jax.config.update("jax_enable_x64", True)
    draws, base = distribution.draw(3, seed=2), distribution.draw_base_parameters(3, seed=2)
    whole = mujoco.MjModel.from_xml_string(export_model(model, "mjcf", nearest=True).content.decode())
    drawn, plain = draws.convert(jax.numpy.asarray), mjx.put_model(whole)
    moments, axes = np.linalg.eigh(draws.inertia[..., np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])])
    axes[..., 0] *= np.linalg.det(axes)[..., None]
    turned = [[np.roll(pin.Quaternion(own).coeffs(), 1) for own in of_draw] for of_draw in axes]
    bodies = whole.jnt_bodyid
    motion = fourier_motion(ROBOT, 0.5, RATE, 7)
    moves = np.abs(motion.dq) > 0.05

    def compute_torque(values: dict[str, Any]) -> Any:
        changed = plain.replace(
            body_mass=plain.body_mass.at[bodies].set(values["mass"]),
            body_ipos=plain.body_ipos.at[bodies].set(values["centre"]),
            body_inertia=plain.body_inertia.at[bodies].set(values["moments"]),
            body_iquat=plain.body_iquat.at[bodies].set(values["turned"]),
            dof_armature=values["armature"],
            dof_frictionloss=values["frictionloss"],
            dof_damping=plain.dof_damping.at[(slice(None), *(0,) * (plain.dof_damping.ndim - 1))].set(
                values["damping"]
            ),
        )

        def invert(q: Any, dq: Any, ddq: Any) -> Any:
            return mjx.inverse(changed, mjx.make_data(whole).replace(qpos=q, qvel=dq, qacc=ddq)).qfrc_inverse

        return jax.vmap(invert)(motion.q, motion.dq, motion.ddq) + values["offset"]

    found = jax.jit(jax.vmap(compute_torque))(drawn | {"moments": moments, "turned": np.array(turned)})
    for k in range(3):
        estimate = replace(model.estimate, solution=replace(model.estimate.solution, values=base[k]))
        expected = predicted(replace(model, estimate=estimate), motion)
        np.testing.assert_allclose(np.asarray(found[k])[moves], expected[moves], atol=1e-3 * np.abs(expected).max())


def test_base_parameters_stay_near_the_identified_values() -> None:
    """Estimates more certain than those of real arms: the curvature of the coordinates hardly moves the mean."""
    motion = fourier_motion(ROBOT, 20.0, RATE, 3)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 8.0 * motion.dq + 5.0 * np.sign(motion.dq)
    tau += 0.05 * np.random.default_rng(0).standard_normal(tau.shape)
    effects = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
    model = identify(ROBOT, [record(ROBOT, motion, tau)], [], IdentificationChoices(effects))
    distribution = build_distribution(model, nearest=True)
    base = distribution.draw_base_parameters(20_000)
    deviations = np.sqrt(np.diag(distribution.covariance))
    assert np.abs((base.mean(axis=0) - distribution.values) / deviations).max() < 1.5
    # Feasible bodies near the identified ones are fewer than the covariance allows.
    assert 0.3 < np.median(base.std(axis=0) / deviations) < 1.2


def test_the_disturbance_is_measured_as_it_is(model: Identification, runs: list[Recording]) -> None:
    measured = measure_disturbance(model, runs[1:], nearest=True)
    np.testing.assert_allclose(measured.deviation, LACKING.deviation, rtol=0.4)
    assert (np.abs(np.log(measured.time / LACKING.time)) < np.log(2.5)).all()
    drawn = LACKING.draw(4000, 60, 0.01, seed=1)
    np.testing.assert_allclose(drawn.std(axis=(0, 1)), LACKING.deviation, rtol=0.05)
    correlation = np.mean(drawn[:, 0] * drawn[:, -1], axis=0) / LACKING.deviation**2
    np.testing.assert_allclose(correlation, np.exp(-0.59 / LACKING.time), atol=0.06)


def test_a_disturbance_out_of_short_data_is_as_wide_as_further_values_need() -> None:
    rng, length, period, time = np.random.default_rng(0), 10.0, 0.05, 1.0
    process = TorqueDisturbance(np.array([1.0]), np.array([time]))
    # One process for each recording; values long after it are independent of it.
    drawn = process.draw(4000, round(length / period), period, seed=2)[:, :, 0]
    estimated, further = np.sqrt(np.mean(drawn**2, axis=1)), rng.standard_normal(4000)
    plain, wide = (
        np.mean(np.abs(further) <= 1.645 * deviation)
        for deviation in (estimated, widen_for_short_data(estimated, np.full(4000, length / time)))
    )
    assert plain < 0.885
    assert wide == pytest.approx(0.9, abs=0.012)
    assert widen_for_short_data(np.ones(1), np.array([1e6])) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("spread", [0.0, 0.6])
def test_a_residual_that_is_larger_in_some_motions_is_widened_as_much_as_further_ones_need(spread: float) -> None:
    rng, count, m = np.random.default_rng(0), 4000, 9

    def draw(blocks: int) -> FloatArray:
        sizes = np.exp(spread * rng.standard_normal((count, blocks, ROBOT.n)))
        return sizes * rng.standard_normal((count, blocks, ROBOT.n))

    squares, further, lengths = draw(m) ** 2, draw(1)[:, 0], np.full(ROBOT.n, float(m))
    deviation = np.sqrt(squares.mean(axis=1))
    spans = np.array([count_independent_spans(own, lengths) for own in squares])
    assert spans.max() <= m
    alike, wide = (np.mean(np.abs(further) <= 1.645 * widen_for_short_data(deviation, of)) for of in (lengths, spans))
    assert wide == pytest.approx(0.9, abs=0.015)
    assert (alike < 0.885) == (spread > 0)


def test_a_joint_without_recorded_torque_changes_nothing_of_the_others() -> None:
    rng = np.random.default_rng(0)
    squares = (np.exp(2.0 * rng.standard_normal((9, 1))) * rng.standard_normal((9, 3))) ** 2
    spans = count_independent_spans(squares, np.full(3, 9.0))
    assert spans.max() < 9.0
    silent = count_independent_spans(np.column_stack([squares, np.zeros((9, 3))]), np.full(6, 9.0))
    assert silent[:3] == pytest.approx(spans)
    assert count_independent_spans(np.zeros((9, 2)), np.full(2, 4.0)) == pytest.approx(4.0)


def test_the_central_share_of_few_draws_is_that_of_student() -> None:
    rng = np.random.default_rng(0)
    draws, recorded = rng.standard_normal((DRAWS, 200_000)), rng.standard_normal(200_000)
    off = np.abs(recorded - draws.mean(axis=0)) / (draws.std(axis=0, ddof=1) * np.sqrt(1 + 1 / DRAWS))
    assert np.mean(off <= CENTRAL_90) == pytest.approx(0.9, abs=0.003)


def test_recordings_that_are_too_short_say_so(model: Identification) -> None:
    for recordings in ([], [record_arm(6, 0.9)]):
        with pytest.raises(DynidentError, match="no segment of the recordings is"):
            measure_disturbance(model, recordings, nearest=True)


@pytest.mark.slow
def test_recorded_drift_is_covered_as_often_as_stated(
    model: Identification, distribution: ModelDistribution, runs: list[Recording]
) -> None:
    covered = compute_drift_coverage(distribution, model, runs[2:], (0.1, 0.5), nearest=True)
    assert covered.shape == (2, ROBOT.n)
    assert covered.mean() == pytest.approx(0.9, abs=0.07)
    nothing = replace(distribution, disturbance=TorqueDisturbance(np.zeros(ROBOT.n), LACKING.time))
    alone = compute_drift_coverage(nothing, model, runs[2:], (0.5,), nearest=True)
    assert alone.mean() < 0.7


def test_the_file_is_read_again_and_other_files_are_refused(model: Identification, tmp_path: Path) -> None:
    file = export_model(model, "randomisation", nearest=True)
    place = tmp_path / file.name
    place.write_bytes(file.content)
    read = ModelDistribution.load(place)
    expected = build_distribution(model, nearest=True).draw(3, seed=5)
    for name, values in read.draw(3, seed=5).convert(np.asarray).items():
        np.testing.assert_allclose(values, getattr(expected, name), rtol=1e-9, atol=1e-12)
    with np.load(place) as arrays:
        assert arrays["drawn_mass"].shape == (1000, ROBOT.n)
        assert "Identified from" in str(arrays["about"])
    read.save(tmp_path / "again.npz")
    assert ModelDistribution.load(tmp_path / "again.npz").joint_names == ROBOT.joint_names
    (tmp_path / "other.npz").write_bytes(b"no archive")
    (tmp_path / "half.npz").write_bytes(place.read_bytes()[:1000])
    (tmp_path / "empty.npz").write_bytes(b"")
    np.save(tmp_path / "array.npy", np.eye(2))
    for other in ("other.npz", "missing.npz", "half.npz", "empty.npz", "array.npy"):
        with pytest.raises(DynidentError, match="no randomisation file"):
            ModelDistribution.load(tmp_path / other)
