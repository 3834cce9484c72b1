"""`Robot` and its parts: joints, drive chains, coupling of motors, ties and cut joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError, KnownNames
from dynident.robot.description_formats import BASE_JOINTS, BaseKind, DescriptionFormat
from dynident.robot.joint import Contact, Joint, join_joint_names
from dynident.robot.limits_and_drives import Drive
from dynident.text_and_html_tables import join_html, render_paragraph, render_table
from dynident.text_encoding import escape_surrogates

if TYPE_CHECKING:
    from dynident.robot.loop_closure import Closure


def coupling_matrix(robot: Robot) -> FloatArray | None:
    """Return the coupling C of motors and joints: motor j turns with Σ C_jk q̇_k times its gear ratio.

    The power of the motors equals that of the joints, so the joint torques are Γ = Cᵀ diag(g) u, with the drive gains
    g of [12.17] and the currents u. The diagonal is one: the gains of [12.17] hold for the motor's own joint.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    ndarray (n, n) or None
        None where every motor moves one joint only.
    """
    if not any(drive.coupling for drive in robot.drives):
        return None
    matrix = np.eye(robot.n)
    for j, drive in enumerate(robot.drives):
        for name, share in drive.coupling.items():
            matrix[j, robot.joint_names.index(name)] = share
    return matrix


def compute_currents(robot: Robot, tau: FloatArray) -> FloatArray:
    """Return the currents that give joint torques.

    Parameters
    ----------
    robot : Robot
        The robot, with its drive chains.
    tau : (m, n)
        Joint torques, N m or N.

    Returns
    -------
    (m, n) array
        Currents; NaN where a drive gain is not known.
    """
    gains = np.array([drive.gain or np.nan for drive in robot.drives])
    matrix = coupling_matrix(robot)
    # Γ = Cᵀ diag(g) u, solved for u.
    motors = tau if matrix is None else np.linalg.solve(matrix.T, tau.T).T
    return np.asarray(motors / gains)


INERTIAL_NAMES = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
"""The inertial parameters of a link in the order of [12.1], about the origin of the joint's own frame."""


@dataclass(frozen=True)
class Description:
    """The text that a robot was read from, and its format.

    Parameters
    ----------
    format : {"urdf", "mjcf", "modified_dh", "dh"}
        Format of the text; a robot of a table that was pasted as text ("dh") has the same table as JSON.
    content : str
        The text.
    """

    format: DescriptionFormat
    content: str = field(repr=False)


@dataclass(frozen=True, eq=False)
class Robot(KnownNames):
    """A tree of joints on a base that is fixed, or that moves by coordinates of its own (`BASE_JOINTS`).

    Where some joints follow others, `joints` are the driven ones alone, which data, drives and limits refer to;
    `linkage` then has the tree that carries the links.

    Parameters
    ----------
    name : str
        Name of the robot.
    joints : tuple of Joint
        Every antecedent comes before its successors.
    gravity : ndarray (3,)
        Acceleration of gravity in the base frame (m/s²).
    drives : tuple of Drive
        Drive chain of each joint.
    description : Description
        The text that the robot was read from.
    inertias : ndarray (N, 10) or None
        Inertial parameters of the description for all N links of the tree, in the order of `INERTIAL_NAMES`; None
        where it has none.
    locked_joints : mapping of str to float
        Positions (rad, m) of the joints that were locked, by name.
    linkage : Linkage or None
        How dependent joints follow the driven ones.
    joints_without_torque : tuple of str
        Joints whose torque is in none of the data for identification; what only their equations would show is not
        identifiable.
    has, has_not : tuple of str
        Parts that the owner knows the robot to have or not to have, of `dynident.robot.stated_settings.HARDWARE`;
        diagnoses ask about the others.
    base : {"fixed", "floating", "planar"}
        Whether the root link moves; its coordinates are then the first joints.
    contacts : tuple of Contact
        Links of a robot with a floating base on which unknown forces act, such as feet. Its equations, and the torques
        of its recordings, are projected so that these forces do not appear in them (`dynident.robot.contacts`).
    """

    name: str
    joints: tuple[Joint, ...]
    gravity: FloatArray
    drives: tuple[Drive, ...]
    description: Description
    inertias: FloatArray | None = None
    locked_joints: Mapping[str, float] = field(default_factory=dict)
    linkage: Linkage | None = None
    joints_without_torque: tuple[str, ...] = ()
    has: tuple[str, ...] = ()
    has_not: tuple[str, ...] = ()
    base: BaseKind = "fixed"
    contacts: tuple[Contact, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", escape_surrogates(self.name))

    def __repr__(self) -> str:
        gains = sum(drive.gain is not None for drive in self.drives)
        gain_text = f", {gains} with a drive gain" if gains else ""
        base_text = "" if self.base == "fixed" else f" on a {self.base} base"
        own = self.joint_names[self.n_base :]
        return f"Robot({self.name}: {len(own)} joints{base_text}{gain_text}: {', '.join(own)})"

    def _repr_html_(self) -> str:
        columns = ("joint", "kind", "after", "position", "velocity", "effort", "drive gain")
        rows = [
            (
                joint.name,
                joint.kind,
                self.joints[joint.parent].name if joint.parent >= 0 else "base",
                *_format_limits(joint),
                "–" if drive.gain is None else f"{drive.gain:.4g}",
            )
            for joint, drive in zip(self.joints, self.drives, strict=True)
        ]
        return join_html(
            render_paragraph(f"{self.name}: {self.n} joints", strong=True), render_table(columns, rows, right_from=3)
        )

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return len(self.joints)

    @property
    def n_base(self) -> int:
        """Number of coordinates of the base, which are the first joints: 0 for a fixed one."""
        return len(BASE_JOINTS[self.base])

    def require_fixed_base(self, purpose: str) -> None:
        """Raise where the base moves: `purpose`, such as "a design of a motion", is for fixed bases alone.

        Raises
        ------
        DynidentError
        """
        if self.base != "fixed":
            raise DynidentError(
                f"{self.name} has a {self.base} base, and there is no {purpose} for a base that moves. Read the robot "
                "with base fixed, as if it were held in a stand.",
                pointer="/robot",
                title="Not for a base that moves",
            )

    def require_no_contacts(self, purpose: str) -> None:
        """Raise where contacts are eliminated: the whole torque, and `purpose` with it, is not known then.

        Raises
        ------
        DynidentError
        """
        if self.contacts:
            raise DynidentError(
                f"{self.name} has contacts, whose unknown forces are eliminated. Nothing is known of the mass of a "
                f"link that stands, so no {purpose} is available; JSON and predictions have the projected torque.",
                pointer="/robot",
                title="Not with contacts",
            )

    @property
    def n_massless(self) -> int:
        """Number of leading joints that carry no link: all coordinates of the base but its last one."""
        return max(self.n_base - 1, 0)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints in the robot's order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def has_torque(self) -> BoolArray:
        """Which joints (n,) have a torque in the data that models of the robot are identified from."""
        return np.array([name not in self.joints_without_torque for name in self.joint_names], dtype=bool)

    @property
    def names_without_torque(self) -> str:
        """Names of the joints whose torque was not recorded, for a sentence; empty where there are none."""
        return join_joint_names(self.joints_without_torque, self.joint_names[self.n_base :])

    @property
    def hardware(self) -> dict[str, bool]:
        """Whether the robot has a part, by the part's name, as far as its owner has said."""
        return {**dict.fromkeys(self.has, True), **dict.fromkeys(self.has_not, False)}

    @property
    def tree(self) -> Robot:
        """The robot of all joints that carry links: this one, unless some of its joints follow others."""
        return self if self.linkage is None else self.linkage.tree

    def positions(self, q: FloatArray) -> FloatArray:
        """Return positions (m, N): those of the driven joints `q` (m, n), then those of the joints that follow."""
        if self.linkage is None:
            return q
        return np.hstack([q, self.linkage.compute_positions(q)[:, list(self.linkage.passive)]])

    def get_movers(self, name: str) -> tuple[int, ...]:
        """Return indices of the driven joints that a joint of the tree moves with: itself, or those that it follows."""
        if name in self.joint_names or self.linkage is None:
            return (self.joint_names.index(name),)
        return self.linkage.get_movers(self.tree.joint_names.index(name))

    def get_position_movers(self, place: int) -> tuple[int, ...]:
        """Return the same for a joint by its place in `positions`."""
        if place < self.n or self.linkage is None:
            return (place,)
        return self.linkage.get_movers(self.linkage.passive[place - self.n])

    def list_subtree(self, joint: int) -> tuple[int, ...]:
        """Return the indices of the joints that move with `joint`, itself first."""
        moved = {joint}
        # One pass is enough, since every antecedent comes before its successors.
        for index in range(joint + 1, self.n):
            if self.joints[index].parent in moved:
                moved.add(index)
        return tuple(sorted(moved))

    def list_ancestors(self, joint: int) -> tuple[int, ...]:
        """Return the indices of the joints that move `joint`, itself last."""
        chain = []
        while joint >= 0:
            chain.append(joint)
            joint = self.joints[joint].parent
        return tuple(reversed(chain))


@dataclass(frozen=True)
class Tie:
    """A joint that follows others: q = Σ ratio q_other + offset.

    `where` and `line` are its place in the description, for messages.
    """

    ratios: Mapping[str, float]
    offset: float = 0.0
    where: str = ""
    line: int = 0


@dataclass(frozen=True, eq=False)
class Linkage:
    """The tree that carries the links of a machine, and how its joints follow the driven ones.

    Attributes
    ----------
    tree : Robot
        The robot of all N joints.
    driven : tuple of int
        Indices of the n driven joints in the tree.
    ratios, offsets : (N, n + p), (N,)
        q = ratios [q_a; x] + offsets, with the p passive coordinates x that closed loops determine.
    ties : mapping of joint name to Tie
        Joints that follow others by fixed ratios.
    closure : Closure or None
        The closed loops, where there are any.
    """

    tree: Robot
    driven: tuple[int, ...]
    ratios: FloatArray
    offsets: FloatArray
    ties: Mapping[str, Tie] = field(default_factory=dict)
    closure: Closure | None = None

    @property
    def passive(self) -> tuple[int, ...]:
        """Indices of the joints in the tree that are not driven."""
        return tuple(j for j in range(self.tree.n) if j not in self.driven)

    def compute_positions(self, q: FloatArray) -> FloatArray:
        """Return the positions of all joints (m, N) at those of the driven ones (m, n)."""
        free = q if self.closure is None else np.hstack([q, self.closure.solve_passive(q)])
        return np.asarray(free @ self.ratios.T + self.offsets)

    def compute_jacobian(self, q: FloatArray) -> FloatArray:
        """Return G = ∂q/∂q_a (m, N, n) at driven positions q (m, n)."""
        if self.closure is None:
            return np.broadcast_to(self.ratios, (len(q), *self.ratios.shape))
        n, x = q.shape[1], self.closure.solve_passive(q)
        slopes = self.closure.compute_rates(q, x)
        return np.asarray(self.ratios[:, :n] + self.ratios[:, n:] @ slopes)

    def compute_motion(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration of all joints (m, N) from those of the driven ones (m, n)."""
        if self.closure is None:
            return self.compute_positions(q), dq @ self.ratios.T, ddq @ self.ratios.T
        passive = self.closure.compute_accelerations(q, self.closure.solve_passive(q), dq, ddq)
        speed = np.einsum("mij,mj->mi", self.compute_jacobian(q), dq)
        return self.compute_positions(q), speed, np.hstack([ddq, passive]) @ self.ratios.T

    def check_closed(self, t: FloatArray, q: FloatArray) -> None:
        """Check at some of the driven positions q (m, n), recorded at times t (m,), that the loops are closed.

        Raises
        ------
        DynidentError
            If a loop is open or a posture is singular: no recording of this machine can hold it.
        """
        if self.closure is not None:
            self.closure.check_closed(t, q)

    def follows_one_driven_joint(self, joint: int) -> bool:
        """Return whether a joint of the tree follows at most one driven joint, by a constant ratio."""
        joint_ratios = self.ratios[joint]
        return bool(
            np.count_nonzero(joint_ratios[: len(self.driven)]) < 2 and not joint_ratios[len(self.driven) :].any()
        )

    def get_movers(self, joint: int) -> tuple[int, ...]:
        """Return the places, among the driven joints, of those that a joint of the tree moves with."""
        n, driven_joints = len(self.driven), set()
        for place in np.flatnonzero(self.ratios[joint]):
            if place < n:
                driven_joints.add(int(place))
            elif self.closure is not None:
                driven_joints |= set(self.closure.get_movers(int(place) - n))
        return tuple(sorted(driven_joints))


def _format_limits(joint: Joint) -> tuple[str, str, str]:
    """Return limits of position, velocity and effort with their units; "–" where none is known."""
    limits, angle = joint.limits, "rad" if joint.kind == "revolute" else "m"
    position = "–" if limits.position is None else f"{limits.position[0]:.4g} … {limits.position[1]:.4g} {angle}"
    velocity = "–" if limits.velocity is None else f"{limits.velocity:.4g} {angle}/s"
    effort = "–" if limits.effort is None else f"{limits.effort:.4g} {joint.effort_unit}"
    return position, velocity, effort
