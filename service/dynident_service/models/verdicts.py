"""Verdicts of models on the wire."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dynident_service.models.common import ViewModel
from dynident_service.models.identifications import ErrorsView
from dynident_service.models.measurements import RevisionRequest


class UseView(ViewModel):
    """Whether the model is fit for a use."""

    use: Literal["simulation", "feed_forward", "collision_detection", "payload"]
    fit: bool = Field(description="Whether it may be used so, if only within the limit that the reason says")
    state: Literal["yes", "limited", "no", "not_judged"] = Field(
        description="limited: fit within a limit; not_judged: nothing was there to tell by"
    )
    reason: str
    next_step: str = Field(description="One thing to do next")


class DriftView(ViewModel):
    """How far a simulation is off that is left alone under the measured torque, root mean square over many starts.

    null where it diverged, or where no stretch of the held-out data is that long.
    """

    joint_names: list[str]
    after: list[float] = Field(description="s")
    distance: list[list[float | None]] = Field(description="rad or m, after each time, per joint")
    share: list[list[float | None]] = Field(description="Of the way that the joint made meanwhile")
    starts: int


class DetectableForceView(ViewModel):
    """The force at the tool that shows above what the model leaves, at one false alarm an hour."""

    force: float = Field(description="N, in 95 % of the directions and the postures of the held-out motion")
    thresholds: list[float | None] = Field(
        description="Of every joint's residual behind the model's filters, N m or N; null: it moves too seldom"
    )
    seconds: float = Field(description="Of held-out motion that this comes from")


class StopView(ViewModel):
    """The most probable cause of a gross mistake."""

    cause: str
    measurement_id: str | None = Field(default=None, description="Where the mistake is, as far as that is known")
    apply: RevisionRequest | None = Field(
        default=None, description="What cures it: a body for POST /v1/measurements/{measurement_id}/revisions"
    )


class CommonView(ViewModel):
    """What held-out data share with those of the fit."""

    held_out_id: str
    fitted_id: str
    kind: Literal["copied", "repeated"] = Field(description="The same samples, or the same motion once more")
    share: float = Field(description="Of the moving time, 0 to 1")
    detail: str


class VerdictView(ViewModel):
    """What a model is fit for, and why or why not."""

    uses: list[UseView]
    held_out: ErrorsView | None = Field(description="What it was judged by; null without held-out data")
    stop: StopView | None = Field(description="Why it is not to be used at all; null if it may be used")
    summary: str
    common: list[CommonView] = Field(description="What held-out data share with those of the fit")
    drift: DriftView | None = Field(default=None, description="null where no simulation was made")
    force: DetectableForceView | None = Field(default=None, description="null where the data do not tell")
    mass: float | None = Field(default=None, description="kg at the tool from which on a load shows; null: not told")
    next_steps: list[str] = Field(description="What to do about the error, in the order of what it usually costs")
