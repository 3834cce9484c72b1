"""The experiment that would decide what a diagnosis leaves open, and campaigns of runs until a goal is reached."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.advice.campaign import (
        CampaignRun,
        CampaignState,
        PlannedRun,
        add_run,
        plan_run,
        start_campaign,
    )
    from dynident.advice.campaign_request import CampaignRequest, Decision
    from dynident.advice.discriminating_experiments import AdvisedDiagnosis, NextExperiment, Separation
    from dynident.advice.next_experiment import advise, decide_doubts

__all__ = [
    "AdvisedDiagnosis",
    "CampaignRequest",
    "CampaignRun",
    "CampaignState",
    "Decision",
    "NextExperiment",
    "PlannedRun",
    "Separation",
    "add_run",
    "advise",
    "decide_doubts",
    "plan_run",
    "start_campaign",
]

if not TYPE_CHECKING:
    # The types of results are read without the planning of motions.
    __getattr__, __dir__ = make_lazy_exports(__name__)
