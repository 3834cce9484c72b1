"""`export_model`: the tables of writers, one for each format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import get_args

from dynident.errors import DynidentError
from dynident.export.actuator_files import to_isaac_lab_actuators, to_mjlab_actuators
from dynident.export.c_code import make_c_name, to_c
from dynident.export.c_header import to_c_header, to_cpp_header
from dynident.export.casadi_function import to_casadi_bytes
from dynident.export.comments_and_names import make_slug
from dynident.export.controller_load_files import to_franka_load, to_kuka_load, to_load_urdf, to_urscript
from dynident.export.export_request import LOAD_FORMATS, WHOLE_FORMATS, ExportFormat
from dynident.export.feasible_links_and_joints import ExportedFile
from dynident.export.fmu import to_fmu
from dynident.export.mjcf import to_mjcf
from dynident.export.model_json import to_json
from dynident.export.randomisation import to_randomisation
from dynident.export.ros2_package import to_ros2_package
from dynident.export.sdf import to_sdf
from dynident.export.urdf import to_urdf
from dynident.export.usd import to_usd
from dynident.identification import Identification, make_physical
from dynident.identification.identified_models.equation_of_motion import build_equation_of_motion
from dynident.identification.identified_models.fit_model import OF_COMMANDS
from dynident.identification.identified_models.remove_and_solve_again import list_held_friction
from dynident.recordings import Recording
from dynident.regressors.errors_by_phase import compute_moving_errors
from dynident.text_encoding import encode_text
from dynident.validation.contact_detection import (
    FALSE_ALARMS_AN_HOUR,
    ContactDetection,
    calibrate_contact_detection,
    explain_no_detection,
)


def export_model(
    identification: Identification,
    format: ExportFormat | str,
    *,
    nearest: bool = False,
    held_out: Sequence[Recording] = (),
    false_alarms_per_hour: float = FALSE_ALARMS_AN_HOUR,
) -> ExportedFile:
    """Return an identified model as a file for other programs.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    format : str
        "json", "urdf", "sdf", "mjcf", "usd", "fmu", "mjlab", "isaac_lab", "c", "c_header", "cpp_header", "casadi",
        "ros2", "randomisation", or for the load alone "urscript", "franka_load", "kuka_load", "load_urdf".
        Format of the file. Programs (fmu, c, c_header, cpp_header, casadi, ros2) have parameters that a robot can have:
        where the identified ones would gain energy in a simulation, they are solved again, and a note says what that
        costs. The formats json, fmu, c, c_header, cpp_header, casadi and ros2 hold every effect; urdf,
        sdf, mjcf and usd hold links, rotors, Coulomb and viscous friction (mjcf also springs), mjlab and isaac_lab
        those of the joints, randomisation all of these with their distribution, and what they leave out is in the
        file's `notes`. The last four hold the load of the effect `payload` alone, as controllers take it.
    nearest : bool
        For files of links and joints (urdf, sdf, mjcf, usd, mjlab, isaac_lab, randomisation): if no bodies that can
        exist have the identified parameters, write the nearest that can.
    held_out : sequence of Recording
        Held-out recordings without contacts: C and C++ headers then have thresholds for their observer of contacts.
    false_alarms_per_hour : float
        False alarms an hour that these thresholds are made for.

    Returns
    -------
    ExportedFile
        The file, with notes on what it could not hold.

    Raises
    ------
    DynidentError
        For an unknown format, or where the format cannot hold the model.
    """
    if format not in get_args(ExportFormat):
        raise DynidentError(
            f"there is no format {format!r}; choose from: {', '.join(get_args(ExportFormat))}",
            pointer="/format",
            title="No such format",
        )
    if format not in _WITHOUT_BASE:
        identification.model.robot.require_fixed_base(f"export as {format}")
    if format not in _PROGRAMS:
        file = WRITERS[format](identification, nearest)
        if format in WHOLE_FORMATS:
            file = replace(file, held_out_error=compute_held_out_error(identification))
        return replace(file, notes=(*file.notes, *_list_missing_torque(identification)))
    possible = make_physical(identification)
    identification = possible.identification
    notes = [*filter(None, [possible.warning, _describe_held_friction(identification)])]
    notes += _list_missing_torque(identification)
    contact = None
    if format in _HEADERS and held_out:
        contact, reason = _calibrate_contacts(identification, held_out, false_alarms_per_hour)
        notes += [f"There are no thresholds for contacts: {reason}"] if reason else []
    file = _PROGRAMS[format](identification, contact, notes)
    return replace(file, held_out_error=compute_held_out_error(identification))


def _calibrate_contacts(
    identification: Identification, held_out: Sequence[Recording], false_alarms_per_hour: float
) -> tuple[ContactDetection | None, str]:
    """Return the thresholds for contacts, or why there are none, a sentence."""
    # The header says itself why it has no observer.
    if build_equation_of_motion(identification.estimate).observer_obstacle:
        return None, ""
    try:
        contact = calibrate_contact_detection(identification, held_out, false_alarms_per_hour=false_alarms_per_hour)
        return contact, "" if contact is not None else explain_no_detection(identification, held_out)
    except DynidentError as error:
        # A rate that the caller has to mend. All else is no reason to have no header.
        if error.pointer == "/false_alarms_per_hour":
            raise
        return None, f"{error.detail}."


def _describe_held_friction(identification: Identification) -> str:
    """Describe where friction in programs differs from the identified one; empty where it does nowhere."""
    units = {joint.name: "rad/s" if joint.kind == "revolute" else "m/s" for joint in identification.model.robot.joints}
    held = [f"{name} {speed:.3g} {units[name]}" for name, speed in list_held_friction(identification)]
    if not held:
        return ""
    note = (
        "Beyond the largest speeds of the recordings of the fit the identified friction of some joints falls; here it "
        f"stays as it is at these speeds: {', '.join(held)}."
    )
    if identification.data.held_out is None:
        return note
    return f"{note} The error on held-out data is that of the identified friction, also where the motion is faster."


def compute_held_out_error(identification: Identification) -> float | None:
    """Return the relative error of a model on held-out data, where joints move; None without such data.

    Parameters
    ----------
    identification : Identification
        The identified model.
    """
    held_out = identification.data.held_out
    if held_out is None:
        return None
    return compute_moving_errors(held_out, identification.values).relative_total


# Formats that do not state how the base is mounted.
_WITHOUT_BASE = {"json", "c", "casadi"} | LOAD_FORMATS


def _list_missing_torque(identification: Identification) -> list[str]:
    """Return the notes on torques that were not recorded, where there are any."""
    joints, notes = identification.model.robot.names_without_torque, []
    if identification.data.from_commands:
        notes.append(OF_COMMANDS)
    if not joints:
        return notes
    return [
        *notes,
        f"No recording contains the torque of {joints}: the model has neither its friction nor its drive, "
        "and its torque is that of the links alone.",
    ]


def _export_json(identification: Identification, _nearest: bool) -> ExportedFile:
    content = encode_text(to_json(identification))
    return ExportedFile(f"{make_slug(identification.model.robot.name)}.json", "application/json", content)


def _export_c(identification: Identification, _: ContactDetection | None, notes: Sequence[str]) -> ExportedFile:
    content = encode_text(to_c(identification, notes))
    return ExportedFile(f"{make_c_name(identification)}.c", "text/x-c", content, tuple(notes))


def _export_casadi(identification: Identification, _: ContactDetection | None, notes: Sequence[str]) -> ExportedFile:
    name = f"{make_slug(identification.model.robot.name)}.casadi"
    return ExportedFile(name, "application/octet-stream", to_casadi_bytes(identification), tuple(notes))


_HEADERS = {"c_header": to_c_header, "cpp_header": to_cpp_header}
# Programs that compute a motion or its torque. A robot must be able to have their parameters; JSON is a record of those
# that were identified.
_PROGRAMS: Mapping[str, Callable[[Identification, ContactDetection | None, Sequence[str]], ExportedFile]] = (
    MappingProxyType(
        {
            **_HEADERS,
            "c": _export_c,
            "casadi": _export_casadi,
            "fmu": lambda identification, _, notes: to_fmu(identification, notes),
            "ros2": lambda identification, _, notes: to_ros2_package(identification, notes),
        }
    )
)

WRITERS: Mapping[str, Callable[[Identification, bool], ExportedFile]] = MappingProxyType(
    {
        "json": _export_json,
        "urdf": lambda identification, nearest: to_urdf(identification, nearest=nearest),
        "sdf": lambda identification, nearest: to_sdf(identification, nearest=nearest),
        "mjcf": lambda identification, nearest: to_mjcf(identification, nearest=nearest),
        "usd": lambda identification, nearest: to_usd(identification, nearest=nearest),
        "mjlab": lambda identification, nearest: to_mjlab_actuators(identification, nearest=nearest),
        "isaac_lab": lambda identification, nearest: to_isaac_lab_actuators(identification, nearest=nearest),
        "randomisation": lambda identification, nearest: to_randomisation(identification, nearest=nearest),
        "urscript": lambda identification, _: to_urscript(identification),
        "franka_load": lambda identification, _: to_franka_load(identification),
        "kuka_load": lambda identification, _: to_kuka_load(identification),
        "load_urdf": lambda identification, _: to_load_urdf(identification),
    }
)
