"""Experiments that excite: trajectories, criteria, limits, and the design of both together."""

from dynident.excitation.baseline import Baseline
from dynident.excitation.criteria import CRITERIA, CriterionChoice, CriterionValues
from dynident.excitation.design import design_experiment
from dynident.excitation.expected import ExpectedParameter
from dynident.excitation.export import FORMATS, design_document, design_table, trajectory_document, write_design
from dynident.excitation.limits import ImpossibleLimitsError
from dynident.excitation.margins import Margin
from dynident.excitation.quick import quick_motion
from dynident.excitation.request import KINDS, Design, DesignRequest, Run, TrajectoryRequest
from dynident.excitation.surroundings import Box, Surroundings, ToolRange, Wall

__all__ = [
    "CRITERIA",
    "FORMATS",
    "KINDS",
    "Baseline",
    "Box",
    "CriterionChoice",
    "CriterionValues",
    "Design",
    "DesignRequest",
    "ExpectedParameter",
    "ImpossibleLimitsError",
    "Margin",
    "Run",
    "Surroundings",
    "ToolRange",
    "TrajectoryRequest",
    "Wall",
    "design_document",
    "design_experiment",
    "design_table",
    "quick_motion",
    "trajectory_document",
    "write_design",
]
