"""Verdicts of models on the wire."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dynident_service.models.common import Shown
from dynident_service.models.identifications import ErrorsView
from dynident_service.models.revisions import RevisionRequest


class UseView(Shown):
    """Whether the model is fit for a use."""

    use: Literal["simulation", "feed_forward", "collision_detection", "payload"]
    fit: bool
    reason: str


class StopView(Shown):
    """The most probable cause of a gross mistake."""

    cause: str
    measurement_id: str | None = Field(default=None, description="Where the mistake is, as far as that is known")
    apply: RevisionRequest | None = Field(
        default=None, description="What cures it: a body for POST /v1/measurements/{measurement_id}/revisions"
    )


class CommonView(Shown):
    """What held-out data share with those of the fit."""

    held_out_id: str
    fitted_id: str
    kind: Literal["copied", "repeated"] = Field(description="The same samples, or the same motion once more")
    share: float = Field(description="Of the moving time, 0 to 1")
    detail: str


class VerdictView(Shown):
    """What a model is fit for, and why or why not."""

    uses: list[UseView]
    held_out: ErrorsView | None = Field(description="What it was judged by; null without held-out data")
    stop: StopView | None = Field(description="Why it is not to be used at all; null if it may be used")
    summary: str
    common: list[CommonView] = Field(description="What held-out data share with those of the fit")
    next_steps: list[str] = Field(description="What to do about the error, in the order of what it usually costs")
