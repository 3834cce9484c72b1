"""Write rotors and friction as actuators in Python: for mjlab beside the MJCF, for Isaac Lab beside the USD."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynident.export.comments_and_names import SIGNS, describe_identification, describe_origin, make_slug
from dynident.export.feasible_links_and_joints import ExportedFile, FeasibleLinks, check_is_tree
from dynident.export.mjcf import complete_mjcf_links
from dynident.export.usd import HELD_ROLES, name_prims
from dynident.identification import Identification
from dynident.text_encoding import encode_text

_NO_LIMIT = 1e9
"""Effort, in N m or N, that stands for a limit that is not known: both programs demand a number."""


def to_mjlab_actuators(identification: Identification, *, nearest: bool = False) -> ExportedFile:
    """Return rotors and friction as actuators for mjlab, for use with the exported MJCF.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    nearest : bool
        If no bodies that can exist have the identified parameters, write the nearest that can.

    Returns
    -------
    ExportedFile
        A Python file, with notes on what it could not hold.

    Raises
    ------
    DynidentError
        As `to_mjcf` does.
    """
    check_is_tree(identification, "mjlab's actuators")
    links = complete_mjcf_links(identification, nearest=nearest)
    notes = (
        "The values are those of the exported MJCF. Gains of a position controller are not identified.",
        *links.notes,
    )
    values = _list_values(links, ("armature", "frictionloss", "viscous_damping", "effort_limit"))
    table = _write_table({name: values[name] for name in links.robot.joint_names})
    return _write_file(identification, "mjlab_actuators.py", notes, _MJLAB.replace("TABLE", table))


def to_isaac_lab_actuators(identification: Identification, *, nearest: bool = False) -> ExportedFile:
    """Return rotors and friction as actuators for Isaac Lab, for use with the exported USD.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    nearest : bool
        If no bodies that can exist have the identified parameters, write the nearest that can.

    Returns
    -------
    ExportedFile
        A Python file, with notes on what it could not hold.

    Raises
    ------
    DynidentError
        As `to_usd` does.
    """
    check_is_tree(identification, "Isaac Lab's actuators")
    links = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest)
    notes = (
        "The values are those of the exported USD. Gains of a position controller are not identified. Friction is a "
        "torque, as in Isaac Sim 5.0 and later; earlier versions take a coefficient without unit.",
        *links.notes,
    )
    values = _list_values(links, ("armature", "dynamic_friction", "viscous_friction", "effort_limit"))
    table = _write_table({
        prim: values[name] for prim, name in zip(name_prims(links.robot)[1], links.robot.joint_names, strict=True)
    })  # fmt: skip
    return _write_file(identification, "isaac_lab_actuators.py", notes, _ISAAC_LAB.replace("TABLE", table))


def _list_values(links: FeasibleLinks, fields: tuple[str, str, str, str]) -> dict[str, dict[str, float]]:
    """Return by joint the rotor, Coulomb and viscous friction, and effort, under the names of these fields."""
    standard = links.standard
    return {
        joint.name: dict(
            zip(
                fields,
                (
                    float(standard.rotors[j]),
                    float(standard.coulomb[j]),
                    float(standard.viscous[j]),
                    _NO_LIMIT if joint.limits.effort is None else float(joint.limits.effort),
                ),
                strict=True,
            )
        )
        for j, joint in enumerate(links.robot.joints)
    }


def _write_table(values: Mapping[str, Mapping[str, float]]) -> str:
    rows = "".join(f"    {name!r}: {dict(row)!r},\n" for name, row in values.items())
    return f"{{\n{rows}}}"


def _write_file(identification: Identification, ending: str, notes: Sequence[str], code: str) -> ExportedFile:
    lines = [f"Identified actuators, {describe_origin()}.", *describe_identification(identification), SIGNS, *notes]
    head = "\n".join(f"# {' '.join(line.split())}" for line in lines)
    name = f"{make_slug(identification.model.robot.name)}_{ending}"
    return ExportedFile(name, "text/x-python", encode_text(f"{head}\n{code}"), tuple(notes))


_MJLAB = '''\
import re

import mujoco
from mjlab.actuator import BuiltinMotorActuatorCfg, BuiltinPdActuatorCfg

# Armature in kg m^2 (kg), friction and effort in N m (N), damping in N m s/rad (N s/m)
JOINTS = TABLE


def load_spec(path):
    """Load the exported MJCF without its motors, in whose place mjlab puts its actuators."""
    spec = mujoco.MjSpec.from_file(path)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    return spec


def torque_actuators():
    """Return one motor a joint, whose command is its torque."""
    return tuple(
        BuiltinMotorActuatorCfg(target_names_expr=(re.escape(name),), **joint) for name, joint in JOINTS.items()
    )


def position_actuators(stiffness, damping):
    """Return one position controller a joint, with gains (dictionaries by joint) of your controller."""
    return tuple(
        BuiltinPdActuatorCfg(
            target_names_expr=(re.escape(name),), stiffness=stiffness[name], damping=damping[name], **joint
        )
        for name, joint in JOINTS.items()
    )
'''

_ISAAC_LAB = '''\
from isaaclab.actuators import DelayedPDActuatorCfg, ImplicitActuatorCfg

# Armature in kg m^2 (kg), friction and effort in N m (N), viscous friction in N m s/rad (N s/m)
JOINTS = TABLE


def _collect(field):
    return {name: joint[field] for name, joint in JOINTS.items()}


def _identified():
    return {
        "joint_names_expr": list(JOINTS),
        "effort_limit_sim": _collect("effort_limit"),
        "armature": _collect("armature"),
        # Static and sliding friction are equal: the model has one value for both.
        "friction": _collect("dynamic_friction"),
        "dynamic_friction": _collect("dynamic_friction"),
        "viscous_friction": _collect("viscous_friction"),
    }


def torque_actuators():
    """Return the joints without a position controller: the command is the torque."""
    return {"arm": ImplicitActuatorCfg(stiffness=0.0, damping=0.0, **_identified())}


def position_actuators(stiffness, damping):
    """Return the joints with the physics engine's position controller, with the gains of yours."""
    return {"arm": ImplicitActuatorCfg(stiffness=stiffness, damping=damping, **_identified())}


def delayed_actuators(stiffness, damping, min_delay, max_delay):
    """Return the joints with a position controller whose commands are late by steps of the simulation."""
    return {
        "arm": DelayedPDActuatorCfg(
            stiffness=stiffness,
            damping=damping,
            min_delay=min_delay,
            max_delay=max_delay,
            effort_limit=_collect("effort_limit"),
            **_identified(),
        )
    }
'''
