"""Jobs of campaigns: design the next motion; take in recordings. Campaigns are restored from what is stored of them."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dynident.advice import CampaignRequest as RequestedCampaign
from dynident.advice import (
    CampaignRun,
    CampaignState,
    Decision,
    PlannedRun,
    add_run,
    plan_run,
    start_campaign,
)
from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.excitation import DesignRequest
from dynident.excitation.criteria.prediction_region import collect_region
from dynident.identification import Identification, IdentificationChoices, to_bytes
from dynident.identification.shape_search import check_choices
from dynident.presentation.design_tables import build_campaign_table
from dynident.progress import scale_progress
from dynident.robot import Robot
from dynident_service.campaigns.wire_types import (
    MOST_STEPS,
    CampaignDecision,
    CampaignOutcome,
    CampaignRequest,
    CampaignRunView,
    CampaignView,
    EffectsGoal,
)
from dynident_service.designs.adapters import describe_design, restore_design, show_request, write_trajectory
from dynident_service.designs.wire_types import DesignResult
from dynident_service.identifications.adapters import describe_identification
from dynident_service.identifications.jobs import describe_measurements
from dynident_service.identifications.wire_types import IdentificationResult
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.robots.adapters import place_mesh_files
from dynident_service.shared.field_by_field import (
    from_view,
    from_wire_choices,
    show_choice,
    show_tables,
    to_request,
    to_view,
)
from dynident_service.shared.stored_inputs import load_stored_model, load_stored_robot, open_recording_by_id
from dynident_service.shared.wire_types import Table, to_plain_json
from dynident_service.storage.repository_values import Resource, find_mesh_files

_PLACES = {
    "/minutes": "/budget/robot_time",
    "/choices/effects": "/effects",
    "/design": "/trajectory/joints",
    "/parameters": "/goal/parameters",
    "/decide": "/goal/effects",
    "/quantities": "/goal/quantities",
}


def build_campaign_request(body: CampaignRequest) -> RequestedCampaign:
    """Build the request of a campaign from its body; `DynidentError` where it cannot be one."""
    choices = IdentificationChoices()
    if body.effects is not None:
        choices = replace(choices, effects=from_wire_choices(body.effects))
    named = {"error", "speed", "parameters", "quantities", "mass_error", "centre_error", "unloaded_runs"}
    goal: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in body.goal.model_dump(include=named).items()
    }
    return RequestedCampaign(
        goal=body.goal.kind,
        **goal,
        decide=tuple(body.goal.effects) if isinstance(body.goal, EffectsGoal) else (),
        **body.budget.model_dump(include={"runs"}),
        minutes=body.budget.robot_time / 60.0,
        **body.model_dump(include={"first_speed"}),
        choices=choices,
        design=to_request(body, DesignRequest),
    )


@contextmanager
def _point_into_body() -> Iterator[None]:
    """Let errors point into the body of a request; the library points into its own request."""
    try:
        yield
    except DynidentError as error:
        error.pointer = _PLACES.get(error.pointer, error.pointer)
        raise


def check_request(body: CampaignRequest, robot: Robot) -> None:
    """Raise `DynidentError` with its place in the body where no campaign of this robot can be started."""
    requested = build_campaign_request(body)
    check_choices(requested.choices.effects, robot)
    with _point_into_body():
        start_campaign(robot, requested)


def design_next_run(task: Task) -> Outcome:
    """Design the next motion of a campaign, with what it promises."""
    campaign = task.resources.get("campaign", task.subject.get_dependency("campaign"))
    body = CampaignRequest.model_validate(campaign.request)
    state = _restore_state(task, campaign)
    meshes = find_mesh_files(task.resources.get("robot", body.robot_id))
    # Descriptions name meshes by path, so the stored files are given these names in a temporary folder.
    with place_mesh_files({name: task.objects.fetch_file(file.key) for name, file in meshes.items()}) as folders:
        design = state.request.design
        surroundings = replace(design.surroundings, mesh_folders=tuple(map(str, folders)))
        request = replace(state.request, design=replace(design, surroundings=surroundings))
        with _point_into_body():
            planned = plan_run(replace(state, request=request), task.progress)
    with tempfile.TemporaryDirectory() as folder:
        path = write_trajectory(planned.design, Path(folder) / "trajectory.parquet")
        trajectory = task.store_file("trajectory", path, "application/vnd.apache.parquet")
    result = describe_design(planned.design).model_copy(update={"promised": _to_list(planned.promised)})
    # The request as it was decided, so that the design can be read back; what names resources stands as it was stored.
    decided = to_plain_json(
        show_request(replace(planned.design.request, surroundings=design.surroundings), body.robot_id)
    )
    unchanged = ("name", "robot_id", "earlier_ids", "identification_id")
    return Outcome(
        to_plain_json(result),
        (trajectory,),
        request={name: value for name, value in decided.items() if name not in unchanged},
    )


def take_in_recordings(task: Task) -> Outcome:
    """Identify and diagnose the model from all recordings of a campaign so far, and decide."""
    subject = task.subject
    campaign = task.resources.get("campaign", subject.get_dependency("campaign"))
    state = _restore_state(task, campaign, before=subject.id)
    first = len(state.runs)
    planned = _restore_plan(task, subject)
    told_ids = subject.get_dependencies("told")
    for number, identifier in enumerate(told_ids):
        progress = scale_progress(task.progress, number / len(told_ids), (number + 1) / len(told_ids))
        with _point_to_measurement():
            state = add_run(state, open_recording_by_id(task, identifier), planned, progress)
    model = state.identification
    assert model is not None
    task.memory.put(Identification, subject.id, model)
    design_id = next(iter(subject.get_dependencies("design")), None)
    runs = [
        to_view(
            CampaignRunView,
            run,
            measurement_id=identifier,
            design_id=design_id,
            added=[show_choice(choice) for choice in run.added],
        )
        for run, identifier in zip(state.runs[first:], told_ids, strict=True)
    ]
    outcome = CampaignOutcome(runs=runs, decision=to_view(CampaignDecision, state.decision))
    described = describe_identification(model, None).model_copy(
        update={"measurements": describe_measurements(task), "campaign": outcome}
    )
    effects = [to_plain_json(show_choice(choice)) for choice in model.choices.effects]
    return Outcome(
        to_plain_json(described),
        (task.store_file("model", to_bytes(model), "application/vnd.dynident.model+npz"),),
        # With what the diagnosis added: the model can be identified again from its request alone.
        request={"effects": effects},
    )


@contextmanager
def _point_to_measurement() -> Iterator[None]:
    try:
        yield
    except DynidentError as error:
        if error.pointer == "recording":
            error.pointer = "/measurement_id"
        raise


def _list_models(task: Task, campaign: Resource, before: str | None) -> list[Resource]:
    """Return the models of a campaign that were computed, the first one first; those older than one if it is given."""
    page = task.resources.list_page("identification", MOST_STEPS, on_id=campaign.id)
    return [
        model
        for model in reversed(page.items)
        if model.job is not None and model.job.state == "succeeded" and (before is None or model.id < before)
    ]


def _restore_state(task: Task, campaign: Resource, before: str | None = None) -> CampaignState:
    """Restore a campaign from its request and from the models of its runs."""
    body = CampaignRequest.model_validate(campaign.request)
    robot = load_stored_robot(task, body.robot_id)
    region = [open_recording_by_id(task, identifier) for identifier in body.region_ids]
    state = start_campaign(robot, build_campaign_request(body), collect_region(region) if region else None)
    models = _list_models(task, campaign, before)
    if not models:
        return state
    outcomes = [IdentificationResult.model_validate(model.result).campaign for model in models]
    runs = [run for outcome in outcomes if outcome is not None for run in outcome.runs]
    last = outcomes[-1]
    assert last is not None
    recordings = [open_recording_by_id(task, run.measurement_id) for run in runs]
    return replace(
        state,
        # Names that a campaign gave are unique within it.
        recordings=tuple(replace(recording, name=run.name) for recording, run in zip(recordings, runs, strict=True)),
        runs=tuple(map(_restore_run, runs)),
        identification=load_stored_model(task, models[-1].id),
        decision=from_view(Decision, last.decision),
    )


def build_campaign_tables(view: CampaignView) -> list[Table]:
    """Build the table of the runs of a campaign; none before the first."""
    runs = [_restore_run(run) for step in view.steps for run in step.runs]
    request = build_campaign_request(view.request)
    return show_tables([build_campaign_table(runs, request, tuple(view.joints))] if runs else [])


def _restore_run(run: CampaignRunView) -> CampaignRun:
    return CampaignRun(
        name=run.name,
        seconds=run.seconds,
        promised=_to_array(run.promised),
        predicted=_to_array(run.predicted),
        parameters=np.array([np.inf if error is None else error for error in run.parameters]),
        lacking=np.array(run.lacking),
        added=from_wire_choices(run.added),
        is_changed=run.is_changed,
    )


def _restore_plan(task: Task, subject: Resource) -> PlannedRun | None:
    """Restore the motion that a run was planned by, if it was."""
    identifiers = subject.get_dependencies("design")
    if not identifiers:
        return None
    design = task.resources.get("design", identifiers[0])
    path = task.objects.fetch_file(design.objects["trajectory"].key)
    result = DesignResult.model_validate(design.result)
    return PlannedRun(restore_design(design.request, design.result or {}, path), _to_array(result.promised))


def _to_array(values: Sequence[float | None] | None) -> FloatArray | None:
    """Return errors as an array; those without a bound were stored as null."""
    return None if values is None else np.array([np.inf if error is None else error for error in values])


def _to_list(values: FloatArray | None) -> list[float] | None:
    return None if values is None else values.tolist()
