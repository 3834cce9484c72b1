"""Contacts of unknown force: projections of the equations of motion that no force on the feet appears in.

With J the velocities of the feet per velocity of the joints, the forces f of the ground add Jᵀf to the torques. The
projection P = 1 - J⁺J takes them away, PJᵀ = 0, so that P W χ = P τ holds whatever they are. It holds for a foot in the
air too, whose force is zero: that costs information, but makes no error.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.joint import Contact
from dynident.robot.robot_model import Robot

_TITLE = "Unusable contact"
_RANK = 1e-8
"""Share of the largest singular value of J below which a direction counts as none: two feet that cannot move apart."""


def parse_contact(text: str) -> Contact:
    """Return the contact that a text names: `left_foot` for a sole, `calf@0,0,-0.21` for a point of a link (m).

    Raises
    ------
    DynidentError
        For a point that is not three finite numbers.
    """
    link, sign, place = text.partition("@")
    if not sign:
        return Contact(text.strip())
    try:
        x, y, z = (float(number) for number in place.split(","))
        if not all(map(isfinite, (x, y, z))):
            raise ValueError
    except ValueError:
        raise DynidentError(
            f"The contact {text!r} names no point; write three numbers in m behind the @: calf@0,0,-0.21.",
            pointer="/contacts",
            title=_TITLE,
        ) from None
    return Contact(link.strip(), (x, y, z))


def read_contacts(robot: Robot, texts: Sequence[str]) -> tuple[Contact, ...]:
    """Return the contacts of a robot whose base floats.

    Parameters
    ----------
    robot : Robot
        The robot.
    texts : sequence of str
        As `parse_contact` reads them.

    Returns
    -------
    tuple of Contact

    Raises
    ------
    DynidentError
        For another base, a contact on a link that does not move by itself, or a point that is not three numbers.
    """
    if texts and robot.base != "floating":
        raise DynidentError(
            f"Contacts are eliminated from the equations of a floating base, but {robot.name} has a {robot.base} one.",
            pointer="/contacts",
            title=_TITLE,
        )
    contacts = tuple(parse_contact(text) for text in texts)
    for contact in contacts:
        _find_link(robot, contact)
    return contacts


def _find_link(robot: Robot, contact: Contact) -> int:
    links = [joint.link or joint.name for joint in robot.tree.joints]
    if contact.link not in links[robot.n_massless :]:
        raise DynidentError(
            f"There is no link '{contact.link}' that moves by itself; links: {', '.join(links[robot.n_massless :])}.",
            pointer="/contacts",
            title=_TITLE,
        )
    return links.index(contact.link)


def compute_contact_jacobian(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the velocities of a robot's contacts per velocity of its driven joints.

    Parameters
    ----------
    robot : Robot
        The robot, with contacts.
    q : ndarray (m, n)
        Positions of the driven joints, rad or m.

    Returns
    -------
    ndarray (m, k, n)
        Along the axes of the world: three rows for a point, and three more, of the angular velocity, for a sole.
    """
    frames, tree = joint_frames(robot, q), robot.tree
    blocks = []
    for contact in robot.contacts:
        link = _find_link(robot, contact)
        place = frames[:, link, :3, 3]
        if contact.point is not None:
            place = place + frames[:, link, :3, :3] @ np.array(contact.point)
        linear, angular = np.zeros((2, len(q), 3, tree.n))
        for index in tree.list_ancestors(link):
            joint = tree.joints[index]
            axis = frames[:, index, :3, :3] @ joint.axis
            if joint.kind == "revolute":
                linear[:, :, index] = np.cross(axis, place - frames[:, index, :3, 3])
                angular[:, :, index] = axis
            else:
                linear[:, :, index] = axis
        blocks += [linear] if contact.point is not None else [linear, angular]
    jacobian = np.concatenate(blocks, axis=1)
    return jacobian if robot.linkage is None else jacobian @ robot.linkage.compute_jacobian(q)


def compute_contact_projection(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the projection P = 1 - J⁺J that takes the forces of a robot's contacts away.

    Parameters
    ----------
    robot : Robot
        The robot; without contacts P is the identity.
    q : ndarray (m, n)
        Positions of the driven joints, rad or m.

    Returns
    -------
    ndarray (m, n, n)
        P at each position.
    """
    if not robot.contacts:
        return np.broadcast_to(np.eye(robot.n), (len(q), robot.n, robot.n))
    jacobian = compute_contact_jacobian(robot, q)
    return np.asarray(np.eye(robot.n) - np.linalg.pinv(jacobian, rcond=_RANK) @ jacobian)
