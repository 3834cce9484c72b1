"""A model that is extended step by step is that which is identified at once, with or without rows in memory."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib import import_module
from threading import Barrier
from types import SimpleNamespace

import numpy as np
import pytest
from support.drawn_recordings import log, read
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice, ReferenceParameters, build_columns
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, extend, from_bytes, identify, to_bytes
from dynident.identification.estimation_problem import ShapeUncertainty
from dynident.recordings import Preprocessing, Recording
from dynident.regressors import dynamic_model_rows, row_cache
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import build_model, extend_model
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.qr_accumulation import MOST_VALUES

ROBOT = arm("ur10")
NAMES = ROBOT.joint_names
PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
CHOICES = IdentificationChoices(PLAIN, estimator="wls", preprocessing=Preprocessing(10.0, 8.0, 3))
STEPS = (
    (EffectChoice("joint_spring", (NAMES[0],)), EffectChoice("coulomb_asymmetric")),
    (EffectChoice("presliding", (NAMES[1], NAMES[2]), (("d0", 0.01), ("law", -1.0))),),
    (
        EffectChoice("load_dependent_friction", (NAMES[2],)),
        EffectChoice("presliding", (NAMES[1],), (("d0", 0.1), ("law", -1.0))),
    ),
)


def run(seed: int, seconds: float):
    motion = fourier_motion(ROBOT, seconds, 100.0, seed)
    v = motion.dq
    tau = pinocchio_torque(ROBOT, motion.q, v, motion.ddq) + 4 * np.sign(v) + 3 * v
    return record(ROBOT, motion, tau + np.random.default_rng(seed).normal(0, 0.5, tau.shape), f"run {seed}")


REFERENCE = ReferenceParameters.massless(ROBOT)
RUNS, HELD_OUT = [run(1, 20.0), run(3, 8.0)], [run(2, 12.0)]


def test_base_parameters_grown_step_by_step_are_those_found_at_once():
    grown = build_model(ROBOT, PLAIN)
    for step in STEPS:
        grown = extend_model(grown, step)
    whole = build_model(ROBOT, grown.effects)
    assert grown.base.kept == whole.base.kept
    assert grown.base.names == whole.base.names
    assert grown.base.rank == whole.base.rank
    assert grown.base.without_effect == whole.base.without_effect
    np.testing.assert_allclose(grown.base.grouping, whole.base.grouping, atol=1e-6)
    assert grown.base.groupings == whole.base.groupings
    assert [c.key for c in grown.columns] == [c.key for c in whole.columns]


@pytest.mark.parametrize("kept", ["kept", "too many to keep", "of a file"])
def test_extending_gives_what_identifying_at_once_gives(kept, monkeypatch):
    if kept == "too many to keep":
        monkeypatch.setattr(row_cache, "MOST_VALUES", 10)
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES)
    for step in STEPS[:2]:
        if kept == "of a file":
            model = from_bytes(to_bytes(model))
        assert (model.in_memory.training is not None) == (kept == "kept")
        model = extend(model, step, RUNS, HELD_OUT)
    effects = (*PLAIN, *STEPS[0], *STEPS[1])
    whole = identify(ROBOT, RUNS, HELD_OUT, replace(CHOICES, effects=effects))
    assert [p.name for p in model.parameters] == [p.name for p in whole.parameters]
    np.testing.assert_allclose(model.held_out.rms, whole.held_out.rms, rtol=1e-6)
    assert model.worst_inertia_eigenvalue == pytest.approx(whole.worst_inertia_eigenvalue, rel=1e-5)


@pytest.mark.parametrize(
    "added",
    [
        (STEPS[0][0], EffectChoice("viscous_asymmetric")),
        (STEPS[0][0], EffectChoice("viscous_nonlinear", (NAMES[0],), (("p", 2.0),))),
    ],
)
def test_effects_added_together_take_one_pass_and_give_what_identifying_at_once_gives(added, monkeypatch):
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES)
    alone = extend(model, added[:1], RUNS, HELD_OUT)
    passes = []
    reduce = row_cache.reduce_and_cache
    place = "dynident.identification.equations.reduced_recordings.reduce_and_cache"
    monkeypatch.setattr(place, lambda *given: passes.append(1) or reduce(*given))
    grown = extend(model, added, RUNS, HELD_OUT)
    assert len(passes) == 2  # over the data of the fit and over the held-out data
    whole = identify(ROBOT, RUNS, HELD_OUT, replace(CHOICES, effects=(*PLAIN, *added)))
    assert [step.step.added for step in grown.ladder()] == [(), added[:1], added[1:]]
    for found, expected in ((grown, whole), (grown.step.parent, alone)):
        deviations = expected.statistics.standard_deviations
        np.testing.assert_allclose(found.values / deviations, expected.values / deviations, rtol=0, atol=1e-7)
        np.testing.assert_allclose(found.held_out.rms, expected.held_out.rms, rtol=1e-9)
        np.testing.assert_allclose(found.fit.rms, expected.fit.rms, rtol=1e-9)
        assert found.warnings[-1:] == expected.warnings[-1:]
    np.testing.assert_allclose(grown.statistics.standard_deviations, whole.statistics.standard_deviations, rtol=1e-7)


def test_new_columns_go_behind_cached_ones_however_either_was_cut(monkeypatch):
    # Of a robot with many joints a model's columns are filtered in more pieces than those of one effect.
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES)
    plain = extend(model, STEPS[0], RUNS, HELD_OUT)
    monkeypatch.setattr("dynident.recordings.low_pass_decimation._NUMBERS_AT_ONCE", 30_000)
    cut = extend(identify(ROBOT, RUNS, HELD_OUT, CHOICES), STEPS[0], RUNS, HELD_OUT)
    np.testing.assert_allclose(cut.values, plain.values, rtol=1e-8, atol=1e-9)


SPRING = EffectChoice("joint_spring", NAMES[:3])
LOAD = EffectChoice("load_dependent_friction", NAMES[:3])
STRIBECK = EffectChoice("stribeck", (NAMES[0],), (("vs", 0.1), ("delta", 2.0)))


def run_with_springs(seed: int, seconds: float) -> Recording:
    motion = fourier_motion(ROBOT, seconds, 100.0, seed)
    load, v = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq), motion.dq
    tau = load + (4 + 0.1 * np.abs(load)) * np.sign(v) + 3 * v
    tau[:, :3] += 60 * (motion.q[:, :3] - 0.2)
    return record(ROBOT, motion, tau + np.random.default_rng(seed).normal(0, 0.5, tau.shape), f"springs {seed}")


def test_loads_are_those_of_a_model_with_the_springs_that_are_added_beside_them():
    runs, held_out = [run_with_springs(1, 20.0)], [run_with_springs(2, 12.0)]
    model = identify(ROBOT, runs, held_out, CHOICES)
    whole = identify(ROBOT, runs, held_out, replace(CHOICES, effects=(*PLAIN, SPRING, LOAD)))
    grown = extend(model, (SPRING, LOAD), runs, held_out)
    deviations = whole.statistics.standard_deviations
    np.testing.assert_allclose(grown.values / deviations, whole.values / deviations, rtol=0, atol=1e-7)
    # Whatever the order, loads are predicted by the model with the springs.
    turned = extend(model, (LOAD, SPRING), runs, held_out)
    np.testing.assert_allclose(turned.held_out.rms, whole.held_out.rms, rtol=1e-9)
    # The models below are those of fewer columns, with the same loads.
    assert [step.step.added for step in turned.ladder()] == [(), (LOAD,), (SPRING,)]
    alone = extend(model, (LOAD,), runs, held_out)
    assert np.all(turned.step.parent.held_out.rms < 1.1 * alone.held_out.rms)


def test_deviations_warnings_and_lower_steps_are_computed_when_they_are_asked_for(monkeypatch):
    computed = []

    def watch(place: str, name: str) -> None:
        original = getattr(import_module(place), name)
        monkeypatch.setattr(
            f"{place}.{name}", lambda *given, **named: computed.append(name) or original(*given, **named)
        )

    watch("dynident.estimation", "statistics")
    watch("dynident.identification.identified_models.fit_model", "list_warnings")
    watch("dynident.identification.identified_models.add_effects", "solve_submodel")
    added = (STRIBECK, STEPS[0][0])
    model = extend(identify(ROBOT, RUNS, HELD_OUT, CHOICES), added, RUNS, HELD_OUT)
    assert model.held_out.relative_total > 0.0
    assert not computed
    parent = model.step.parent
    assert parent.step.added == (STRIBECK,)
    assert computed == ["solve_submodel"]
    assert model.step.parent is parent
    deviations = model.statistics.standard_deviations
    assert model.with_changes(choices=CHOICES).statistics.standard_deviations is not None
    assert computed[1:] == ["statistics"] * len(computed[1:])
    assert deviations.shape == (model.model.n_parameters,)
    assert "list_warnings" not in computed
    assert model.warnings is model.warnings
    assert computed.count("list_warnings") == 1


def test_nothing_is_read_from_the_file_of_a_recording_afterwards(tmp_path):
    given = log("ur10", 3, 100.0)
    recording = read(given.robot, tmp_path, given.columns()).recording
    added = (STRIBECK, STEPS[0][0])
    model = extend(identify(given.robot, [recording], choices=CHOICES), added, [recording])
    kept = to_bytes(extend(identify(given.robot, [recording], choices=CHOICES), added, [recording]))
    whole = identify(given.robot, [recording], choices=replace(CHOICES, effects=(*PLAIN, STRIBECK)))
    recording.path.unlink()
    assert to_bytes(model) == kept
    assert model.step.parent.step.added == (STRIBECK,)
    for step in (model.step.parent, whole):
        assert step.data.shaped is not None
        assert np.all(step.statistics.standard_deviations > 0.0)


def test_two_models_may_be_computed_at_the_same_time():
    # Each waits for the other, as one model's deviations do for those of the model that it is a part of.
    both = Barrier(2)
    fitted = SimpleNamespace(solution=SimpleNamespace(values=np.zeros(1)))

    def meet(_: np.ndarray) -> None:
        both.wait(10.0)

    shapes = [ShapeUncertainty.from_fit(None, fitted, meet) for _ in range(2)]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda each: each.linearisation, shapes)) == [None, None]


@pytest.mark.parametrize("known", [(), (STRIBECK,)], ids=["added", "in the model"])
def test_every_step_has_the_deviations_that_it_has_alone(known):
    model = identify(ROBOT, RUNS, HELD_OUT, replace(CHOICES, effects=(*PLAIN, *known)))
    added = (*(() if known else (STRIBECK,)), STEPS[0][0], EffectChoice("viscous_asymmetric"))
    step = model
    steps = [*extend(model, added, RUNS, HELD_OUT).ladder()][1:]
    for together, choice in zip(steps, added, strict=True):
        step = extend(step, (choice,), RUNS, HELD_OUT)
        for found, expected in zip(together.parameters, step.parameters, strict=True):
            assert found.standard_deviation == pytest.approx(expected.standard_deviation, rel=1e-6)
        for found, expected in zip(together.estimate.shape_constants, step.estimate.shape_constants, strict=True):
            assert found.standard_deviation == pytest.approx(expected.standard_deviation, rel=1e-6)


def test_progress_of_several_effects_never_goes_back():
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES)
    reports = []
    added = (STEPS[0][0], STRIBECK, EffectChoice("viscous_asymmetric"))
    extend(model, added, RUNS, HELD_OUT, lambda fraction, _: reports.append(fraction))
    assert len(reports) > 3
    assert reports == sorted(reports)


def test_rows_of_other_recordings_are_not_taken():
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES)
    model = replace(model, data=replace(model.data, digests=()))  # as of a version that did not note them
    others = [run(5, 20.0), run(6, 8.0)]
    found = extend(model, STEPS[0], others, HELD_OUT)
    expected = identify(ROBOT, others, HELD_OUT, replace(CHOICES, effects=(*PLAIN, *STEPS[0])))
    np.testing.assert_allclose(found.fit.rms, expected.fit.rms, rtol=1e-6)


def test_loads_are_predicted_anew_at_every_step():
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES)
    load = EffectChoice("load_dependent_friction", (NAMES[2],))
    once = extend(model, [load], RUNS, HELD_OUT)
    twice = extend(once, STEPS[0], RUNS, HELD_OUT)
    again = extend(from_bytes(to_bytes(once)), STEPS[0], RUNS, HELD_OUT)
    np.testing.assert_allclose(twice.values, again.values, rtol=1e-7, atol=1e-9)


def test_other_recordings_than_those_of_the_model_are_refused_by_their_samples():
    shortened = RUNS[1].with_windows(((1.0, 5.0),))
    model = from_bytes(to_bytes(identify(ROBOT, RUNS, choices=CHOICES)))
    added = STEPS[0][:1]
    extend(model, added, [RUNS[1], replace(RUNS[0], name="the same under another name")])
    for given, said in (
        ([RUNS[0], shortened], "run 3 holds other samples"),
        ([RUNS[0], HELD_OUT[0]], "run 2 holds other samples"),
        (RUNS[:1], "some are missing"),
    ):
        with pytest.raises(DynidentError, match=rf"not the recordings .* identified from \(run 1, run 3\): {said}"):
            extend(model, added, given)


def test_columns_behind_those_that_an_earlier_pass_kept_are_evaluated_alone(monkeypatch):
    model = extend(
        identify(ROBOT, RUNS, HELD_OUT, CHOICES), [EffectChoice("load_dependent_friction", (NAMES[2],))], RUNS
    )
    inputs = RegressorInputs(RUNS, CHOICES.preprocessing, model.estimate.reference)
    loaded = replace(inputs, reference=model.estimate.next_reference())
    springs, starts = (
        model.model.observation.extend(build_columns([choice], model.model.signals), model.model.signals)
        for choice in (EffectChoice("joint_spring"), EffectChoice("stribeck", (NAMES[1],)))
    )
    evaluated = []
    evaluate = Observation.evaluate

    def count_columns(observation: Observation, *signals: object, **others: object) -> object:
        evaluated.append(observation.n_columns)
        return evaluate(observation, *signals, **others)

    monkeypatch.setattr(Observation, "evaluate", count_columns)
    kept = {}
    # Another torque that loads are predicted with, or other instants that are left out, are other rows.
    for observation, given, is_kept in (
        (springs, inputs, False),
        (springs, inputs, True),
        (springs, loaded, False),
        (starts, loaded, False),
    ):
        evaluated.clear()
        mine = reduce_recordings(observation, replace(given, kept_rows=kept), by_phase=True)
        assert set(evaluated) == {observation.parts[1].n_columns if is_kept else observation.n_columns}
        fresh = reduce_recordings(observation, given, by_phase=True)
        for own, other in zip(mine.equations, fresh.equations, strict=True):
            np.testing.assert_allclose(np.abs(own.factors), np.abs(other.factors), rtol=1e-6, atol=1e-8)
    assert sum(rows.size for rows in kept.values()) <= MOST_VALUES


def test_rows_beyond_the_most_values_are_not_kept(monkeypatch):
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES).model
    observation = model.observation.extend(build_columns([EffectChoice("joint_spring")], model.signals), model.signals)
    kept = {}
    monkeypatch.setattr(dynamic_model_rows, "MOST_VALUES", 10)
    reduce_recordings(observation, RegressorInputs(RUNS, CHOICES.preprocessing, REFERENCE, kept_rows=kept))
    assert not kept


def test_recordings_that_together_are_too_many_do_not_remove_each_other(monkeypatch):
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES).model
    observation = model.observation.extend(build_columns([EffectChoice("joint_spring")], model.signals), model.signals)
    kept = {}
    inputs = RegressorInputs(RUNS, CHOICES.preprocessing, REFERENCE, kept_rows=kept)
    reduce_recordings(observation, inputs)
    most = int(0.9 * sum(rows.size for rows in kept.values()))
    kept.clear()
    monkeypatch.setattr(dynamic_model_rows, "MOST_VALUES", most)
    reduce_recordings(observation, inputs)
    first = dict(kept)
    assert 0 < len(first) < len(RUNS)
    reduce_recordings(observation, inputs)
    assert kept.keys() == first.keys()
    assert all(kept[key] is rows for key, rows in first.items())
    # Other filters are other rows: they replace the older ones.
    filters = replace(CHOICES.preprocessing, torque_cutoff=0.9 * CHOICES.preprocessing.torque_cutoff)
    reduce_recordings(observation, replace(inputs, preprocessing=filters))
    assert {key[1] for key in kept} == {key[1] for key in first}
    assert not kept.keys() & first.keys()
    assert sum(rows.size for rows in kept.values()) <= most


def test_one_factor_a_segment_has_the_products_of_all_blocks():
    model = identify(ROBOT, RUNS, HELD_OUT, CHOICES).model
    inputs = RegressorInputs(RUNS, CHOICES.preprocessing, REFERENCE)
    blocks, whole = (reduce_recordings(model.observation, inputs, by_time=by_time) for by_time in (True, False))
    assert len(whole.spans) == len(RUNS) < len(blocks.spans)
    for own, other in zip(whole.equations, blocks.equations, strict=True):
        assert own.counts.sum() == other.counts.sum()
        products = [each.whole_factor.T @ each.whole_factor for each in (own, other)]
        np.testing.assert_allclose(products[0], products[1], rtol=1e-8, atol=1e-8 * np.abs(products[1]).max())


def test_columns_of_first_order_effects_are_compiled_once():
    model = build_model(ROBOT, PLAIN)
    delay, spring = (build_columns([EffectChoice(name)], model.signals) for name in ("torque_delay", "joint_spring"))
    tails = [model.observation.extend(delay, model.signals).parts[1] for _ in range(2)]
    assert tails[0] is tails[1]
    assert model.observation.extend(spring, model.signals).parts[1] is not tails[0]
