"""Find where a description and a recording do not go together: units of the masses, zeros counted from the start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from dynident.array_types import FloatArray
from dynident.errors import Remedy
from dynident.identification.recording_faults.column_faults import Motion
from dynident.identification.recording_faults.torque_scale import find_revolute_joints
from dynident.identification.recording_faults.unexplained_torque import (
    HeldOutFit,
    UnexplainedTorque,
    measure_left_by_description,
)
from dynident.number_format import format_percent
from dynident.recordings.recording import Recording
from dynident.recordings.recording_metadata import Check, Revision
from dynident.robot.robot_model import Robot

_HEAVIEST = 1000.0
"""kg per m² of reach: arms have 10 to 160, from a hobby servo arm to one for 300 kg; in grams it is at least 10,000."""

_WIDEST = 3.0
"""Times the reach up to which a link's centre of mass, or its radius of gyration, may be from its joint: 0.6 in
descriptions that are right, and 30 and more with mm taken for m."""

_SMALL = 1e-3


@dataclass(frozen=True)
class DescriptionUnits:
    """Factors that bring a description's numbers to SI units.

    Parameters
    ----------
    mass : float
        Factor of the masses.
    moment : float
        Factor of the first moments.
    inertia : float
        Factor of the moments and products of inertia.
    """

    mass: float
    moment: float
    inertia: float

    def to_si(self, robot: Robot) -> Robot:
        """Return the robot with inertial parameters in SI units.

        Parameters
        ----------
        robot : Robot
            As it was described.
        """
        assert robot.inertias is not None
        factors = np.array([self.inertia] * 6 + [self.moment] * 3 + [self.mass])
        return replace(robot, inertias=robot.inertias * factors)

    def __str__(self) -> str:
        masses = "" if self.mass == 1.0 else "masses seem to be in g, 1000 times the mass of such an arm"
        centres = "" if self.moment == self.mass else "centres of mass seem to be in mm"
        times = self.inertia / self.mass
        unit = {(_SMALL, _SMALL**2): "g mm²", (1.0, _SMALL**2): "kg mm²", (_SMALL, 1.0): "g m²"}
        named = unit.get((self.mass, round(times, 12)))
        inertias = "" if self.inertia == 1.0 else f"inertias in {named}, {1.0 / self.inertia:.0e} times those in kg m²"
        return ", ".join(text for text in (masses, centres, inertias) if text)


def find_description_units(robot: Robot) -> DescriptionUnits | None:
    """Find the units of a description's masses, from its own numbers alone.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    DescriptionUnits or None
        None where they are SI, or the description has no masses.
    """
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return None
    reach = sum(float(np.linalg.norm(np.asarray(joint.placement)[:3, 3])) for joint in robot.joints)
    links = robot.inertias[robot.inertias[:, 9] > 0]
    # Without a length nothing can be compared.
    if reach <= 0.0:
        return None
    masses = links[:, 9]
    mass = _SMALL if masses.sum() > _HEAVIEST * reach**2 else 1.0
    # The median over the links: a single link may have an odd centre of mass, a unit is wrong for all of them.
    centre = float(np.median(np.linalg.norm(links[:, 6:9], axis=1) / masses))
    moment = mass * (_SMALL if centre > _WIDEST * reach else 1.0)
    # Radius of gyration about the joint, by the largest moment of inertia; about the centre of mass it is no larger.
    squares = np.abs(links[:, [0, 3, 5]]).max(axis=1) / masses
    wide = float(np.sqrt(np.median(squares))) > _WIDEST * reach
    units = DescriptionUnits(mass, moment, mass * (_SMALL**2 if wide else 1.0))
    return None if units == DescriptionUnits(1.0, 1.0, 1.0) else units


def report_description_units(units: DescriptionUnits) -> Check:
    """Report a description that is not in SI units.

    Parameters
    ----------
    units : DescriptionUnits
        Its units.
    """
    return Check(
        DESCRIPTION_UNITS,
        "warning",
        f"The robot's description is not in SI units: its {units}. The torques are not the cause. Identification does "
        "not need these numbers, but a prior, a completed export and some checks do: write them in kg, m and kg m² in "
        "the description.",
    )


ZERO, DESCRIPTION_UNITS = "joint_zero", "description_units"

_AT_START = 1e-3
"""Share of its motion up to which a joint's first position is 0."""
_POOR = 0.1
"""Left of the torque of the joint that is explained worst, from which on such zeros are doubted."""
_ROWS = 400
"""Rows by which the zeros are looked for: an angle a joint is told by few."""
_GRID = np.deg2rad(sorted(range(-150, 181, 30), key=abs))
"""Angles that are tried, no shift first: without masses all are alike."""
_TRIES, _STEPS = 200, 30
"""Fits of the rough search, and steps down the slope."""
_FLAT, _BESIDE = 0.02, np.deg2rad(5.0)
"""Logarithm by which the score has to rise beside a zero, and how far beside, for the data to tell it."""


def begins_at_zero(recording: Recording) -> bool:
    """Return whether every joint of several is at 0 in the first row, as where positions are counted from the start."""
    first = next(iter(recording.source.rows(0, recording.n_samples, recording.n_samples)))
    span = np.ptp(first.q, axis=0)
    return recording.n > 1 and bool((np.abs(first.q[0]) <= _AT_START * span).all() and (span > 0).all())


def report_zeros_from_start(
    robot: Robot, recording: Recording, motion: Motion, fit: HeldOutFit, as_is: UnexplainedTorque, q: Sequence[str]
) -> Check | None:
    """Report positions that begin at 0 and do not go with the description's zeros; None where they do.

    Parameters
    ----------
    robot : Robot
        The robot, with masses in SI units.
    recording : Recording
        The recording.
    motion : Motion
        Its filtered rows.
    fit : HeldOutFit
        That of the robot.
    as_is : UnexplainedTorque
        What it leaves of the torque as it is.
    q : sequence of str
        Names of the columns of positions.
    """
    if as_is.worst_share < _POOR or not begins_at_zero(recording):
        return None
    zeros = _find_zeros(robot, motion, fit)
    unexplained = fit.measure_unexplained(replace(motion, q=motion.q - zeros))
    if not as_is.is_surely_above(unexplained):
        return None
    told = {f"q{joint + 1}": float(f"{zero:.4g}") for joint, zero in enumerate(zeros) if zero}
    remedy = Remedy("zeros", told)
    others = [robot.joint_names[joint] for joint, zero in enumerate(zeros) if not zero]
    open_ones = f" Those of {', '.join(others)} do not show in these data." if others else ""
    detail = (
        f"All positions ({q[0]} … {q[-1]}) begin at 0: they seem to be counted from where the robot stood at the "
        "start, and not from the zeros of the description. The robot's dynamics leave "
        f"{format_percent(as_is.average_share, decimals=1)} of an average joint's torque unexplained, and "
        f"{format_percent(unexplained.average_share, decimals=1)} with zeros at {remedy} (in rad).{open_ones} "
        "State the angles at which the robot stood at the start, with the opposite sign, as zeros, for each recording "
        "its own; or log absolute positions."
    )
    # Zeros that do not show differ from recording to recording: a model of this one would fit no other.
    return Check(ZERO, "error", detail, q[0], apply=None if others[1:] else Revision(zeros=told), remedies=(remedy,))


def _find_zeros(robot: Robot, motion: Motion, fit: HeldOutFit) -> FloatArray:
    """Return the angles (n,) in rad that the positions have too much; 0 where the data do not tell.

    The masses of the description tell roughly, one joint after the other; a fit of all parameters tells the rest.
    """
    every = max(1, len(motion.q) // _ROWS)
    few = Motion(*(getattr(motion, name)[::every] for name in ("q", "dq", "ddq", "tau", "block")))
    joints = [int(joint) for joint in np.flatnonzero(find_revolute_joints(robot))]

    def measure_described(zeros: FloatArray) -> float:
        left = measure_left_by_description(robot, replace(few, q=few.q - zeros))
        return 0.0 if left is None else left

    def measure(zeros: FloatArray) -> float:
        return fit.measure_unexplained(replace(motion, q=motion.q - zeros)).fine_inside

    zeros = np.zeros(robot.n)
    # The zero of the last joint is one with the parameters of its link.
    if not (inner := joints[:-1]):
        return zeros
    for joint in joints:
        tries = [zeros + angle * (np.arange(robot.n) == joint) for angle in _GRID]
        zeros = min(tries, key=measure_described)

    def measure_inner(angles: FloatArray) -> float:
        return measure(_spread(angles, inner, robot.n))

    # Joints with parallel axes trade their zeros for one another: a narrow valley, along which slopes lead.
    rough = minimize(measure_inner, zeros[inner], method="Powell", options={
        "xtol": 1e-2, "ftol": 1e-2, "maxfev": _TRIES})  # fmt: skip
    angles = minimize(measure_inner, rough.x, method="BFGS", options={"maxiter": _STEPS}).x
    zeros = _spread(angles, inner, robot.n)
    least = measure(zeros)
    for joint in joints:
        beside = [measure(zeros + side * _BESIDE * (np.arange(robot.n) == joint)) - least for side in (-1.0, 1.0)]
        # Nothing changes with this angle: the first joint's about a vertical axis, or that of the last link.
        if max(beside) < _FLAT:
            zeros[joint] = 0.0
    return np.asarray((zeros + np.pi) % (2.0 * np.pi) - np.pi)


def _spread(values: FloatArray, joints: Sequence[int], n: int) -> FloatArray:
    zeros = np.zeros(n)
    zeros[list(joints)] = values
    return zeros
