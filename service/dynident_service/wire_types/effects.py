"""The catalogue of effects on the wire."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dynident_service.wire_types.common import ViewModel


class EffectParameter(ViewModel):
    """One parameter of an effect."""

    name: str
    unit: str = Field(description="On a revolute joint")
    prismatic_unit: str
    description: str


class ShapeWord(ViewModel):
    """The meaning of a value of a constant that selects a kind."""

    value: float
    word: str


class ShapeParameter(ViewModel):
    """A constant inside an effect's columns; it is searched for, because the torque is not linear in it."""

    name: str
    unit: str
    description: str
    default: float
    words: list[ShapeWord] = Field(description="Empty if the constant is a number")


class EffectView(ViewModel):
    """A physical cause of joint torque."""

    id: str
    title: str
    formula: str = Field(description="LaTeX")
    parameters: list[EffectParameter]
    shape_parameters: list[ShapeParameter]
    signature: str = Field(description="What the effect leaves in the residual if a model lacks it")
    sources: list[str]
    confused_with: list[str]
    scope: Literal["joint", "robot"]
    hardware: str = Field(default="", description="The part that the effect is of, if only some robots have it")
    appearance: str = Field(default="", description="What the data show of such an effect, whatever its cause")


class Catalogue(ViewModel):
    """All effects."""

    items: list[EffectView]
