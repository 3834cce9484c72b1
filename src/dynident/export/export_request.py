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
    "ros2",
    "randomisation",
    "urscript",
    "franka_load",
    "kuka_load",
    "load_urdf",
]
FORMATS = OneOf(
    Choice("json", "JSON", "robot, effects, parameters, groupings, units: the whole model"),
    Choice("urdf", "URDF", "links, Coulomb and viscous friction; rotor inertia in an element of its own"),
    Choice("sdf", "SDF", "links, damping, friction; rotor inertia for Drake"),
    Choice("mjcf", "MJCF", "links, rotors, Coulomb and viscous friction, joint springs"),
    Choice("usd", "USD", "links; friction and rotors as attributes of PhysX"),
    Choice("fmu", "FMU (FMI 3)", "forward dynamics with every effect, for FMI 3"),
    Choice("mjlab", "Actuators for mjlab", "actuators: rotors, friction"),
    Choice("isaac_lab", "Actuators for Isaac Lab", "actuators: rotors, friction"),
    Choice("c", "C code", "the torque with every effect, in one function"),
    Choice("c_header", "C header with every term", "separate functions for every term, and a load at run time"),
    Choice("cpp_header", "C++ header with every term", "the same as a class"),
    Choice("casadi", "CasADi", "the torque with every effect, as an expression"),
    Choice("ros2", "ROS 2 package", "a controller and its core around the C++ header, with every effect"),
    Choice(
        "randomisation",
        "Drawn models for simulators",
        "distribution of links, rotors and friction, and a torque disturbance",
    ),
    Choice("urscript", "Identified load, URScript", "mass, centre of mass and inertia of the load"),
    Choice("franka_load", "Identified load, libfranka", "mass, centre of mass and inertia of the load"),
    Choice("kuka_load", "Identified load, KUKA load data", "mass, centre of mass and inertia of the load"),
    Choice("load_urdf", "Identified load, URDF link", "mass, centre of mass and inertia of the load"),
)
LOAD_FORMATS = frozenset({"urscript", "franka_load", "kuka_load", "load_urdf"})
"""Formats of an identified load alone; the others are of the whole model."""
WHOLE_FORMATS = frozenset({"json", "fmu", "c", "c_header", "cpp_header", "casadi", "ros2"})
"""Formats that hold every effect, so that their error is that of the model."""
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
    ".zip": "ros2",
    ".npz": "randomisation",
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
        "json", "urdf", "sdf", "mjcf", "usd", "fmu", "mjlab", "isaac_lab", "c", "c_header", "cpp_header", "casadi",
        "ros2", "randomisation", or for the load alone "urscript", "franka_load", "kuka_load", "load_urdf".
        Format of the file.
    nearest : bool
        For files of links and joints (urdf, sdf, mjcf, usd, mjlab, isaac_lab, randomisation): where no bodies that can
        exist have the identified parameters, write the nearest that can.
    anyway : bool
        Whether a model whose error says that it is not to be used is written, too.
    """

    format: ExportFormat = declare_field("Format of the file", default="json", kinds=FORMATS)
    nearest: bool = declare_field(
        "urdf, sdf, mjcf, usd, mjlab, isaac_lab, randomisation: if the identified parameters are not physically "
        "feasible, write the nearest feasible ones, which changes the torque",
        default=False,
    )
    anyway: bool = declare_field("Export the model even if its error is too large to use it", default=False)
