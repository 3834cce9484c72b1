"""Effects `rigid_body` and `rotor_inertia`: the inertial columns of links and rotors.

Also the base wrench and the stored energy of the links.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import casadi as ca

from dynident.effects.effect import Column, Effect, ParameterSpec
from dynident.effects.effect_signals import Signals
from dynident.effects.usual_effect_sizes import ROTOR_SHARE, UsualSize, get_largest_torque
from dynident.robot.robot_model import INERTIAL_NAMES, Robot

_UNITS = ("kg m²",) * 6 + ("kg m",) * 3 + ("kg",)
_MEANING = (
    "moment of inertia about x", "product of inertia xy", "product of inertia xz", "moment of inertia about y",
    "product of inertia yz", "moment of inertia about z", "first moment along x", "first moment along y",
    "first moment along z", "mass",
)  # fmt: skip


class RigidBody(Effect):
    """Ten inertial parameters a link, about the origin of the link's joint frame."""

    id = "rigid_body"
    acts_at_rest = True
    is_inertia = True
    sits_on = "link"
    title = "Inertia, centrifugal, Coriolis and gravity torques of the links"
    formula = r"\Gamma = A(q)\,\ddot q + H(q, \dot q)"
    parameters = tuple(
        ParameterSpec(name, unit, f"{meaning} of the link, about its joint frame", role="link")
        for name, unit, meaning in zip(INERTIAL_NAMES, _UNITS, _MEANING, strict=True)
    )
    signature = "smooth torque in phase with acceleration, velocity products and gravity"
    sources = ("Khalil and Dombre 2002, chapter 12, [12.18]-[12.21]",)

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return ten columns for every link in `joints`."""
        rows = signals.mechanics.rows
        # The recursion gives all links' rows at once, with structural zeros where a joint does not feel a link.
        return [
            Column(
                effect=self.id,
                parameter=spec.name,
                name=f"{spec.name}{link + 1}",
                link=signals.robot.joints[link].name,
                unit=spec.unit,
                torque=rows[:, 10 * link + k],
                energy=partial(get_stored_energy, signals, 10 * link + k),
                wrench=partial(get_base_wrench, signals, 10 * link + k),
            )
            for link in joints
            for k, spec in enumerate(self.parameters)
        ]


class RotorInertia(Effect):
    """The rotor and the fast side of the gear, seen at the joint."""

    id = "rotor_inertia"
    is_inertia = True
    sits_on = "motor"
    title = "Rotor inertia"
    formula = r"I_a\,\ddot q"
    parameters = (
        ParameterSpec(
            "Ia",
            "kg m²",
            "inertia of the rotor and gear, referred to the joint side",
            prismatic_unit="kg",
            resists=True,
            role="rotor",
        ),
    )
    signature = "torque in phase with the joint's own acceleration, the same in every posture"
    confused_with = ("rigid_body",)
    sources = ("Khalil and Dombre 2002, chapter 12, [12.1] and [12.33]",)

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: that of a geared servo drive."""
        return UsualSize({"Ia": ROTOR_SHARE * get_largest_torque(robot, joint)})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return one column a joint."""
        return [
            self._column(
                signals,
                self.parameters[0],
                j,
                signals.ddq[j],
                energy=partial(_build_rotor_energy, signals, j),
            )
            for j in joints
        ]


def get_base_wrench(signals: Signals, index: int) -> ca.SX:
    """Return the reaction of the base for one standard inertial parameter.

    Parameters
    ----------
    signals : Signals
        Symbols of the robot.
    index : int
        Number of the parameter, ten a link.

    Returns
    -------
    SX (6, 1)
        Force and moment, N and N m for one unit of the parameter.
    """
    return signals.mechanics.wrenches[:, index]


def get_stored_energy(signals: Signals, index: int) -> ca.SX:
    """Return the kinetic plus potential energy for one standard inertial parameter, [12.33] and [12.34].

    Parameters
    ----------
    signals : Signals
        Symbols of the robot.
    index : int
        Number of the parameter, ten a link.

    Returns
    -------
    SX (1, 1)
        J for one unit of the parameter.
    """
    kinetic, potential = signals.mechanics.energies
    return kinetic[index] + potential[index]


def _build_rotor_energy(signals: Signals, joint: int) -> ca.SX:
    """Return e_Ia of [12.33]."""
    return 0.5 * signals.dq[joint] * signals.dq[joint]
