"""Effects of offsets, joint springs, torque ripple, a tilted base, coupled motors, encoder and geometry errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects.effect import Column, Effect, ParameterSpec, Refinement, ShapeSpec
from dynident.effects.effect_signals import Signals
from dynident.effects.usual_effect_sizes import (
    COULOMB_SHARE,
    ROTOR_SHARE,
    VISCOUS_SHARE,
    UsualSize,
    get_largest_torque,
    get_velocity_scale,
)
from dynident.robot.robot_model import Robot


class EncoderZeroError(Effect):
    """A joint whose zero position is not that of the description."""

    id = "encoder_zero_error"
    title = "Error of a joint's zero position"
    sits_on = "motor"
    formula = r"\frac{\partial\hat\tau_l}{\partial q_j}\,\Delta_j"
    parameters = (ParameterSpec("dq0", "rad", "true position minus measured position", "m", least=1e-3, most=0.2),)
    signature = "torque that depends on the posture, on the joint and its neighbours at the same time"
    confused_with = ("base_tilt", "joint_elasticity")
    sources = ("Khalil and Dombre 2002, chapter 11",)
    first_order = True
    needs_load = True
    may_change = True
    shifts_zero = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: two degrees, or three millimetres."""
        return UsualSize({"dq0": 0.03 if robot.joints[joint].kind == "revolute" else 3e-3})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return the sensitivity of all joints' torque to the position of each."""
        # First order of Taylor's series about the description: the error times the slope of the predicted torque.
        slope = signals.predicted.load_over_position
        return [self._reaching_column(signals, self.parameters[0], j, slope[:, j]) for j in joints]


class KinematicError(Effect):
    """A joint that is some millimetres away from its place in the description."""

    id = "kinematic_error"
    title = "Error of a link's length"
    sits_on = "link"
    formula = r"\frac{\partial\hat\tau_l}{\partial(d_x, d_y, d_z)_j}\,\delta_j"
    parameters = tuple(
        ParameterSpec(
            f"d{axis}",
            "m",
            f"true place of the joint along {axis} of its antecedent's frame, minus the given place",
            least=5e-4,
            most=0.2,
        )
        for axis in "xyz"
    )
    signature = "like inertia; the base parameters absorb nearly all of it"
    confused_with = ("rigid_body",)
    sources = ("Khalil and Dombre 2002, chapter 11",)
    first_order = True
    needs_load = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: some millimetres."""
        return UsualSize({"dx": 8e-3, "dy": -5e-3, "dz": 4e-3})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return three columns a joint."""
        # As above, with three slopes a joint: one for each axis of the antecedent's frame.
        slope = signals.predicted.load_over_origins
        return [
            self._reaching_column(signals, spec, j, slope[:, 3 * j + k])
            for j in joints
            for k, spec in enumerate(self.parameters)
        ]


class Offset(Effect):
    """A constant torque: current sensor offset, or friction that differs between the directions."""

    id = "offset"
    acts_at_rest = True
    title = "Torque offset"
    formula = r"b"
    parameters = (ParameterSpec("b", "N m", "constant torque", prismatic_unit="N", role="constant"),)
    signature = "a constant"
    confused_with = ("joint_spring",)
    same_function = ("coulomb_asymmetric",)
    of_position = True
    sources = ("Khalil and Dombre 2002, chapter 12",)
    experiment = "slow_sweep"
    may_change = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a per cent or two of the largest torque."""
        return UsualSize({"b": 0.015 * get_largest_torque(robot, joint)})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return one column of ones a joint."""
        return [self._column(signals, self.parameters[0], j, ca.SX(1.0)) for j in joints]


class JointSpring(Effect):
    """A cable, hose or balancing spring that pulls the joint to a rest position."""

    id = "joint_spring"
    acts_at_rest = True
    title = "Joint spring"
    hardware = "spring"
    appearance = "Torque in proportion to the position"
    formula = r"k\,(q - q_0)"
    parameters = (
        ParameterSpec("ks", "N m/rad", "stiffness", "N/m", role="stiffness"),
        ParameterSpec("bs", "N m", "torque at q = 0, -k q0", "N", role="at_zero"),
    )
    signature = "a straight line over the joint's position"
    confused_with = ("offset", "torque_ripple")
    of_position = True
    sources = ("Khalil and Dombre 2002, chapter 9",)
    experiment = "slow_sweep"
    told_from = MappingProxyType(
        {"slow_sweep": ("offset", "coulomb_asymmetric", "torque_ripple", "gravity_compensator", "cable_force")}
    )
    may_change = True
    # About an upright axis a tilted base has the same effect over the range of most motions.
    seldom_changes = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: some per cent of the largest torque for each radian."""
        torque = get_largest_torque(robot, joint)
        return UsualSize({"ks": 0.03 * torque, "bs": -0.01 * torque})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return the position and a constant: the rest position is part of the effect."""
        columns = []
        for j in joints:
            # k (q - q0) is linear in k and in -k q0, but not in q0 itself.
            q = signals.q[j]
            columns.append(self._column(signals, self.parameters[0], j, q, energy=partial(_build_half_square, q)))
            columns.append(self._column(signals, self.parameters[1], j, ca.SX(1.0), energy=partial(ca.SX, q)))
        return columns


# Lead (m) of a usual ball screw of a prismatic joint, whose nut, motor and bearings repeat their torque every turn.
_LEAD = 0.02


class TorqueRipple(Effect):
    """Gear eccentricity, cogging, harmonic-drive error: torque periodic in the joint angle."""

    id = "torque_ripple"
    title = "Torque ripple"
    formula = r"A_c \cos kq + A_s \sin kq"
    parameters = (
        ParameterSpec("Ac", "N m", "cosine amplitude", "N"),
        ParameterSpec("As", "N m", "sine amplitude", "N"),
    )
    shapes = (
        ShapeSpec(
            "k",
            "1/rad",
            "waves per turn of the joint (per 2π m of a prismatic one)",
            30.0,
            proposal="angle_spectrum",
            refined=Refinement(0.025),
            # Parts that turn with the joint repeat after a whole turn, so their numbers of waves are whole. Other
            # numbers come from parts behind a stage of gears, which turn several times as fast.
            least=5.0,
            is_whole=True,
        ),
    )
    signature = "a peak in the spectrum of the residual over the joint's angle or stroke"
    confused_with = ("joint_spring",)
    of_position = True
    sources = ("Kircanski and Goldenberg 1997",)
    experiment = "slow_sweep"
    told_from = MappingProxyType(
        {"slow_sweep": ("offset", "gravity_compensator", "position_dependent_friction", "joint_elasticity")}
    )
    often_missed = 4

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a per cent of the largest torque; 20 waves a turn, or one in the lead of a screw."""
        torque = get_largest_torque(robot, joint)
        waves = 2.0 * np.pi / _LEAD if robot.joints[joint].kind == "prismatic" else 20.0
        return UsualSize({"Ac": 0.012 * torque, "As": 0.009 * torque}, {"k": waves})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return a cosine and a sine column a joint."""
        constants = self.shape_with_defaults(shape)
        columns = []
        for j in joints:
            k = constants["k"]
            cosine, sine = ca.cos(k * signals.q[j]), ca.sin(k * signals.q[j])
            # Torque that is a function of position alone has an energy: its integral over the position.
            stored = (partial(ca.SX, sine / k), partial(ca.SX, -cosine / k))
            for spec, wave, energy in zip(self.parameters, (cosine, sine), stored, strict=True):
                columns.append(self._column(signals, spec, j, wave, constants, energy))
        return columns


class BaseTilt(Effect):
    """Gravity in another direction than in the description: the whole robot is tilted."""

    id = "base_tilt"
    title = "Tilted base"
    formula = r"\delta g_x\, G_x(q) + \delta g_y\, G_y(q) + t_c \cos q_1 + t_s \sin q_1"
    parameters = (
        ParameterSpec(
            "gx", "m/s²", "gravity along the first direction perpendicular to the nominal gravity", least=0.01, most=2.0
        ),
        ParameterSpec(
            "gy",
            "m/s²",
            "gravity along the second direction perpendicular to the nominal gravity",
            least=0.01,
            most=2.0,
        ),
        ParameterSpec("tc", "N m", "weight of the first link about a vertical first axis, cosine part"),
        ParameterSpec("ts", "N m", "weight of the first link about a vertical first axis, sine part"),
    )
    signature = "sine and cosine of the first joint's angle, on all joints at once"
    confused_with = ("offset",)
    sources = ("Khalil and Dombre 2002, chapter 9",)
    scope = "robot"
    first_order = True
    needs_load = True
    may_change = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: two degrees, in a direction between the axes."""
        lean = float(np.linalg.norm(robot.gravity)) * np.sin(np.radians(2.0))
        return UsualSize({"gx": 0.8 * lean, "gy": -0.6 * lean})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return the torque that a tilt of gravity by one m/s² adds to the model so far, and that of the first link.

        About an upright first axis the first link has no gravity torque on a level base, so that the place of its mass
        is not identified. Two columns of their own stand for its torque on a tilted base.
        """
        # To first order a small tilt turns gravity, and adds a component across it: two directions are enough.
        directions = get_horizontal_directions(signals.robot.gravity)
        torques = [signals.predicted.build_gravity_torque(direction) for direction in directions]
        for wave in (ca.cos(signals.q[0]), ca.sin(signals.q[0])):
            rows = ca.SX(signals.robot.n, 1)
            if signals.robot.joints[0].kind == "revolute":
                rows[0] = wave
            torques.append(rows)
        return [self._robot_column(spec, torque) for spec, torque in zip(self.parameters, torques, strict=True)]

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Return all joints, or none without gravity."""
        return tuple(range(robot.n)) if float(np.linalg.norm(robot.gravity)) > 0 else ()


class TransmissionCoupling(Effect):
    """One motor that turns two joints: friction and rotor inertia of v_j ± v_{j+1} on both of them."""

    id = "transmission_coupling"
    title = "Transmission coupling"
    hardware = "coupled_wrist"
    appearance = "Friction that two joints share"
    sits_on = "motor"
    formula = (
        r"\pm\left(I_m (\ddot q_j \pm \ddot q_{j+1}) + F_{vm} (\dot q_j \pm \dot q_{j+1})"
        r" + F_{cm}\,\mathrm{sign}(\dot q_j \pm \dot q_{j+1})\right)"
    )
    parameters = (
        ParameterSpec("Iam", "kg m²", "inertia of the shared motor, referred to the joints", positive=True),
        ParameterSpec("Fvm", "N m s/rad", "viscous friction of the shared motor", positive=True),
        ParameterSpec("Fcm", "N m", "Coulomb friction of the shared motor", positive=True),
    )
    shapes = (
        ShapeSpec(
            "side",
            "-",
            "+1: the motor turns with the sum of the joints, -1: with the difference",
            1.0,
            signed=True,
            words=((1.0, "sum"), (-1.0, "difference")),
        ),
    )
    signature = "the friction of a joint depends on the velocity of the next"
    confused_with = ("coulomb", "viscous")
    sources = ("Khalil and Dombre 2002, chapter 9",)
    is_friction = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a fifth to a third of the usual drive."""
        torque = get_largest_torque(robot, joint)
        values = {
            "Iam": 0.2 * ROTOR_SHARE * torque,
            "Fvm": 0.3 * VISCOUS_SHARE * torque / get_velocity_scale(robot, joint),
            "Fcm": 0.3 * COULOMB_SHARE * torque,
        }
        return UsualSize(values, {"side": 1.0})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return three columns for every joint of `joints` and the one after it, each on both rows."""
        constants = self.shape_with_defaults(shape)
        # A choice between two kinds, as the sign of a number.
        side = 1.0 if constants["side"] >= 0 else -1.0
        columns = []
        for j in joints:
            velocity = signals.dq[j] + side * signals.dq[j + 1]
            acceleration = signals.ddq[j] + side * signals.ddq[j + 1]
            # The friction of a shared motor has the sign of its own velocity, not of either joint's.
            direction = signals.sign_of(velocity)
            for spec, torque in zip(self.parameters, (acceleration, velocity, direction), strict=True):
                # By virtual work the shared motor acts on the second joint with the sign of its share in v_j ± v_{j+1}.
                rows = ca.SX(signals.robot.n, 1)
                rows[j] = torque
                rows[j + 1] = side * torque
                columns.append(
                    Column(
                        effect=self.id,
                        parameter=spec.name,
                        name=f"{spec.name}{j + 1}",
                        link=signals.robot.joints[j].name,
                        unit=spec.unit,
                        torque=rows,
                        shape=tuple(constants.items()),
                        energy=partial(_build_half_square, velocity) if spec.name == "Iam" else None,
                    )
                )
        return columns

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Return revolute joints whose successor in the chain is revolute too."""
        return tuple(
            j
            for j in range(robot.n - 1)
            if robot.joints[j + 1].parent == j
            and robot.joints[j].kind == "revolute"
            and robot.joints[j + 1].kind == "revolute"
        )

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return sum and difference."""
        return [{"side": 1.0}, {"side": -1.0}]


def get_horizontal_directions(gravity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (3,) at right angles to gravity and each other; x and y where gravity is along z."""
    down = gravity / np.linalg.norm(gravity)
    # Start from the axis that is farthest from gravity, so that the projection is not lost in rounding.
    least = int(np.argmin(np.abs(down)))
    first = np.eye(3)[least] - down[least] * down
    first /= np.linalg.norm(first)
    second = np.cross(-down, first)
    return first, second


def _build_half_square(q: ca.SX) -> ca.SX:
    return 0.5 * q * q
