"""Answers of verdicts."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dynident_service.identifications.wire_types import ErrorsView
from dynident_service.measurements.wire_types import RevisionRequest
from dynident_service.shared.wire_types import ViewModel, WithTables
from dynident_service.validations.wire_types import DriftView


class UseView(ViewModel):
    """Whether the model is fit for a use."""

    use: Literal["simulation", "feed_forward", "collision_detection", "payload"]
    fit: bool = Field(description="Whether it may be used so, at least within the limit that the reason names")
    state: Literal["yes", "limited", "no", "not_judged"] = Field(
        description="limited: fit within a limit; not_judged: there are no data to judge by"
    )
    reason: str
    next_step: str = Field(description="The next thing to do")
    next_action: (
        Literal[
            "diagnose",
            "design",
            "identify_feasible",
            "check_gains",
            "identify_gains",
            "export_for_simulation",
            "export_for_feed_forward",
            "observe_momentum",
            "weigh_load",
        ]
        | None
    ) = Field(description="Which action of dynident does it; null where none does")


class DetectableForceView(ViewModel):
    """The smallest force at the tool that is detected with one false alarm per hour."""

    force: float = Field(description="N, in 95 % of the directions and postures of the held-out motion")
    thresholds: list[float | None] = Field(
        description="Thresholds for every joint's filtered residual, N m or N; null: the joint moves too seldom"
    )
    seconds: float = Field(description="Duration of the held-out motion that it was computed from")


class ContactDetectionView(ViewModel):
    """Thresholds of a momentum observer, and the force at the tool that they detect as it happens."""

    force: float = Field(description="N, in 95 % of the directions and postures of the held-out motion")
    within: float = Field(description="Seconds within which it shows")
    false_alarms_an_hour: float
    gain: float = Field(description="Bandwidth of the observer, 1/s")
    speeds: list[list[float | None]] = Field(description="rad/s or m/s between three classes of speed, per joint")
    thresholds: list[list[float | None]] = Field(
        description="N m or N, per joint: slow or just slow before, then by class of speed; null: too few data"
    )
    seconds: float = Field(description="Duration of the held-out motion that it was computed from")


class StopView(ViewModel):
    """The most probable cause of a large error."""

    cause: str
    measurement_id: str | None = Field(default=None, description="Place of the fault, as far as it is known")
    apply: RevisionRequest | None = Field(
        default=None, description="Correction: a body for POST /v1/measurements/{measurement_id}/revisions"
    )


class CommonView(ViewModel):
    """What held-out data have in common with the data of the fit."""

    held_out_id: str
    fitted_id: str
    kind: Literal["copied", "repeated"] = Field(description="The same samples, or the same motion once more")
    share: float = Field(description="Of the moving time, 0 to 1")
    detail: str


class VerdictView(WithTables):
    """What a model is fit for, and why or why not."""

    uses: list[UseView]
    held_out: ErrorsView | None = Field(description="The data that it was judged by; null without held-out data")
    stop: StopView | None = Field(description="Why it must not be used at all; null if it may be used")
    summary: str
    common: list[CommonView] = Field(description="What held-out data have in common with the data of the fit")
    drift: DriftView | None = Field(default=None, description="null if there was no simulation")
    force: DetectableForceView | None = Field(default=None, description="null if the data do not determine it")
    contact: ContactDetectionView | None = Field(
        default=None, description="null if the model or the data allow no momentum observer"
    )
    mass: float | None = Field(default=None, description="Smallest load at the tool that is visible, kg; null: unknown")
    next_steps: list[str] = Field(description="What to do about the error, the usually cheapest first")
