"""Fields of the JSON document of an identified model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict

from dynident.robot.document import RobotDocument


class JointFields(TypedDict):
    """A joint, and whether its effort is in N m or N."""

    name: str
    kind: str
    effort_unit: str


class EffectFields(TypedDict):
    """An effect, as `EffectChoice` has it."""

    effect: str
    joints: Sequence[str]
    shape: Sequence[tuple[str, float]]
    runs: Sequence[str]


class ArgumentFields(TypedDict):
    """An argument of the torque's formula: the number of its entries, and their meaning with the unit."""

    name: str
    size: int
    meaning: str


class HysteresisFields(TypedDict):
    """A hysteresis state: its operator, the number of its joint, and its slip in rad or m."""

    operator: str
    joint: int
    slip: float


class ColumnFields(TypedDict):
    """A standard parameter: the effect and the joint that it is of, its unit, shape constants and runs."""

    name: str
    effect: str
    parameter: str
    joint: str
    unit: str
    shape: Mapping[str, float]
    runs: Sequence[str]


class ParameterFields(TypedDict):
    """A base parameter: `column` is its own column, `grouping` the weight of each column by number."""

    name: str
    value: float
    unit: str
    standard_deviation: float | None
    column: int
    grouping: Mapping[str, float]
    written: Sequence[int]
    text: str


class ModelDocument(TypedDict):
    """The whole document; `model_document` explains its fields."""

    format: str
    version: str
    robot: RobotDocument
    joints: Sequence[JointFields]
    effects: Sequence[EffectFields]
    tolerance: float
    arguments: Sequence[ArgumentFields]
    hysteresis: Sequence[HysteresisFields]
    columns: Sequence[ColumnFields]
    base_parameters: Sequence[ParameterFields]
    without_effect: Sequence[int]
    rank: int
    reference: Sequence[float]
    standard_parameters: Mapping[str, Mapping[str, float]] | None
