"""Whatever may be asked of a robot is answered for one of one joint, too, or refused in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import get_args

import pytest
from support.one_joint_robots import ONE_JOINT, one_joint_recordings, one_joint_robot

import dynident as dy
from dynident.excitation.criteria.criterion_choice import CRITERIA
from dynident.excitation.design_request import FAMILY_KINDS, JOINT_BY_JOINT
from dynident.export import ExportFormat, export_model
from dynident.export.export_request import LOAD_FORMATS
from dynident.identification.identification_choices import COVARIANCES, STEPS
from dynident.identification.methods.base_classes import ESTIMATORS, MODELS, STRATEGIES
from dynident.progress import ignore_progress
from dynident.regressors import ROW_MODELS
from dynident.validation.validation_request import TRIALS, ValidationData

pytestmark = pytest.mark.sweep

SHORT = dy.TrajectoryRequest(duration=4.0, sampling_rate=50.0, harmonics=3, intervals=6, points=4)
QUICK = dy.DesignRequest(trajectory=SHORT, starts=1, random_trajectories=2)
BENT = dy.EffectChoice("stribeck", ("axis",), (("vs", 0.1),))


@cache
def model_of(name: str) -> dy.Model:
    runs = one_joint_recordings(name)
    return dy.identify(one_joint_robot(name), runs[:1], validation=runs[1:2])


@cache
def diagnosis_of(name: str) -> dy.DiagnosedModel:
    return dy.diagnose(model_of(name))


def designs() -> dict[str, dy.DesignRequest]:
    """Every family, criterion and kind of rows; one at a time is another's than the default."""
    found = {f"family {one}": replace(QUICK, trajectory=replace(SHORT, family=one)) for one in FAMILY_KINDS.names}
    found |= {f"kind {one}": replace(QUICK, kind=one) for one in ("random", "sequential", *JOINT_BY_JOINT)}
    found |= {f"rows {one}": replace(QUICK, model=one) for one in ROW_MODELS}
    told_apart = {"separation": {"effects": (BENT,)}, "parameters": {"parameters": ("Fc1",)}}
    found |= {
        f"criterion {one}": replace(QUICK, criterion=dy.CriterionChoice(one, **told_apart.get(one, {})))
        for one in CRITERIA
    }
    found["link by link"] = replace(QUICK, kind="sequential", trajectory=replace(SHORT, sets="link_by_link"))
    return found


@pytest.mark.sweep
@pytest.mark.parametrize("name", ONE_JOINT)
@pytest.mark.parametrize("wanted", designs())
def test_every_experiment_is_designed(name: str, wanted: str) -> None:
    design = dy.design(one_joint_robot(name), designs()[wanted])
    assert design.design.q.shape[1] == 1
    assert all(margin.share <= 1.0 for margin in design.design.margins)


@pytest.mark.sweep
@pytest.mark.parametrize("name", ONE_JOINT)
def test_every_model_strategy_and_estimator_finds_the_same(name: str) -> None:
    runs, robot = one_joint_recordings(name), one_joint_robot(name)
    choices = [dy.IdentificationChoices(model=one) for one in MODELS.names if one != "base_wrench"]
    choices += [dy.IdentificationChoices(estimator=one) for one in ESTIMATORS.names]
    choices += [dy.IdentificationChoices(covariance=one) for one in COVARIANCES.names]
    choices += [dy.IdentificationChoices(strategy=s, steps=one) for s in STRATEGIES.names for one in STEPS.names]
    choices += [dy.IdentificationChoices(prior="description")]
    choices += [dy.IdentificationChoices(prior="description_entropic", estimator="feasible")]
    for choice in choices:
        found = dy.identify(robot, runs[:1], validation=runs[1:2], choices=choice)
        assert found.held_out is not None
        assert found.held_out.relative_total < 0.25, choice


@pytest.mark.parametrize("name", ONE_JOINT)
def test_the_missing_effect_is_named_and_added(name: str) -> None:
    diagnosis = diagnosis_of(name)
    assert [one.effect for one in diagnosis.recommended] == ["stribeck"]
    better = model_of(name).extend(diagnosis)
    before, after = model_of(name).held_out, better.held_out
    assert before is not None
    assert after is not None
    assert after.relative_total < 0.7 * before.relative_total


@pytest.mark.sweep
@pytest.mark.parametrize("name", ONE_JOINT)
@pytest.mark.parametrize("rows", [one for one in MODELS.names if one != "base_wrench"])
def test_every_kind_of_rows_is_diagnosed(name: str, rows: str) -> None:
    runs = one_joint_recordings(name)
    model = dy.identify(one_joint_robot(name), runs[:1], choices=dy.IdentificationChoices(model=rows))
    assert dy.diagnose(model).summary


def _changed(name: str) -> object:
    runs = one_joint_recordings(name)
    return dy.changes(model_of(name), before=runs[:1], after=runs[2:])._repr_html_()


def _followed(name: str) -> object:
    runs = one_joint_recordings(name)
    return dy.series(model_of(name), [runs[k : k + 1] for k in range(3)])._repr_html_()


def _reported(name: str) -> object:
    model = model_of(name)
    return dy.report(model, diagnosis=diagnosis_of(name), validations=dy.validate(model)).html


def _next(name: str) -> object:
    experiment = diagnosis_of(name).next_experiment
    if experiment is None:
        return "no question is open"
    wanted = replace(experiment.design, starts=1, random_trajectories=2)
    return dy.design(one_joint_robot(name), replace(wanted, trajectory=replace(wanted.trajectory, duration=4.0)))


OPERATIONS: dict[str, Callable[[str], object]] = {
    "compare": lambda name: dy.compare(model_of(name), one_joint_recordings(name)[2:])._repr_html_(),
    "changes": _changed,
    "series": _followed,
    "report": _reported,
    "verdict": lambda name: model_of(name).verdict(),
    "next experiment": _next,
    "earlier runs": lambda name: dy.design(one_joint_robot(name), QUICK, earlier=one_joint_recordings(name)[:1]),
    "frames": lambda name: (diagnosis_of(name).to_frame(), model_of(name).parameters.to_frame(), model_of(name).plot()),
    "remove": lambda name: model_of(name).remove("viscous"),
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", ONE_JOINT)
@pytest.mark.parametrize("operation", OPERATIONS)
def test_it_is_compared_followed_and_reported(name: str, operation: str) -> None:
    assert OPERATIONS[operation](name)


@pytest.mark.parametrize("name", ONE_JOINT)
@pytest.mark.parametrize("format", [name for name in get_args(ExportFormat) if name not in LOAD_FORMATS])
def test_it_is_exported(name: str, format: str) -> None:
    assert export_model(model_of(name).identification, format, nearest=True).content


@pytest.mark.sweep
@pytest.mark.parametrize("name", ONE_JOINT)
@pytest.mark.parametrize("kind", [one for one in TRIALS.names if one != "payload"])
def test_it_is_validated(name: str, kind: str) -> None:
    fit, held_out, _ = one_joint_recordings(name).recordings
    short = {"longest": 3.0} if kind in ("simulation", "filters") else {}
    few = {"cutoffs": (5.0, 10.0)} if kind == "filters" else {}
    trial = replace(TRIALS.by_name[kind](), **short, **few)
    assert trial.judge(ValidationData(model_of(name).identification, [held_out], [fit], ignore_progress))
