"""Identified models as bytes and back."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record
from threadpoolctl import threadpool_info, threadpool_limits

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import WeightedRows
from dynident.identification import IdentificationChoices, extend, from_bytes, identify, to_bytes
from dynident.identification.identified_models import identification_result
from dynident.recordings import Preprocessing

ROBOT = arm("scara")
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))


def run(seed: int):
    motion = fourier_motion(ROBOT, 15.0, 100.0, seed)
    noise = np.random.default_rng(seed).normal(0, 0.3, motion.q.shape)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 2 * np.sign(motion.dq) + motion.dq + noise
    return record(ROBOT, motion, tau, f"run {seed}")


RUNS = run(1), run(2)
FIRST = identify(ROBOT, [RUNS[0]], [RUNS[1]], IdentificationChoices(EFFECTS, preprocessing=Preprocessing(10.0, 8.0, 3)))
SECOND = extend(FIRST, [EffectChoice("offset")], [RUNS[0]], [RUNS[1]])
THIRD = extend(SECOND, [EffectChoice("presliding", (ROBOT.joint_names[0],), (("d0", 0.01),))], [RUNS[0]])
CONTENT = to_bytes(THIRD)


def assert_same(one, other) -> None:
    assert one.choices == other.choices
    assert one.preprocessing == other.preprocessing
    assert one.parameters == other.parameters
    assert one.warnings == other.warnings
    assert one.step.added == other.step.added
    assert one.data.measurement_names == other.data.measurement_names
    assert one.data.validation_names == other.data.validation_names
    assert one.model.robot.joint_names == other.model.robot.joint_names
    assert one.condition_number == other.condition_number
    assert one.inertia_matrix_positive_definite == other.inertia_matrix_positive_definite
    for left, right in (
        (one.values, other.values),
        (one.estimate.reference.vector, other.estimate.reference.vector),
        (one.statistics.covariance, other.statistics.covariance),
        (one.statistics.effective_rows, other.statistics.effective_rows),
        (one.estimate.solution.factor, other.estimate.solution.factor),
        (one.fit.squares, other.fit.squares),
        (one.data.training.spans, other.data.training.spans),
        (one.data.training.equations[1].factors, other.data.training.equations[1].factors),
    ):
        np.testing.assert_array_equal(left, right)
    assert (one.held_out is None) == (other.held_out is None)
    if one.held_out is not None and other.held_out is not None:
        assert one.held_out.relative_total == other.held_out.relative_total
        assert one.data.held_out.n_rows == other.data.held_out.n_rows


def test_factors_of_blocks_with_fewer_rows_than_columns_are_stored_without_empty_rows():
    choices = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(4.0, 3.0, 16))
    few = identify(ROBOT, [RUNS[0]], [RUNS[1]], choices)
    factors = few.data.training.equations[1].factors
    assert factors.shape[1] < factors.shape[2]
    assert_same(from_bytes(to_bytes(few)), few)
    stored = np.load(io.BytesIO(to_bytes(few)))["0/training_1_factors"]
    assert stored.shape[1] < len(np.triu_indices(factors.shape[2])[0])


def test_a_model_read_from_its_bytes_is_the_same_with_its_whole_ladder():
    again = from_bytes(CONTENT)
    rungs = list(zip(again.ladder(), THIRD.ladder(), strict=True))
    assert len(rungs) == 3
    for one, other in rungs:
        assert_same(one, other)


def test_bytes_do_not_depend_on_how_often_they_were_read():
    assert to_bytes(from_bytes(CONTENT)) == CONTENT


def test_a_model_read_from_its_bytes_can_be_extended():
    choice = EffectChoice("viscous_nonlinear", (), (("p", 2.0),))
    one, other = (extend(model, [choice], [RUNS[0]], [RUNS[1]]) for model in (from_bytes(CONTENT), THIRD))
    np.testing.assert_allclose(one.values, other.values, rtol=1e-8)


def test_a_model_without_links_survives_although_it_has_no_inertia_matrix():
    friction = identify(
        ROBOT,
        [RUNS[0]],
        [],
        IdentificationChoices((EffectChoice("coulomb"),), preprocessing=Preprocessing(10.0, 8.0, 3)),
    )
    assert np.isnan(from_bytes(to_bytes(friction)).worst_inertia_eigenvalue)


@pytest.mark.parametrize(
    "content", [b"", b"PK", b"no model", b"PK\x03\x04" + bytes(50), CONTENT[:1000], CONTENT[:-30], CONTENT[200:]]
)
def test_bytes_that_are_no_model_say_so(content):
    with pytest.raises(DynidentError) as caught:
        from_bytes(content)
    assert caught.value.title == "Unreadable model"


def test_another_npz_file_is_no_model():
    for arrays in ({"a": np.zeros(3)}, {"header": np.frombuffer(b"[1, 2]", dtype=np.uint8)}):
        file = io.BytesIO()
        np.savez(file, **arrays)
        with pytest.raises(DynidentError):
            from_bytes(file.getvalue())
    file = io.BytesIO()
    np.save(file, np.zeros(4))
    with pytest.raises(DynidentError):
        from_bytes(file.getvalue())


def test_a_damaged_model_is_never_a_crash():
    rng = np.random.default_rng(0)
    for place in [*range(0, 60, 7), *range(len(CONTENT) - 60, len(CONTENT), 9), *rng.integers(0, len(CONTENT), 12)]:
        damaged = bytearray(CONTENT)
        damaged[place] ^= int(rng.integers(1, 256))
        # Some bytes carry nothing, a date for instance.
        with contextlib.suppress(DynidentError):
            assert_same(from_bytes(bytes(damaged)), THIRD)


def test_a_model_without_its_last_bytes_is_not_taken_for_its_parent():
    for missing in (1, 30, 100, 5000, len(CONTENT) // 2):
        with pytest.raises(DynidentError):
            from_bytes(CONTENT[:-missing])


def test_held_out_data_tell_the_rows_where_joints_turn_round_by_blocks_and_count_them_alike() -> None:
    kept = FIRST.data.held_out
    assert kept is not None
    for one in kept.equations:
        assert isinstance(one.group_rows, WeightedRows)
        assert one.group_rows.count
        assert one.group_rows.weight == 1.0


def test_a_file_of_a_version_that_kept_rows_where_joints_turn_round_twice_is_read_with_its_own_errors() -> None:
    arrays = dict(np.load(io.BytesIO(to_bytes(FIRST))))
    equations = FIRST.data.training.equations
    turned = [one.weighted_rows for one in equations]
    for joint, own in enumerate(turned):
        factor = own.row_group.factor
        arrays[f"0/training_{joint}_beside_turning"] = 0.5 * factor[*np.triu_indices(len(factor))]
        arrays[f"0/training_{joint}_beside_n_turning"] = np.array(own.count)
    file = io.BytesIO()
    np.savez(file, **arrays)
    read = from_bytes(file.getvalue())
    assert_same(read, FIRST)
    # Halves of the rows, so that it shows which of the two are read: a quarter of their squares is taken off.
    less = [0.75 * own.sum_squares(FIRST.values[one.columns]) for own, one in zip(turned, equations, strict=True)]
    np.testing.assert_allclose(read.fit_moving.squares, FIRST.fit_moving.squares + less)
    assert_same(from_bytes(to_bytes(read)), read)
    np.testing.assert_array_equal(from_bytes(to_bytes(read)).fit_moving.squares, read.fit_moving.squares)


def test_a_model_is_written_with_blas_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """On small matrices the others only spin: on a busy machine that took as long as the identification."""
    threads: list[int] = []
    condition_number = identification_result.compute_condition_number  # type: ignore[attr-defined]  # a name that it imports

    def watched(reduction):
        threads.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        return condition_number(reduction)

    monkeypatch.setattr(identification_result, "compute_condition_number", watched)
    read = from_bytes(CONTENT)
    with threadpool_limits(limits=2, user_api="blas"):
        assert to_bytes(read)
    assert threads
    assert set(threads) == {1}


def test_what_a_link_carries_in_some_runs_comes_back():
    carried = EffectChoice("payload", ROBOT.joint_names[-1:], (), ("run 2",))
    rubs = EffectChoice("load_dependent_friction", ROBOT.joint_names[:2])
    model = identify(ROBOT, RUNS, [], IdentificationChoices((*EFFECTS, carried, rubs)))
    again = from_bytes(to_bytes(model))
    (load,) = again.estimate.reference.carried
    assert load.runs == ("run 2",)
    # Friction that grows with the load is that of the arm and what it carries there.
    assert again.estimate.reference.add_carried(lambda runs: runs == ("run 2",)).inertias[-1].any()
    assert again.estimate.reference.equals(model.estimate.reference)
    assert_same(again, model)
