"""Friction with memory: presliding after each reversal, and break-away friction after each standstill."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import casadi as ca

from dynident.effects.effect import RATIO, Column, Effect, ParameterSpec, ShapeSpec, build_geometric_grid
from dynident.effects.effect_signals import DAHL, STOP, TRAVEL, MemorySignal, Signals
from dynident.effects.usual_effect_sizes import COULOMB_SHARE, UsualSize, get_largest_torque
from dynident.robot.robot_model import Robot


class Presliding(Effect):
    """Friction that builds up over a small displacement; a part is proportional to the load."""

    id = "presliding"
    title = "Presliding hysteresis"
    formula = (
        r"(F_z + c_z |\hat\tau_l|)\,z,\qquad z \leftarrow \mathrm{sat}(z + \Delta q / d_0)"
        r"\quad\text{or}\quad \dot z = \frac{\dot q}{d_0}(1 - z\,\mathrm{sign}\,\dot q)"
    )
    parameters = (
        ParameterSpec(
            "Fz",
            "N m",
            "friction at the end of the slip distance",
            "N",
            positive=True,
            resists=True,
            role="dry_once_sliding",
        ),
        ParameterSpec("cz", "-", "friction at the end of the slip distance, per unit of load torque"),
    )
    shapes = (
        ShapeSpec("d0", "rad", "slip distance", 2e-3, least=0.5e-3, resolved_by="displacement", refined=RATIO),
        ShapeSpec("law", "-", "+1: stop operator, -1: Dahl", 1.0, signed=True, words=((1.0, "stop"), (-1.0, "dahl"))),
    )
    signature = "a rounded corner after each reversal instead of a step"
    confused_with = ("stribeck",)
    sources = ("Al-Bender, Lampaert and Swevers 2005", "Dahl 1968")
    experiment = "reversals"
    told_from = MappingProxyType(
        {
            "reversals": (
                "stribeck",
                "coulomb",
                "break_away",
                "torque_delay",
                "viscous_nonlinear",
                "backlash",
                "joint_elasticity",
            )
        }
    )
    often_missed = 1
    is_friction = True
    needs_load = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: most of the usual Coulomb friction, over half a degree."""
        return UsualSize({"Fz": 0.8 * COULOMB_SHARE * get_largest_torque(robot, joint), "cz": 0.0}, {"d0": 8e-3})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return a constant and a load-proportional column a joint."""
        constants = self.shape_with_defaults(shape)
        columns = []
        # Shape constants are numbers, so that a choice between two laws is the sign of one.
        operator = STOP if constants["law"] > 0 else DAHL
        for j in joints:
            # z tells how much of the friction is reached; equal signals have one symbol, so that both columns share it.
            z = signals.memory(MemorySignal(operator, j, constants["d0"]))
            for spec, torque in zip(self.parameters, (z, ca.fabs(signals.load[j]) * z), strict=True):
                columns.append(self._column(signals, spec, j, torque, constants))
        return columns

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return slip distances from 0.5 to 64 mrad (or mm) in factors of two, by both laws."""
        return [{"d0": d, "law": law} for law in (1.0, -1.0) for d in build_geometric_grid(0.5e-3, 64e-3, 2.0)]


class BreakAway(Effect):
    """Static friction above Coulomb friction: an excess after every standstill that falls off as the joint moves on.

    Stribeck friction falls with speed, whatever was before; this with the distance from where the joint last stood or
    turned, however slowly it goes. A joint at rest is held by as much as Coulomb friction and the excess together.
    """

    id = "break_away"
    title = "Break-away friction"
    formula = (
        r"(F_s - F_c)\,e^{-s / d_b}\,\mathrm{sign}(\dot q),\qquad s:\ \text{travelled since the last stop or reversal}"
    )
    parameters = (
        ParameterSpec("Fba", "N m", "excess of static over Coulomb friction", "N", positive=True, resists=True),
    )
    shapes = (
        ShapeSpec(
            "db",
            "rad",
            "distance over which the excess falls off",
            8e-3,
            least=0.5e-3,
            resolved_by="travel",
            refined=RATIO,
        ),
    )
    signature = "a peak when a joint starts to move; it vanishes after a distance, whatever the speed"
    confused_with = ("stribeck", "presliding")
    sources = ("Armstrong-Hélouvry, Dupont and Canudas de Wit 1994",)
    experiment = "reversals"
    is_friction = True
    may_change = True
    # The friction that holds a joint and the one that brakes it change together; Coulomb friction alone is simpler.
    seldom_changes = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: more than half of the usual Coulomb friction, over half a degree."""
        return UsualSize({"Fba": 0.6 * COULOMB_SHARE * get_largest_torque(robot, joint)}, {"db": 8e-3})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return one column a joint."""
        constants = self.shape_with_defaults(shape)
        columns = []
        for j in joints:
            # The state grows as 1 - exp(-s / db), so that one less its size is the excess that is left.
            travelled = ca.fabs(signals.memory(MemorySignal(TRAVEL, j, constants["db"])))
            columns.append(self._column(signals, self.parameters[0], j, (1 - travelled) * signals.sign[j], constants))
        return columns

    def at_starts(self, shape: Mapping[str, float]) -> bool:
        """Return True: it acts after every start."""
        return True

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return distances from 2 to 32 mrad (or mm) in factors of two."""
        return [{"db": d} for d in build_geometric_grid(2e-3, 32e-3, 2.0)]
