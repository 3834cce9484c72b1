"""Texts on a model's origin and effects for exported files, and names and comments that are safe in C and XML."""

from __future__ import annotations

import re
from dataclasses import dataclass

from dynident.effects import EffectChoice
from dynident.effects.effect_text_format import format_constant
from dynident.identification import Identification
from dynident.number_format import format_percent
from dynident.version import __version__

_LONGEST = 40


def make_slug(name: str) -> str:
    """Return the name in characters for file names and identifiers: lower case letters, digits, underscores."""
    # A name of other letters alone leaves nothing; the file still needs one.
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")[:_LONGEST].strip("_")
    return words or "robot"


def escape_c_comment(text: str) -> str:
    """Return text that is safe in a C comment: no comment marks, trigraphs or unprintable characters."""
    # Repeat until none is left: a blank between two characters can leave a new pair, as in "**//".
    for pair in ("*/", "/*", "??"):
        while pair in text:
            text = text.replace(pair, " ".join(pair))
    return replace_unprintable(text)


def escape_xml_comment(text: str) -> str:
    """Return text that may stand in an XML comment."""
    while "--" in text:
        text = text.replace("--", "- -")
    return replace_unprintable(text).rstrip("-")


def replace_unprintable(text: str) -> str:
    """Return the text with a blank for every character that cannot be seen."""
    return "".join(character if character.isprintable() else " " for character in text)


SIGNS = (
    "Torque is the motor's torque at the joint, positive where q grows: N m for a revolute joint, N for a prismatic "
    "joint."
)


@dataclass(frozen=True)
class JointLine:
    """One joint in a list for people: number from 1, name, kind, unit of its torque."""

    number: int
    name: str
    kind: str
    unit: str


def list_joints(identification: Identification) -> list[JointLine]:
    """Return the joints in the order of every array."""
    joints = identification.model.robot.joints
    return [JointLine(k + 1, joint.name, joint.kind, joint.effort_unit) for k, joint in enumerate(joints)]


def describe_origin() -> str:
    """Return the program and version that wrote the file."""
    return f"written by dynident {__version__}"


def describe_identification(identification: Identification) -> list[str]:
    """Return lines on the data, methods, error, effects and warnings of a model."""
    choices = identification.choices
    lines = [
        f"Robot: {identification.model.robot.name}",
        f"Identified from: {', '.join(identification.data.measurement_names) or 'data without a name'}",
        f"Model {choices.model}, strategy {choices.strategy}, estimator {choices.solver.name_with_options}; "
        f"{identification.model.n_parameters} base parameters from {identification.n_equations} equations",
        "Relative error of the torque where joints move: "
        f"{format_percent(identification.fit_judged.relative_total)} on these data"
        + _describe_held_out(identification),
    ]
    lines += [f"Effect: {describe_effect(choice)}" for choice in choices.effects]
    return lines + [f"Warning: {warning}" for warning in identification.warnings]


def describe_effect(choice: EffectChoice) -> str:
    """Return an effect with its joints, shape constants and runs: "stribeck on joint2 (vs = 0.05)"."""
    where = f" on {', '.join(choice.joints)}" if choice.joints else ""
    constants = ", ".join(format_constant(choice.effect, name, value) for name, value in choice.shape)
    runs = f" in {', '.join(choice.runs)}" if choice.runs else ""
    return f"{choice.effect}{where}{f' ({constants})' if constants else ''}{runs}"


def _describe_held_out(identification: Identification) -> str:
    if identification.held_out_judged is None:
        return ", no held-out data"
    return f", {format_percent(identification.held_out_judged.relative_total)} on held-out data"
