"""The motion that a virtual robot follows, and the course of its temperature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import scipy

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot.robot_model import Robot
from dynident.simulation.virtual_robot_request import Warming

_TITLE = "Unusable trajectory"


@dataclass(frozen=True, eq=False)
class Reference:
    """A sampled trajectory.

    Parameters
    ----------
    t : (m,)
        Times, s, strictly increasing.
    q, dq, ddq : (m, n)
        Positions, velocities and accelerations of the joints: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
    temperature : (m, n), optional
        Temperatures of the joints, degC, where they are prescribed.
    """

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    temperature: FloatArray | None = None

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.t[-1] - self.t[0])


def add_warming(reference: Reference, warming: Warming) -> Reference:
    """Return the same trajectory, along which all joints warm up.

    Parameters
    ----------
    reference : Reference
        The trajectory; a temperature that it has is replaced.
    warming : Warming
        How the joints warm up with the time of the session.

    Returns
    -------
    Reference
        The same motion with a temperature for every sample and joint.
    """
    n = reference.q.shape[1]
    return replace(reference, temperature=np.repeat(warming.compute_temperature(reference.t)[:, None], n, axis=1))


class ReferencePath:
    """A reference trajectory at any time: cubic between samples, through their velocities and accelerations."""

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        # Position and velocity are interpolated separately: the derivative of a cubic through q and dq would not meet
        # the given accelerations.
        self._q = scipy.interpolate.CubicHermiteSpline(reference.t, reference.q, reference.dq)
        self._dq = scipy.interpolate.CubicHermiteSpline(reference.t, reference.dq, reference.ddq)

    def evaluate(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration, each (k, n), at times t (k,)."""
        # The last internal steps may lie behind the end of the trajectory: the path then stays where it ends, since a
        # cubic that is continued beyond its samples would run away.
        inside = np.clip(t, self._reference.t[0], self._reference.t[-1])
        return self._q(inside), self._dq(inside), self._dq(inside, 1)

    def evaluate_temperature(self, t: FloatArray) -> FloatArray:
        """Return the temperature (k, n) at times t (k,); zeros where none is prescribed."""
        prescribed = self._reference.temperature
        n = self._reference.q.shape[1]
        if prescribed is None:
            return np.zeros((len(t), n))
        return np.column_stack([np.interp(t, self._reference.t, prescribed[:, j]) for j in range(n)])


def check_reference(reference: Reference, robot: Robot) -> None:
    """Raise `DynidentError` where a trajectory does not fit the robot, is not finite, or does not run forward.

    Parameters
    ----------
    reference : Reference
        The trajectory.
    robot : Robot
        The robot, as its description gives it.
    """
    m = len(reference.t)
    if reference.t.ndim != 1 or m < 2:
        raise DynidentError("a trajectory needs at least two samples", pointer="/trajectory/t", title=_TITLE)
    arrays = {"t": reference.t, "q": reference.q, "dq": reference.dq, "ddq": reference.ddq}
    if reference.temperature is not None:
        arrays["temperature"] = reference.temperature
    # The shape comes first: what follows names the sample and the joint of a bad value by its row and column.
    for name, values in arrays.items():
        if name != "t" and values.shape != (m, robot.n):
            raise DynidentError(
                f"{name} has the shape {values.shape}; {m} samples of t and {robot.n} joints need {(m, robot.n)}",
                pointer=f"/trajectory/{name}",
                title=_TITLE,
            )
        bad = np.argwhere(~np.isfinite(values.reshape(m, -1)))
        if len(bad):
            row, joint = int(bad[0, 0]), int(bad[0, 1])
            of = "" if name == "t" else f" of {robot.joint_names[joint]}"
            raise DynidentError(
                f"{name}{of} is not a finite number in sample {row}", pointer=f"/trajectory/{name}/{row}", title=_TITLE
            )
    back = np.flatnonzero(np.diff(reference.t) <= 0)
    if len(back):
        row = int(back[0]) + 1
        raise DynidentError(
            f"t is {reference.t[row]} s in sample {row}, not after the {reference.t[row - 1]} s before it",
            pointer=f"/trajectory/t/{row}",
            title=_TITLE,
        )


def read_reference(path: Path, robot: Robot) -> Reference:
    """Read a motion from a table of t, q_<joint>… and optionally dq_<joint>… and ddq_<joint>….

    Parameters
    ----------
    path : Path
        A .csv or .parquet file, as a design is saved.
    robot : Robot
        The robot that shall make the motion.

    Returns
    -------
    Reference
        The motion; derivatives that the file lacks are those of a cubic spline through the positions.

    Raises
    ------
    DynidentError
        Where the file is no such table.
    """
    try:
        table = pq.read_table(path) if path.suffix == ".parquet" else pacsv.read_csv(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise DynidentError(f"{path.name} cannot be read: {error}", pointer=str(path), title=_TITLE) from error
    t, q = _read_column(table, "t", path), _read_signal(table, "q", robot, path)
    if len(t) < 4 or not np.all(np.diff(t) > 0):
        raise DynidentError("t must increase and have at least four rows", pointer=f"{path}: t", title=_TITLE)
    spline = scipy.interpolate.CubicSpline(t, q)
    derivatives = []
    for order, kind in enumerate(("dq", "ddq"), start=1):
        # Of all joints or of none: a spline for some of them would not fit the others.
        present = all(f"{kind}_{name}" in table.column_names for name in robot.joint_names)
        derivatives.append(_read_signal(table, kind, robot, path) if present else np.asarray(spline(t, order)))
    return Reference(t, q, *derivatives)


def _read_signal(table: pa.Table, kind: str, robot: Robot, path: Path) -> FloatArray:
    return np.column_stack([_read_column(table, f"{kind}_{name}", path) for name in robot.joint_names])


def _read_column(table: pa.Table, name: str, path: Path) -> FloatArray:
    if name not in table.column_names:
        raise DynidentError(
            f"{path.name} has no column {name}; it has: {', '.join(table.column_names)}", pointer=name, title=_TITLE
        )
    column = table[name]
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        raise DynidentError(f"column {name} of {path.name} does not hold numbers", pointer=name, title=_TITLE)
    return np.asarray(column.to_numpy(), dtype=np.float64)
