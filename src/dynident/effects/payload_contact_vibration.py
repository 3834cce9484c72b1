"""Effects from outside: a payload in some runs, a contact force on a link, a vibrating base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import casadi as ca
import numpy as np

from dynident.effects.effect import Column, Effect, ParameterSpec, Refinement, ShapeSpec
from dynident.effects.effect_signals import Signals
from dynident.effects.link_and_rotor_inertia import get_base_wrench, get_stored_energy
from dynident.effects.newton_euler import build_link_jacobian
from dynident.effects.usual_effect_sizes import UsualSize, get_usual_force
from dynident.robot.robot_model import INERTIAL_NAMES, Robot

_UNITS = ("kg m²",) * 6 + ("kg m",) * 3 + ("kg",)


class Payload(Effect):
    """A mass that was added to a link in some of the runs; the last link carries it unless another one is named."""

    id = "payload"
    title = "Added mass"
    sits_on = "link"
    formula = r"Y_k(q, \dot q, \ddot q)\,\Delta\varphi"
    parameters = tuple(
        ParameterSpec(
            f"{name}p",
            unit,
            f"{name} of the carried load, about the frame of the link's joint",
            positive=name == "M",
            role="load",
        )
        for name, unit in zip(INERTIAL_NAMES, _UNITS, strict=True)
    )
    signature = "a step between runs: a link is heavier in some runs"
    confused_with = ("rigid_body",)
    sources = ("Khalil, Gautier and Lemoine 2007",)
    experiment = "with_payload"
    place_experiment = "as_it_is"
    told_from = MappingProxyType({"with_payload": ("rigid_body",)})
    in_some_runs = True
    # A second moment alone is not enough: on a link that only turns about the vertical it is the same function as a
    # rotor or a gain.
    shown_by = ("MXp", "MYp", "MZp", "Mp")
    may_change = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a ball of 4 cm, 6 cm before the flange."""
        mass = get_usual_force(robot) / 9.81
        return UsualSize(
            {"Mp": mass, "MZp": 0.06 * mass, "XXp": 4.2e-3 * mass, "YYp": 4.2e-3 * mass, "ZZp": 0.6e-3 * mass}
        )

    def get_default_joints(self, robot: Robot) -> tuple[int, ...]:
        """Return the last joint: that of the tool."""
        return (robot.n - 1,)

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return ten columns for every link that carries something: those of the link itself."""
        # A rigid load moves with its link, so that its columns are those of the link's own inertia.
        rows = signals.mechanics.rows
        return [
            replace(
                self._reaching_column(signals, spec, joint, rows[:, 10 * joint + k]),
                energy=partial(get_stored_energy, signals, 10 * joint + k),
                wrench=partial(get_base_wrench, signals, 10 * joint + k),
            )
            for joint in joints
            for k, spec in enumerate(self.parameters)
        ]


class ExternalContact(Effect):
    """An external force and moment on a link, mostly the tool, for a limited time."""

    id = "external_contact"
    title = "Contact with the surroundings"
    sits_on = "link"
    formula = r"-J^T f(t),\quad t_0 \le t \le t_1"
    parameters = tuple(
        ParameterSpec(f"{kind}{axis}{part}", unit, f"{what} along {axis} of the base on the link, {meaning}")
        for part, meaning in (("", "steady"), ("h", "swelling"))
        for kind, unit, what in (("f", "N", "force"), ("m", "N m", "moment"))
        for axis in "xyz"
    )
    shapes = (
        ShapeSpec("t0", "s", "time when the contact begins", 0.0, proposal="burst", signed=True, may_be_zero=True),
        ShapeSpec("t1", "s", "time when the contact ends", 1.0, proposal="burst", signed=True, may_be_zero=True),
        ShapeSpec("link", "-", "number of the link that is pushed, 0 for the last", 0.0, may_be_zero=True),
    )
    signature = "one interval of time with a residual far above all others"
    confused_with = ("payload",)
    sources = ("Haddadin, De Luca and Albu-Schäffer 2017",)
    experiment = "repeated"
    told_from = MappingProxyType({"repeated": ("base_vibration",)})
    scope = "robot"

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a push of a second and a half."""
        force = get_usual_force(robot)
        return UsualSize({"fx": 0.5 * force, "fz": force, "fzh": 0.5 * force}, {"t0": 3.0, "t1": 4.5})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return six columns of a wrench that stays, and six of one that swells and fades, inside the window."""
        constants = self.shape_with_defaults(shape)
        start, end = constants["t0"], constants["t1"]
        # The window and half a sine wave in it: the two profiles together approximate most single pushes.
        inside = (signals.time >= start) * (signals.time <= end)
        # A window without any length must not divide by zero.
        swell = inside * ca.sin(np.pi * (signals.time - start) / max(end - start, 1e-9))
        # Number 0 stands for the last link; motors are relieved by the torque of a push, hence the minus sign below.
        n = signals.robot.n
        jacobian = build_link_jacobian(signals.robot, signals.q, min(int(constants["link"]) or n, n) - 1)
        columns = []
        for k, spec in enumerate(self.parameters):
            # Six steady components come first, then the same six swelling.
            profile = inside if k < 6 else swell
            columns.append(self._robot_column(spec, -jacobian[k % 6, :].T * profile, constants))
        return columns


class BaseVibration(Effect):
    """A base that vibrates at one frequency; on the links this acts like a vibrating gravity."""

    id = "base_vibration"
    title = "Vibration of the base"
    formula = r"-Y_g(q)\,a(t),\quad a = a_c \cos 2\pi f t + a_s \sin 2\pi f t"
    parameters = tuple(
        ParameterSpec(f"a{axis}{part}", "m/s²", f"acceleration of the base along {axis}, {name} part")
        for axis in "xyz"
        for part, name in (("c", "cosine"), ("s", "sine"))
    )
    shapes = (ShapeSpec("f", "Hz", "frequency", 5.0, proposal="time_spectrum", refined=Refinement(0.002)),)
    signature = "a peak in the spectrum of the residual over time, at the same frequency on all joints"
    confused_with = ("external_contact",)
    sources = ("Moberg, Wernholt, Hanssen and Brogårdh 2014",)
    experiment = "repeated"
    told_from = MappingProxyType({"repeated": ("torque_ripple",)})
    scope = "robot"
    needs_load = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: that of a light stand."""
        return UsualSize({"axc": 0.3, "ays": 0.2, "azc": 0.1, "azs": 0.3}, {"f": 7.0})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return a cosine and a sine column for every direction of the base frame."""
        constants = self.shape_with_defaults(shape)
        # A cosine and a sine together have any phase, and the torque stays linear in the parameters.
        angle = 2 * np.pi * constants["f"] * signals.time
        waves = (ca.cos(angle), ca.sin(angle))
        columns = []
        for k, spec in enumerate(self.parameters):
            # On an accelerated base links feel gravity less that acceleration (d'Alembert).
            direction = np.eye(3)[k // 2]
            columns.append(
                self._robot_column(spec, -signals.predicted.build_gravity_torque(direction) * waves[k % 2], constants)
            )
        return columns

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Return all joints: gravity acts on any of them."""
        return tuple(range(robot.n))
