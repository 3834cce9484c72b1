"""Design of exciting experiments: criteria, trajectories that minimise them, and sets of runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.excitation.criteria.criterion_choice import CRITERIA, CriterionChoice
    from dynident.excitation.criteria.optimality_criteria import Baseline, CriterionValues
    from dynident.excitation.criteria.parameter_variances import ExpectedParameter
    from dynident.excitation.criteria.prediction_region import Region, collect_region, draw_region
    from dynident.excitation.design_files import (
        FORMATS,
        design_document,
        design_table,
        slow_down,
        trajectory_document,
        write_design,
    )
    from dynident.excitation.design_request import KINDS, DesignRequest, TrajectoryRequest
    from dynident.excitation.design_result import Design, Run
    from dynident.excitation.experiment_design import Rehearsal, design_experiment, rehearse_motion, rehearse_quickly

__all__ = [
    "CRITERIA",
    "FORMATS",
    "KINDS",
    "Baseline",
    "CriterionChoice",
    "CriterionValues",
    "Design",
    "DesignRequest",
    "ExpectedParameter",
    "Region",
    "Rehearsal",
    "Run",
    "TrajectoryRequest",
    "collect_region",
    "design_document",
    "design_experiment",
    "design_table",
    "draw_region",
    "rehearse_motion",
    "rehearse_quickly",
    "slow_down",
    "trajectory_document",
    "write_design",
]

if not TYPE_CHECKING:
    # What can be asked is declared in this package, too: who reads that does not wait for what answers it.
    __getattr__, __dir__ = make_lazy_exports(__name__)
