"""Routes of campaigns: create, show, list, delete; ask for the next motion, tell the recording of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

from fastapi import APIRouter, Response

from dynident.advice.campaign_request import describe_first_run
from dynident.number_format import format_count
from dynident_service.campaigns.wire_types import (
    MOST_STEPS,
    CampaignDecision,
    CampaignOutcome,
    CampaignPhase,
    CampaignRequest,
    CampaignStep,
    CampaignView,
    EffectsGoal,
    ParametersGoal,
    PayloadGoal,
    TellRequest,
    TorqueGoal,
)
from dynident_service.designs.wire_types import DesignRequest, DesignResult, DesignView
from dynident_service.identifications.routes import show_identification
from dynident_service.identifications.wire_types import (
    MOST_RECORDINGS,
    IdentificationResult,
    IdentificationView,
    StoredIdentification,
)
from dynident_service.problems import Problem, ProblemError, make_unusable
from dynident_service.robots.wire_types import RobotResult
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import depend_on, require_measurements, require_result, require_robot
from dynident_service.shared.resource_routes import (
    PagesDep,
    RetryKeyDep,
    create_or_replay,
    replay_response,
    resource_path,
)
from dynident_service.shared.wire_types import LONGEST_NAME, Page, Progress, to_plain_json
from dynident_service.storage.repository_values import Dependency, NewJob, NewResource, Resource, Siblings
from dynident_service.storage.resource_repository import SiblingsCame
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/campaigns", tags=["campaigns"])

ASK = NewJob("design", "dynident_service.campaigns.jobs:design_next_run")
TELL = NewJob("identification", "dynident_service.campaigns.jobs:take_in_recordings")
_ENDED: Mapping[str, CampaignPhase] = {"reached": "reached", "not_reachable": "unreachable", "out_of_time": "stopped"}


@router.post("", status_code=201)
def create_campaign(
    body: CampaignRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> CampaignView:
    """Begin a campaign: ask, move the robot, tell, until the goal is reached or cannot be."""
    with hold_import_lock():
        from dynident_service.campaigns.jobs import check_request
        from dynident_service.robots.adapters import restore_robot

    robot = require_robot(services, body.robot_id)
    needs = (
        depend_on(robot),
        *require_measurements(services, robot, body.region_ids, "region", "/goal/region_ids"),
        *require_measurements(services, robot, body.measurement_ids, "measurement", "/measurement_ids"),
    )
    # Refused at once, what would fail when the first motion is designed.
    check_request(body, restore_robot(robot.request))
    bound = retry.bind_to_body(body)
    new = NewResource("campaign", to_plain_json(body), name=body.name, rests_on=needs, retry=bound)
    campaign = create_or_replay(services, new, response)
    steps = _Steps(services, campaign)
    # Also where an earlier try of the same request ended before it came to this.
    if body.measurement_ids and not steps.tellings:
        # Another try of the same request may just have stored it.
        with suppress(SiblingsCame):
            services.resources.create(_new_model(services, campaign, steps, body.measurement_ids, None))
        services.engine.wake()
    return show_campaign(services, campaign)


@router.get("")
def list_campaigns(services: ServicesDep, pages: PagesDep, robot_id: str | None = None) -> Page[CampaignView]:
    """List the campaigns, newest first; those of one robot if requested."""
    return pages.show("campaign", lambda resource: show_campaign(services, resource), robot_id)


@router.get("/{campaign_id}")
def get_campaign(campaign_id: str, services: ServicesDep) -> CampaignView:
    """Show a campaign: its state, what was promised and achieved, and its steps."""
    with hold_import_lock():
        from dynident_service.campaigns.jobs import build_campaign_tables

    view = show_campaign(services, services.resources.get("campaign", campaign_id))
    return view.model_copy(update={"tables": build_campaign_tables(view)})


@router.delete("/{campaign_id}", status_code=204)
def delete_campaign(campaign_id: str, services: ServicesDep) -> None:
    """Delete a campaign; 409 while its motions and models are there."""
    services.resources.delete("campaign", campaign_id)


@router.post("/{campaign_id}/ask", status_code=202)
def ask_for_motion(campaign_id: str, services: ServicesDep, retry: RetryKeyDep, response: Response) -> DesignView:
    """Design the next motion; its result has what it promises. While one is waiting to be made, give that one."""
    campaign = services.resources.get("campaign", campaign_id)
    body = CampaignRequest.model_validate(campaign.request)
    existing = services.resources.find_retried(bound := retry.bind_to_body(body, campaign_id))
    if existing is not None:
        return DesignView.show(replay_response(existing, response))
    steps = _Steps(services, campaign)
    steps.check_can_go_on(campaign)
    waiting = steps.find_waiting_design()
    if waiting is not None:
        return _show_waiting(waiting, response)
    told_ids = [identifier for model in steps.models for identifier in model.get_dependencies("told")]
    model_id = steps.models[-1].id if steps.models else None
    # What the job decides (effects, criterion, limits of the first run) it writes into the stored request.
    request = DesignRequest.model_validate(
        {
            **body.model_dump(include={"robot_id", "trajectory", "limits"}),
            "name": _name_step(campaign, f"run {len(told_ids) + 1}"),
            "earlier_ids": told_ids,
            "identification_id": model_id,
        }
    )
    new = NewResource(
        "design",
        to_plain_json(request),
        name=request.name,
        rests_on=(_depend_on_campaign(campaign), Dependency(body.robot_id, "robot", "robot", "/robot_id")),
        job=ASK,
        retry=bound,
        siblings=Siblings(campaign.id, tuple(design.id for design in steps.designs)),
    )
    try:
        return DesignView.show(create_or_replay(services, new, response))
    except SiblingsCame:
        # Asked twice at the same time: one motion is enough.
        waiting = _Steps(services, campaign).find_waiting_design()
        if waiting is None:
            raise
        return _show_waiting(waiting, response)


def _show_waiting(design: Resource, response: Response) -> DesignView:
    response.headers["Location"] = resource_path(design.kind, design.id)
    return DesignView.show(design)


@router.post("/{campaign_id}/tell", status_code=202)
def tell_recording(
    campaign_id: str, body: TellRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> IdentificationView:
    """Take in the recording of a run: identify and diagnose the model from all recordings so far, and decide."""
    existing = services.resources.find_retried(bound := retry.bind_to_body(body, campaign_id))
    if existing is not None:
        return show_identification(replay_response(existing, response))
    campaign = services.resources.get("campaign", campaign_id)
    steps = _Steps(services, campaign)
    steps.check_can_go_on(campaign)
    design = steps.find_waiting_design()
    if body.design_id is not None:
        design = require_result(services, "design", body.design_id, "/design_id")
        if campaign.id not in design.get_dependencies("campaign"):
            raise make_unusable(f"the design {body.design_id!r} is none of this campaign's", "/design_id")
    if design is not None and (design.job is None or design.job.state != "succeeded"):
        design = None
    new = _new_model(services, campaign, steps, [body.measurement_id], design, "/measurement_id")
    return show_identification(create_or_replay(services, replace(new, retry=bound), response))


def _new_model(
    services: Services,
    campaign: Resource,
    steps: _Steps,
    recording_ids: list[str],
    design: Resource | None,
    pointer: str = "/measurement_ids",
) -> NewResource:
    """Return the model that is to be identified from all recordings of a campaign."""
    body = CampaignRequest.model_validate(campaign.request)
    robot = require_robot(services, body.robot_id)
    require_measurements(services, robot, recording_ids, "told", pointer)
    earlier = [identifier for model in steps.models for identifier in model.get_dependencies("told")]
    if len(earlier) + len(recording_ids) > MOST_RECORDINGS:
        detail = f"a campaign takes in {MOST_RECORDINGS} recordings at most; begin another one with some of them"
        raise make_unusable(detail, pointer, title="Too many recordings")
    for identifier in recording_ids:
        if identifier in earlier:
            raise make_unusable(f"{identifier} is a run of this campaign already", pointer, title="Told twice")
    request = StoredIdentification.model_validate(
        {
            **body.model_dump(include={"robot_id", "effects"}, exclude_none=True),
            "measurement_ids": [*earlier, *recording_ids],
        }
    )
    return NewResource(
        "identification",
        to_plain_json(request),
        name=_name_step(campaign, format_count(len(earlier) + len(recording_ids), "run")),
        rests_on=(
            _depend_on_campaign(campaign),
            Dependency(body.robot_id, "robot", "robot", "/robot_id"),
            *(Dependency(identifier, "measurement", "training", pointer) for identifier in request.measurement_ids),
            *(Dependency(identifier, "measurement", "told", pointer) for identifier in recording_ids),
            *(() if design is None else (Dependency(design.id, "design", "design", "/design_id"),)),
            # Models are deleted from the last one on: the campaign's runs are those of all of them.
            *(Dependency(model.id, "identification", "before", "/") for model in steps.models[-1:]),
        ),
        job=TELL,
        siblings=Siblings(campaign.id, tuple(model.id for model in steps.tellings)),
    )


def _name_step(campaign: Resource, words: str) -> str:
    """Return the name of a motion or a model, which is as long as a name may be where the campaign's is."""
    return f"{(campaign.name or 'campaign')[: LONGEST_NAME - len(words) - 2]}: {words}"


def _depend_on_campaign(campaign: Resource) -> Dependency:
    return Dependency(campaign.id, "campaign", "campaign", "/")


class _Steps:
    """Motions and models of a campaign, in order; failed and cancelled ones are steps, but not `models`."""

    def __init__(self, services: Services, campaign: Resource) -> None:
        pages = (
            services.resources.list_page(kind, MOST_STEPS, on_id=campaign.id) for kind in ("design", "identification")
        )
        self.designs, self.tellings = (list(reversed(page.items)) for page in pages)
        self.models = [model for model in self.tellings if _get_state(model) == "succeeded"]

    @property
    def outcome(self) -> CampaignOutcome | None:
        """What the campaign made of the last recording."""
        return IdentificationResult.model_validate(self.models[-1].result).campaign if self.models else None

    def find_waiting_design(self) -> Resource | None:
        """Return the last motion, if no recording of it was told, and its design has not failed."""
        used = {identifier for model in self.models for identifier in model.get_dependencies("design")}
        # A motion that was designed before the last recording was told complements less than is known now.
        waiting = [
            design
            for design in self.designs
            if design.id not in used
            and _get_state(design) not in ("failed", "cancelled")
            and (not self.models or design.created_at >= self.models[-1].created_at)
        ]
        return waiting[-1] if waiting else None

    def check_can_go_on(self, campaign: Resource) -> None:
        """Raise a problem 409 while a recording is taken in, or after the end."""
        running = [model for model in self.tellings if _get_state(model) in ("queued", "running")]
        if running:
            detail = f"The campaign {campaign.id} takes in a recording; wait for its job {_get_job_id(running[0])}."
            raise ProblemError(409, detail, title="Not computed")
        if self.outcome is not None and self.outcome.decision.code != "next_run":
            raise ProblemError(409, f"The campaign is over: {self.outcome.decision.sentence}", title="Campaign over")


def _get_state(resource: Resource) -> str:
    return "failed" if resource.job is None else resource.job.state


def _get_job_id(resource: Resource) -> str:
    return "" if resource.job is None else resource.job.id


def show_campaign(services: Services, campaign: Resource) -> CampaignView:
    """Show a campaign by its stored steps."""
    steps = _Steps(services, campaign)
    robot = services.resources.get("robot", campaign.get_dependency("robot"))
    outcome, waiting = steps.outcome, steps.find_waiting_design()
    shown = [_show_step(resource) for resource in sorted([*steps.designs, *steps.tellings], key=_by_time)]
    runs = [run for step in shown for run in step.runs]
    promises = [_find_worst(step.promised) for step in shown if step.promised]
    decision = CampaignDecision(code="next_run", sentence=describe_first_run(campaign.request["goal"]["kind"]))
    joints = [joint.name for joint in RobotResult.model_validate(robot.result).joints]
    return CampaignView.model_validate(
        {
            **vars(campaign),
            "joints": joints,
            "targets": _list_targets(CampaignRequest.model_validate(campaign.request).goal, joints),
            "state": _find_state(steps, outcome, waiting),
            "decision": decision if outcome is None else outcome.decision,
            "robot_time": sum(run.seconds for run in runs),
            "promised": promises[-1] if promises else None,
            "achieved": _find_worst(runs[-1].achieved) if runs else None,
            "design_id": None if waiting is None else waiting.id,
            "identification_id": steps.models[-1].id if steps.models else None,
            "steps": shown,
        }
    )


def _find_worst(errors: Sequence[float | None]) -> float | None:
    """Return the largest error; None where one has no bound."""
    bounded = [error for error in errors if error is not None]
    return max(bounded) if len(bounded) == len(errors) else None


def _list_targets(goal: TorqueGoal | ParametersGoal | EffectsGoal | PayloadGoal, joints: list[str]) -> Sequence[str]:
    if isinstance(goal, TorqueGoal):
        return joints
    if isinstance(goal, PayloadGoal):
        return goal.quantities
    return goal.parameters if isinstance(goal, ParametersGoal) else goal.effects


def _by_time(resource: Resource) -> tuple[object, str]:
    return resource.created_at, resource.id


def _find_state(steps: _Steps, outcome: CampaignOutcome | None, waiting: Resource | None) -> CampaignPhase:
    if any(_get_state(model) in ("queued", "running") for model in steps.tellings):
        return "estimating"
    if outcome is not None and outcome.decision.code != "next_run":
        return _ENDED[outcome.decision.code]
    if waiting is None:
        return "asking"
    return "waiting" if _get_state(waiting) == "succeeded" else "designing"


def _show_step(resource: Resource) -> CampaignStep:
    job, is_motion = resource.job, resource.kind == "design"
    assert job is not None
    motion = DesignResult.model_validate(resource.result) if is_motion and resource.result else None
    model = IdentificationResult.model_validate(resource.result) if not is_motion and resource.result else None
    return CampaignStep(
        kind="ask" if is_motion else "tell",
        design_id=resource.id if is_motion else next(iter(resource.get_dependencies("design")), None),
        identification_id=None if is_motion else resource.id,
        job_id=job.id,
        status=job.state,
        progress=Progress(fraction=job.fraction, message=job.message),
        error=None if job.error is None else Problem.model_validate(job.error),
        promised=None if motion is None else motion.promised,
        duration=None if motion is None else motion.duration,
        runs=[] if model is None or model.campaign is None else model.campaign.runs,
    )
