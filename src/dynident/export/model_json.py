"""A model as a JSON document from which its prediction is computed again: written and read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.errors import DynidentError
from dynident.export.casadi_function import build_torque_formula
from dynident.export.feasible_completion import complete_parameters
from dynident.export.torque_predictor import PredictingModel
from dynident.identification import Identification
from dynident.regressors.base_parameters import BaseParameters
from dynident.regressors.model_structure import build_model
from dynident.robot.description_and_json import RobotDocument, robot_from_document, robot_to_document
from dynident.robot.json_fields import parse_json
from dynident.robot.robot_model import INERTIAL_NAMES
from dynident.version import __version__


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
    """The whole document; `model_to_document` explains its fields."""

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
    warnings: Sequence[str]


FORMAT = "dynident model 1"
TITLE = "Unreadable model"


def model_to_document(identification: Identification) -> ModelDocument:
    """Return JSON values of the identified model: what predicts, and what people and other programs read.

    `columns` are all standard parameters with their units; `grouping` has the weight of each in every base parameter
    (base parameter = Σ weight x standard parameter), zeros left out; `standard_parameters` are a feasible full
    set that gives the same base parameters, where there is one.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.

    Returns
    -------
    ModelDocument
        Values of which JSON consists, by the names of the fields.
    """
    model, base = identification.model, identification.model.base
    formula = build_torque_formula(identification.estimate)
    return {
        "format": FORMAT,
        "version": __version__,
        "robot": robot_to_document(model.robot),
        "joints": [
            {"name": joint.name, "kind": joint.kind, "effort_unit": joint.effort_unit} for joint in model.robot.joints
        ],
        "effects": [
            {"effect": choice.effect, "joints": choice.joints, "shape": choice.shape, "runs": choice.runs}
            for choice in model.effects
        ],
        "tolerance": identification.choices.tolerance,
        "arguments": [
            {"name": argument.name, "size": argument.size, "meaning": argument.meaning}
            for argument in formula.arguments
        ],
        "hysteresis": [
            {"operator": signal.operator.name, "joint": signal.joint, "slip": signal.slip} for signal in formula.memory
        ],
        "columns": [
            {
                "name": column.name,
                "effect": column.effect,
                "parameter": column.parameter,
                "joint": column.link,
                "unit": column.unit,
                "shape": dict(column.shape),
                "runs": list(column.runs),
            }
            for column in model.columns
        ],
        "base_parameters": [
            {
                "name": parameter.name,
                "value": parameter.value,
                "unit": parameter.unit,
                "standard_deviation": parameter.standard_deviation
                if math.isfinite(parameter.standard_deviation)
                else None,
                "column": base.kept[k],
                "grouping": {str(c): float(base.grouping[k, c]) for c in np.flatnonzero(base.grouping[k])},
                "written": [int(c) for c in np.flatnonzero(base.written[k])],
                "text": parameter.grouping,
            }
            for k, parameter in enumerate(identification.parameters)
        ],
        "without_effect": list(base.without_effect),
        "rank": base.rank,
        "reference": identification.estimate.reference.vector.tolist(),
        "standard_parameters": _list_standard_parameters(identification),
        "warnings": list(identification.warnings),
    }


def to_json(identification: Identification) -> str:
    """Return the document of the identified model as JSON text; `model_from_json` reads it.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.

    Returns
    -------
    str
        JSON, with an indentation of one blank.
    """
    return json.dumps(model_to_document(identification), indent=1)


def model_from_json(text: str) -> PredictingModel:
    """Return the model of a document that `to_json` wrote, or that is under "model" in a larger one.

    Parameters
    ----------
    text : str
        JSON text.

    Returns
    -------
    PredictingModel
        The model, which predicts the same torque.

    Raises
    ------
    DynidentError
        If the text is something else.
    """
    document = parse_json(text, "", TITLE)
    if isinstance(document, Mapping) and "format" not in document:
        document = document.get("model")
    if not isinstance(document, Mapping) or document.get("format") != FORMAT:
        raise DynidentError(f'this is not a model of the format "{FORMAT}"', pointer="/format", title=TITLE)
    try:
        return _model_from_document(document)
    except DynidentError:
        raise
    # A document from elsewhere may lack anything at any place: all of that is one error for the user.
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise DynidentError(f"the model cannot be read: {type(error).__name__} {error}", title=TITLE) from error


def _model_from_document(document: Mapping[str, Any]) -> PredictingModel:
    robot = robot_from_document(document["robot"])
    effects = tuple(
        EffectChoice(
            choice["effect"],
            tuple(choice["joints"]),
            tuple((str(name), float(value)) for name, value in choice["shape"]),
            tuple(choice["runs"]),
        )
        for choice in document["effects"]
    )
    names = tuple(str(column["name"]) for column in document["columns"])
    parameters = document["base_parameters"]
    grouping = np.zeros((len(parameters), len(names)))
    written = np.zeros(grouping.shape, dtype=bool)
    for k, parameter in enumerate(parameters):
        for column, weight in parameter["grouping"].items():
            grouping[k, int(column)] = float(weight)
        written[k, parameter["written"]] = True
    # The grouping is stored rather than computed again: it depends on rounding, and the values only mean something
    # together with the grouping that they were identified with.
    base = BaseParameters(
        names=names,
        kept=tuple(int(parameter["column"]) for parameter in parameters),
        grouping=grouping,
        written=written,
        without_effect=tuple(int(column) for column in document["without_effect"]),
        rank=int(document["rank"]),
    )
    model = build_model(robot, effects, tolerance=float(document["tolerance"]), base=base)
    # The stored grouping counts columns by number. A catalogue with other columns would mix up the parameters.
    if tuple(column.name for column in model.columns) != names:
        raise DynidentError("the catalogue of this version has other columns for these effects", title=TITLE)
    values = np.array([float(parameter["value"]) for parameter in parameters])
    if not len(values):
        raise ValueError("no base parameters")
    reference = ReferenceParameters.from_vector(np.array(document["reference"], dtype=float), robot)
    return PredictingModel(model, values, reference)


def _list_standard_parameters(identification: Identification) -> dict[str, dict[str, float]] | None:
    """Return a feasible full set of standard parameters by link; None if there is none."""
    try:
        completion = complete_parameters(identification)
    except DynidentError:
        return None
    robot = identification.model.robot.tree
    return {
        joint.name: {
            **{name: float(value) for name, value in zip(INERTIAL_NAMES, completion.inertias[j], strict=True)},
            "Ia": float(completion.rotors[j]),
            "Fc": float(completion.coulomb[j]),
            "Fv": float(completion.viscous[j]),
        }
        for j, joint in enumerate(robot.joints)
    }
