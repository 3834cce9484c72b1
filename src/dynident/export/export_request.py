"""The request of an export: the formats that are offered, their file endings and options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dynident.schema.fields import Choice, OneOf, Request, declare_field

ExportFormat = Literal[
    "json",
    "urdf",
    "sdf",
    "mjcf",
    "usd",
    "fmu",
    "mjlab",
    "isaac_lab",
    "c",
    "c_header",
    "cpp_header",
    "casadi",
    "urscript",
    "franka_load",
    "kuka_load",
    "load_urdf",
]
FORMATS = OneOf(
    Choice("json", "JSON"),
    Choice("urdf", "URDF"),
    Choice("sdf", "SDF"),
    Choice("mjcf", "MJCF"),
    Choice("usd", "USD"),
    Choice("fmu", "FMU (FMI 3)"),
    Choice("mjlab", "Actuators for mjlab"),
    Choice("isaac_lab", "Actuators for Isaac Lab"),
    Choice("c", "C code"),
    Choice("c_header", "C header with every term"),
    Choice("cpp_header", "C++ header with every term"),
    Choice("casadi", "CasADi"),
    Choice("urscript", "Identified load, URScript"),
    Choice("franka_load", "Identified load, libfranka"),
    Choice("kuka_load", "Identified load, KUKA load data"),
    Choice("load_urdf", "Identified load, URDF link"),
)
LOAD_FORMATS = frozenset({"urscript", "franka_load", "kuka_load", "load_urdf"})
"""Formats of an identified load alone; the others are of the whole model."""
ENDINGS: dict[str, ExportFormat] = {
    ".json": "json",
    ".urdf": "urdf",
    ".sdf": "sdf",
    ".xml": "mjcf",
    ".mjcf": "mjcf",
    ".usda": "usd",
    ".fmu": "fmu",
    ".c": "c",
    ".h": "c_header",
    ".hpp": "cpp_header",
    ".casadi": "casadi",
    ".script": "urscript",
    ".dat": "kuka_load",
}
"""Format of a file by the ending of its name."""


@dataclass(frozen=True)
class ExportChoices(Request):
    """What a model is written as.

    Parameters
    ----------
    format : str
        "json", "urdf", "sdf", "mjcf", "usd", "fmu", "mjlab", "isaac_lab", "c", "c_header", "cpp_header", "casadi", or
        for the load alone "urscript", "franka_load", "kuka_load", "load_urdf".
        Format of the file.
    nearest : bool
        For files of links and joints (urdf, sdf, mjcf, usd, mjlab, isaac_lab): where no bodies that can exist have the
        identified parameters, write the nearest that can.
    anyway : bool
        Whether a model whose error says that it is not to be used is written, too.
    """

    format: ExportFormat = declare_field("Format of the file", default="json", kinds=FORMATS)
    nearest: bool = declare_field(
        "urdf, sdf, mjcf, usd, mjlab, isaac_lab: if the identified parameters are not physically feasible, write the "
        "nearest feasible ones, which changes the torque",
        default=False,
    )
    anyway: bool = declare_field("Export the model even if its error is too large to use it", default=False)
