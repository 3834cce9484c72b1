"""Effects of springs between links: a balancing spring on a crank, a cable or hose; their search grids."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import casadi as ca
import numpy as np

from dynident.effects.effect import RATIO, Column, Effect, ParameterSpec, Refinement, ShapeSpec
from dynident.effects.effect_signals import Signals
from dynident.effects.usual_effect_sizes import UsualSize, get_largest_torque
from dynident.robot.robot_model import Robot

# Index of the last joint that may have such a spring: those beyond it carry too little weight.
_LAST_JOINT = 3
# Candidates of the search: directions in a turn, and short and long cranks.
_DIRECTIONS = 12
_CRANK_RATIOS = (0.25, 0.6)


class GravityCompensator(Effect):
    """A spring between a point of the antecedent link and a crank on the link.

    With x = q - φ, the crank ratio r and the length l = √(1 + r² + 2 r cos x) in units of the longer arm, the motor has
    to give -k a b sin x (1 - l0 / l), the slope of the stored energy: linear in k a b and k a l0.
    """

    id = "gravity_compensator"
    title = "Gravity compensating spring"
    hardware = "gravity_compensator"
    appearance = "Torque over the position"
    formula = r"-k a b \sin x\,(l - l_0)/l,\qquad l^2 = a^2 + b^2 + 2ab\cos x,\quad x = q - \varphi"
    parameters = (
        ParameterSpec("kab", "N m", "stiffness times both lever arms, k a b"),
        ParameterSpec("kal", "N m", "stiffness times crank and free length, -k a l0"),
    )
    shapes = (
        ShapeSpec(
            "phi",
            "rad",
            "angle of the joint where spring and crank are in line",
            0.1,
            signed=True,
            may_be_zero=True,
            refined=Refinement(0.065),
        ),
        ShapeSpec("r", "-", "crank length over distance of the spring's foot", 0.25, refined=RATIO),
    )
    signature = "smooth over the joint's position, several harmonics of its angle"
    confused_with = ("joint_spring", "torque_ripple")
    of_position = True
    sources = ("Klimchik, Caro, Wu, Pashkevich, Furet and Caro 2013",)
    experiment = "slow_sweep"

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a fifth of the largest torque."""
        torque = get_largest_torque(robot, joint)
        return UsualSize({"kab": 0.2 * torque, "kal": -0.1 * torque}, {"phi": 0.3, "r": 0.25})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return two columns a joint."""
        constants = self.shape_with_defaults(shape)
        r = constants["r"]
        columns = []
        for j in joints:
            x = signals.q[j] - constants["phi"]
            # In units of the longer arm, by the law of cosines.
            length = ca.sqrt(1 + r * r + 2 * r * ca.cos(x))
            # Torques are slopes of the stored energies: d cos x = -sin x dx, and d(length / r) = -sin x / length dx.
            waves = (-ca.sin(x), -ca.sin(x) / length)
            stored = (partial(ca.SX, ca.cos(x)), partial(ca.SX, length / r))
            for spec, wave, energy in zip(self.parameters, waves, stored, strict=True):
                columns.append(self._column(signals, spec, j, wave, constants, energy))
        return columns

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Return the first joints that gravity loads: revolute, and not about the vertical at the base."""
        # An upright axis at the base carries no weight, so nobody balances it. Without gravity no axis is upright.
        down = robot.gravity / max(float(np.linalg.norm(robot.gravity)), 1e-12)
        loaded_joints = []
        for j, joint in enumerate(robot.joints):
            upright = joint.parent < 0 and abs(float(joint.placement[:3, :3] @ joint.axis @ down)) > 0.99
            if joint.kind == "revolute" and not upright:
                loaded_joints.append(j)
        return tuple(j for j in loaded_joints if j <= _LAST_JOINT)

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return twelve directions, a short and a long crank."""
        angles = [2 * np.pi * (k + 0.5) / _DIRECTIONS - np.pi for k in range(_DIRECTIONS)]
        return [{"phi": float(angle), "r": r} for r in _CRANK_RATIOS for angle in angles]


# Exponents of the energy's monomials in the two positions, up to the third degree; a constant gives no torque.
_POWERS = ((1, 1), (2, 0), (0, 2), (2, 1), (1, 2), (3, 0), (0, 3), (1, 0), (0, 1))


class CableForce(Effect):
    """A cable, hose or spring that spans two joints: its energy is a function of both angles.

    Where it is fixed is not known, so the energy is a polynomial of third degree in the two positions. It is the same
    energy that gives the torque on both joints.
    """

    id = "cable_force"
    title = "Cable or spring across two joints"
    hardware = "cable"
    appearance = "Torque over the positions of two joints"
    sits_on = "link"
    formula = (
        r"\Gamma_j = \partial U / \partial q_j,\ \Gamma_{j+1} = \partial U / \partial q_{j+1},\quad U(q_j, q_{j+1})"
    )
    # The underscore keeps the joint's number, which follows the name in a column, apart from the exponents.
    parameters = tuple(
        ParameterSpec(f"u{a}{b}_", f"N m/rad^{a + b}", f"coefficient of q_j^{a} q_(j+1)^{b} of the energy")
        for a, b in _POWERS
    )
    signature = "a smooth function of the positions of two neighbouring joints, on both of them"
    confused_with = ("joint_spring",)
    covers = ("joint_spring", "gravity_compensator", "torque_ripple", "offset", "coulomb_asymmetric")
    is_rough = True
    pulls_on_each = True
    of_position = True
    sources = ("Khalil and Dombre 2002, chapter 9",)

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a per cent or two of the largest torque for each radian."""
        torque = get_largest_torque(robot, joint)
        return UsualSize({"u20_": 0.01 * torque, "u11_": 0.02 * torque, "u02_": 0.01 * torque})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return nine columns for every joint of `joints` and the one after it."""
        columns = []
        for j in joints:
            x, y = signals.q[j], signals.q[j + 1]
            for spec, (a, b) in zip(self.parameters, _POWERS, strict=True):
                # One parameter for the torques on both joints: the slopes of one monomial of the energy.
                energy = x**a * y**b
                rows = ca.SX(signals.robot.n, 1)
                if a:
                    rows[j] = a * x ** (a - 1) * y**b
                if b:
                    rows[j + 1] = b * x**a * y ** (b - 1)
                columns.append(self._reaching_column(signals, spec, j, rows, energy=partial(ca.SX, energy)))
        return columns

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Return joints that have a successor in the chain."""
        # In a tree the next joint in the list may hang on another branch.
        return tuple(j for j in range(robot.n - 1) if robot.joints[j + 1].parent == j)
