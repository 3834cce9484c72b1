"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import TypedDict


class DriftView(TypedDict):
    """Drift of an open-loop simulation under the measured torque, root mean square over many starts."""

    after: list[float]
    """s"""
    distance: list[list[float | None]]
    """rad or m, after each time, per joint"""
    joint_names: list[str]
    share: list[list[float | None]]
    """Divided by the joint's travel in that time"""
    starts: int


class EffectChoice(TypedDict):
    """An effect of the catalogue, on some joints."""

    effect: str
    """An id from GET /v1/effects"""
    joints: list[str]
    """Names of joints; by default, all joints that the effect can act on."""
    runs: list[str]
    """Names of the measurements, or labels of their runs, in which the effect acts"""
    shape_parameters: dict[str, float]
    """Shape constants; searched for if not given."""


class ErrorFigures(TypedDict):
    """Errors of a model on rows: rms in N m or N, relative as ||y − ŷ|| / ||y||; null if a joint has no such row."""

    relative: list[float | None]
    """Per joint"""
    relative_total: float | None
    rms: list[float | None]
    """Per joint"""


class ErrorsView(TypedDict):
    """Errors of a model on data: on all rows; at standstill, the distance to the range of static friction."""

    moving: ErrorFigures | None
    """On the rows where each joint moves; null if not computed"""
    relative: list[float | None]
    """Per joint"""
    relative_total: float | None
    rms: list[float | None]
    """Per joint"""
    sigma: list[float | None] | None
    """Standard deviation of the residual per joint"""


class UsedPreprocessing(TypedDict):
    """The filters that were used, and why."""

    decimation: int
    filter_order: int
    position_cutoff: float | None
    reasons: list[str]
    torque_cutoff: float | None
