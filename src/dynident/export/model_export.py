"""`export_model`: the table of writers, one for each format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

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
from dynident.identification import Identification, PhysicalModel, make_physical
from dynident.recordings import Recording
from dynident.regressors.errors_by_phase import compute_moving_errors
from dynident.text_encoding import encode_text
from dynident.validation.contact_detection import FALSE_ALARMS_AN_HOUR, calibrate_contact_detection


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
    if format not in WRITERS:
        raise DynidentError(
            f"there is no format {format!r}; choose from: {', '.join(WRITERS)}",
            pointer="/format",
            title="No such format",
        )
    if format not in _WITHOUT_BASE:
        identification.model.robot.require_fixed_base(f"export as {format}")
    possible = make_physical(identification) if format in _PROGRAMS else PhysicalModel(identification)
    if format in _HEADERS:
        contact = calibrate_contact_detection(
            possible.identification, held_out, false_alarms_per_hour=false_alarms_per_hour
        ) if held_out else None  # fmt: skip
        file = _HEADERS[format](possible.identification, contact)
        if held_out and contact is None:
            note = "There are no thresholds for contacts: the recordings have less than 15 s of motion."
            file = replace(file, notes=(*file.notes, note))
    else:
        file = WRITERS[format](possible.identification, nearest)
    if format in WHOLE_FORMATS:
        file = replace(file, held_out_error=compute_held_out_error(possible.identification))
    if possible.note:
        file = replace(file, notes=(possible.note, *file.notes))
    return _add_notes(file, identification)


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


_HEADERS = {"c_header": to_c_header, "cpp_header": to_cpp_header}
# Programs that compute a motion or its torque. A robot must be able to have their parameters; JSON is a record of those
# that were identified.
_PROGRAMS = WHOLE_FORMATS - {"json"}
# Formats that do not state how the base is mounted.
_WITHOUT_BASE = {"json", "c", "casadi"} | LOAD_FORMATS


def _add_notes(file: ExportedFile, identification: Identification) -> ExportedFile:
    """Add the notes that apply to the model in every format."""
    joints = identification.model.robot.joints_without_torque
    if not joints:
        return file
    note = (
        f"No recording contains the torque of {', '.join(joints)}: the model has neither its friction nor its drive, "
        "and its torque is that of the links alone."
    )
    return replace(file, notes=(*file.notes, note))


def _export_json(identification: Identification, _nearest: bool) -> ExportedFile:
    content = encode_text(to_json(identification))
    return ExportedFile(f"{make_slug(identification.model.robot.name)}.json", "application/json", content)


def _export_c(identification: Identification, _nearest: bool) -> ExportedFile:
    return ExportedFile(f"{make_c_name(identification)}.c", "text/x-c", encode_text(to_c(identification)))


def _export_casadi(identification: Identification, _nearest: bool) -> ExportedFile:
    name = f"{make_slug(identification.model.robot.name)}.casadi"
    return ExportedFile(name, "application/octet-stream", to_casadi_bytes(identification))


WRITERS: Mapping[str, Callable[[Identification, bool], ExportedFile]] = MappingProxyType(
    {
        "json": _export_json,
        "urdf": lambda identification, nearest: to_urdf(identification, nearest=nearest),
        "sdf": lambda identification, nearest: to_sdf(identification, nearest=nearest),
        "mjcf": lambda identification, nearest: to_mjcf(identification, nearest=nearest),
        "usd": lambda identification, nearest: to_usd(identification, nearest=nearest),
        "fmu": lambda identification, _: to_fmu(identification),
        "mjlab": lambda identification, nearest: to_mjlab_actuators(identification, nearest=nearest),
        "isaac_lab": lambda identification, nearest: to_isaac_lab_actuators(identification, nearest=nearest),
        "c": _export_c,
        "c_header": lambda identification, _: to_c_header(identification),
        "cpp_header": lambda identification, _: to_cpp_header(identification),
        "casadi": _export_casadi,
        "ros2": lambda identification, _: to_ros2_package(identification),
        "randomisation": lambda identification, nearest: to_randomisation(identification, nearest=nearest),
        "urscript": lambda identification, _: to_urscript(identification),
        "franka_load": lambda identification, _: to_franka_load(identification),
        "kuka_load": lambda identification, _: to_kuka_load(identification),
        "load_urdf": lambda identification, _: to_load_urdf(identification),
    }
)
