"""Write an identified payload for controllers (URScript, Franka, KUKA, a URDF link), and friction for UR's driver.

The load is that of the effect `payload`: ten inertial parameters of its link's frame. Controllers want its mass, the
centre of mass, and the inertia about that centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.effects import Role, get_role
from dynident.errors import DynidentError
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.export.comments_and_names import describe_origin, escape_xml_comment, make_slug, replace_unprintable
from dynident.export.feasible_links_and_joints import ExportedFile
from dynident.identification import Identification
from dynident.robot.robot_model import INERTIAL_NAMES
from dynident.robot.urdf_writer import name_links
from dynident.robot.xml_text import format_numbers
from dynident.text_encoding import encode_text

_TEN = len(INERTIAL_NAMES)
_UPPER = np.triu_indices(3)
# Step of the numerical derivatives, as a share of the parameters' size.
_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class IdentifiedLoad:
    """A load with half-widths of its 95 % intervals.

    Parameters
    ----------
    link : str
        Joint whose link carries it; its frame is the one of all values.
    mass, mass_error : float
        In kg.
    centre, centre_error : (3,)
        Centre of mass in m.
    inertia, inertia_error : (3, 3) or None
        About the centre of mass in kg m²; None where the data do not determine it, or no body has it.
    notes : tuple of str
        What a user must know of it, a sentence each.
    """

    link: str
    mass: float
    mass_error: float
    centre: FloatArray
    centre_error: FloatArray
    inertia: FloatArray | None
    inertia_error: FloatArray | None
    notes: tuple[str, ...]

    def describe(self) -> list[str]:
        """Describe the load with its intervals, a line each."""
        centre = ", ".join(
            f"{1e3 * value:.4g} ± {1e3 * error:.2g}"
            for value, error in zip(self.centre, self.centre_error, strict=True)
        )
        lines = [
            f"Identified load, {describe_origin()}, in the frame of the link that {self.link} moves (± is the 95 % "
            "interval). A controller's flange may stand otherwise.",
            f"Mass {self.mass:.4g} ± {self.mass_error:.2g} kg; centre of mass {centre} mm",
        ]
        if self.inertia is not None and self.inertia_error is not None:
            parts = ", ".join(
                f"{name} {value:.3g} ± {error:.2g}"
                for name, value, error in zip(
                    ("xx", "xy", "xz", "yy", "yz", "zz"), self.inertia[_UPPER], self.inertia_error[_UPPER], strict=True
                )
            )
            lines.append(f"Inertia about the centre of mass, kg m^2: {parts}")
        return [*lines, *self.notes]


def identify_load(identification: Identification) -> IdentifiedLoad:
    """Return the load that a model was identified with.

    Parameters
    ----------
    identification : Identification
        A model with the effect `payload`.

    Returns
    -------
    IdentifiedLoad
        Mass, centre of mass and inertia, with intervals.

    Raises
    ------
    DynidentError
        Where the model has no load or more than one, or the data do not determine its mass and its centre.
    """
    model = identification.model
    loads = {(column.link, column.runs) for column in model.columns if get_role(column) == "load"}
    if len(loads) != 1:
        has = "no load" if not loads else f"{len(loads)} loads"
        raise DynidentError(
            f"the model has {has}; identify it with the effect payload on one link, from runs without and with it",
            pointer="/format",
            title="No load in the model",
        )
    columns = [k for k, column in enumerate(model.columns) if get_role(column) == "load"]
    # A parameter is known where it is a base parameter of which no other one is a part.
    rows = {
        column: model.base.kept.index(column)
        for column in columns
        if column in model.base.kept and np.count_nonzero(model.base.written[model.base.kept.index(column)]) == 1
    }
    known = np.array([column in rows for column in columns])
    if not known[6:].all():
        missing = ", ".join(model.columns[column].name for column in columns[6:] if column not in rows)
        raise DynidentError(
            f"the motion does not determine {missing} of the load; record one that turns the load about all axes",
            pointer="/format",
            title="Load not determined",
        )
    places = [rows[column] for column in columns if column in rows]
    values, covariance = np.zeros(_TEN), np.zeros((_TEN, _TEN))
    values[known] = identification.values[places]
    covariance[np.ix_(known, known)] = identification.estimate.statistics.covariance[np.ix_(places, places)]
    if not values[9] > 0:
        raise DynidentError(
            f"the load has the mass {values[9]:.3g} kg; identify with the estimator feasible",
            pointer="/format",
            title="Load not feasible",
        )
    centred = _compute_centred(values)
    steps = _STEP * np.maximum(np.abs(values), 1e-3)
    slopes = [(_compute_centred(values + step) - _compute_centred(values - step)) for step in np.diag(steps)]
    jacobian = np.array(slopes).T / (2 * steps)
    errors = NORMAL_95 * np.sqrt(np.clip(np.diag(jacobian @ covariance @ jacobian.T), 0.0, None))
    inertia, notes = _to_matrix(centred[4:]), []
    principal = np.linalg.eigvalsh(inertia)
    if not known.all():
        notes.append("The motion does not determine all moments of inertia: they are left out.")
    elif principal[0] <= 0 or principal[2] > principal[0] + principal[1]:
        notes.append("No body has the identified moments of inertia: they are left out (try the estimator feasible).")
    complete = not notes
    return IdentifiedLoad(
        next(iter(loads))[0], float(centred[0]), float(errors[0]), centred[1:4], errors[1:4],
        inertia if complete else None, _to_matrix(errors[4:]) if complete else None, tuple(notes),
    )  # fmt: skip


def _compute_centred(values: FloatArray) -> FloatArray:
    """Return mass, centre (3,) and inertia about it (6,), row by row, of parameters about a frame's origin."""
    mass, centre = values[9], values[6:9] / values[9]
    shift = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([[mass], centre, values[:6] - shift[_UPPER]])


def _to_matrix(upper: FloatArray) -> FloatArray:
    matrix = np.zeros((3, 3))
    matrix[_UPPER] = upper
    return matrix + np.triu(matrix, 1).T


def to_urscript(identification: Identification) -> ExportedFile:
    """Return the load as URScript: `set_target_payload`, with the inertia about the centre of mass if it is known.

    Parameters
    ----------
    identification : Identification
        A model with the effect `payload`.

    Returns
    -------
    ExportedFile
        The file, with notes on what it does not hold.

    Raises
    ------
    DynidentError
        As `identify_load` does.
    """
    load = identify_load(identification)
    centre = ", ".join(f"{value:.6g}" for value in load.centre)
    inertia = ""
    if load.inertia is not None:
        # UR's order: the moments, then the products of inertia xy, xz, yz.
        parts = [*np.diag(load.inertia), load.inertia[0, 1], load.inertia[0, 2], load.inertia[1, 2]]
        inertia = f", [{', '.join(f'{value:.6g}' for value in parts)}]"
    lines = [*(f"# {replace_unprintable(line)}" for line in load.describe())]
    lines.append(f"set_target_payload({load.mass:.6g}, [{centre}]{inertia})")
    return _write_file(identification, "load.script", "text/plain", lines, load)


def to_franka_load(identification: Identification) -> ExportedFile:
    """Return the load as a statement of libfranka: `robot.setLoad`, the inertia column by column.

    Parameters
    ----------
    identification : Identification
        A model with the effect `payload`.

    Returns
    -------
    ExportedFile
        The file, with notes on what it does not hold.

    Raises
    ------
    DynidentError
        As `identify_load` does.
    """
    load = identify_load(identification)
    inertia = np.zeros((3, 3)) if load.inertia is None else load.inertia
    centre, matrix = (", ".join(f"{value:.6g}" for value in array) for array in (load.centre, inertia.T.reshape(-1)))
    lines = [*(f"// {replace_unprintable(line)}" for line in load.describe())]
    lines.append(f"robot.setLoad({load.mass:.6g}, {{{{{centre}}}}}, {{{{{matrix}}}}});")
    return _write_file(identification, "load.cpp", "text/x-c++", lines, load)


def to_kuka_load(identification: Identification) -> ExportedFile:
    """Return the load as KUKA's load data: mm, principal moments of inertia, and their axes as angles A, B, C.

    Parameters
    ----------
    identification : Identification
        A model with the effect `payload`.

    Returns
    -------
    ExportedFile
        The file, with notes on what it does not hold.

    Raises
    ------
    DynidentError
        As `identify_load` does.
    """
    load = identify_load(identification)
    moments, axes = np.zeros(3), np.eye(3)
    if load.inertia is not None:
        moments, axes = np.linalg.eigh(load.inertia)
        axes = axes * np.sign(np.linalg.det(axes))
    # A turns about z, B about the new y, C about the new x.
    c, b, a = np.degrees(pin.rpy.matrixToRpy(axes))
    x, y, z = 1e3 * load.centre
    lines = [*(f"; {replace_unprintable(line)}" for line in load.describe())]
    lines.append(
        f"LOAD_DATA[1]={{M {load.mass:.6g},CM {{X {x:.6g},Y {y:.6g},Z {z:.6g},A {a:.6g},B {b:.6g},C {c:.6g}}},"
        f"J {{X {moments[0]:.6g},Y {moments[1]:.6g},Z {moments[2]:.6g}}}}}"
    )
    return _write_file(identification, "load.dat", "text/plain", lines, load)


def to_load_urdf(identification: Identification) -> ExportedFile:
    """Return the load as a URDF link, fixed to the link that carries it.

    Parameters
    ----------
    identification : Identification
        A model with the effect `payload`.

    Returns
    -------
    ExportedFile
        The file, with notes on what it does not hold.

    Raises
    ------
    DynidentError
        As `identify_load` does.
    """
    load, tree = identify_load(identification), identification.model.robot.tree
    inertia = np.zeros((3, 3)) if load.inertia is None else load.inertia
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    parts = " ".join(f'{n}="{format_numbers(v)}"' for n, v in zip(names, inertia[_UPPER], strict=True))
    carrier = name_links(tree)[tree.joint_names.index(load.link)]
    text = "\n".join(f"  {escape_xml_comment(line)}" for line in load.describe())
    lines = [
        f"<!--\n{text}\n-->",
        '<link name="load">',
        "  <inertial>",
        f'    <origin xyz="{format_numbers(*load.centre)}" rpy="0 0 0"/>',
        f'    <mass value="{format_numbers(load.mass)}"/>',
        f"    <inertia {parts}/>",
        "  </inertial>",
        "</link>",
        '<joint name="load_mount" type="fixed">',
        f"  <parent link={quoteattr(carrier)}/>",
        '  <child link="load"/>',
        "</joint>",
    ]
    return _write_file(identification, "load.urdf", "application/xml", lines, load)


def to_ur_friction(uncompensated: Identification, compensated: Identification) -> ExportedFile:
    """Return the shares of a UR arm's own friction compensation that cancel its friction, for the ROS 2 driver.

    The driver's service `set_friction_model_parameters` takes shares of the maker's coefficients, which are not public.
    Two models show both: where the controller adds all of its compensation, the commanded torque contains only the
    friction that the compensation lacks. With friction F without it and F' with all of it, the share is F / (F - F').

    Parameters
    ----------
    uncompensated, compensated : Identification
        Models with Coulomb and viscous friction, from torques that were commanded in direct torque control, with all
        shares 0, and with all shares 1.

    Returns
    -------
    ExportedFile
        YAML of the service's request, with 95 % intervals in comments. Shares are limited to 0 to 1; notes say where
        friction remains.

    Raises
    ------
    DynidentError
        If the robots differ, or have not six joints; or if the two models do not show the compensation of a joint.
    """
    robot = uncompensated.model.robot
    if robot.joint_names != compensated.model.robot.joint_names or robot.n != 6:
        raise DynidentError("the driver takes the friction of the six joints of one arm", pointer="compensated")
    head = [
        f"Shares of the arm's own friction compensation, {describe_origin()} (± is the 95 % interval).",
        "From torques commanded in direct torque control without friction compensation, and with all of it.",
    ]
    lines, notes = [], []
    fields: tuple[tuple[str, Role, str], ...] = (
        ("viscous_scale", "damping", "N m s/rad"),
        ("coulomb_scale", "dry", "N m"),
    )
    for field, role, unit in fields:
        shares = []
        for joint in robot.joint_names:
            full, full_error = _get_friction(uncompensated, joint, role)
            rest, rest_error = _get_friction(compensated, joint, role)
            makers = full - rest
            if makers <= float(np.hypot(full_error, rest_error)):
                raise DynidentError(
                    f"the {field.split('_')[0]} friction of {joint} is {full:.3g} {unit} without compensation and "
                    f"{rest:.3g} {unit} with it: the recordings do not show the compensation",
                    pointer="compensated",
                    title="Compensation not seen",
                )
            share = full / makers
            # The derivatives of F / (F - F') by F and F'.
            error = float(np.hypot(rest * full_error, full * rest_error)) / makers**2
            shares.append(min(max(share, 0.0), 1.0))
            head.append(f"{joint} {field}: {share:.3g} ± {error:.2g}")
            if share > 1.0 + error:
                kind = field.split("_")[0]
                notes.append(f"With all of the compensation, {joint} keeps {rest:.3g} {unit} of {kind} friction.")
        lines.append(f"  {field}: [{', '.join(f'{share:.4g}' for share in shares)}]")
    content = [*(f"# {replace_unprintable(line)}" for line in (*head, *notes)), "parameters:", *lines]
    name = f"{make_slug(robot.name)}_friction.yaml"
    return ExportedFile(name, "application/yaml", encode_text("\n".join(content) + "\n"), tuple(notes))


def _get_friction(identification: Identification, joint: str, role: Role) -> tuple[float, float]:
    """Return the friction of a joint with the half-width of its 95 % interval."""
    deviations = np.sqrt(np.diag(identification.estimate.statistics.covariance))
    for column, value, deviation in zip(identification.model.kept, identification.values, deviations, strict=True):
        if column.link == joint and get_role(column) == role and not column.runs:
            return float(value), NORMAL_95 * float(deviation)
    kind = "Coulomb friction" if role == "dry" else "damping"
    raise DynidentError(f"a model has no {kind} of {joint}", pointer="uncompensated")


def _write_file(
    identification: Identification, ending: str, media_type: str, lines: list[str], load: IdentifiedLoad
) -> ExportedFile:
    name = f"{make_slug(identification.model.robot.name)}_{ending}"
    notes = (*load.notes, f"All values are in the frame of the link that {load.link} moves.")
    return ExportedFile(name, media_type, encode_text("\n".join(lines) + "\n"), notes)
