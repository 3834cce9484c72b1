"""Contacts of unknown force: projections of the equations of motion that no force on the feet appears in.

With J the velocities of the feet per velocity of the joints, the forces f of the ground add Jᵀf to the torques. The
projection P = 1 - J⁺J takes them away, PJᵀ = 0, so that P W χ = P τ holds whatever they are. It holds for a foot in the
air too, whose force is zero: that costs information, but makes no error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.joint import Contact
from dynident.robot.json_fields import expect_names
from dynident.robot.robot_model import Robot

Mixing = tuple[slice, FloatArray, FloatArray | None]
"""Some samples, and the matrices of `yield_mixing_matrices` there."""
_TITLE = "Unusable contact"
_FARTHEST = 1e4
"""Largest coordinate of a contact in the frame of its link, m."""
_STEP = 1e-4
"""Step of a joint by which slopes are taken, rad or m."""
_RANK = 1e-8
"""Share of the largest singular value of J below which a direction counts as none: two feet that cannot move apart."""
_SURE_RANK = 1e-5
"""The same of the triangular factor of Jᵀ, down to which J has full rank; below it, its singular values decide."""
_SHOWN = 1e-4
"""Share of a joint's torque, squared, below which the projected equations do not show it: 1 % of its friction."""


def parse_contact(text: str, pointer: str = "/contacts") -> Contact:
    """Return the contact that a text names.

    Parameters
    ----------
    text : str
        `left_foot` for a sole, `calf@0,0,-0.21` for a point of a link (m), `calf@0,0,-0.21,0.02` for a ball of 0.02 m
        around it; `^0.03` behind it for a contact that touches nothing where it is 0.03 m above the lowest one.
    pointer : str
        Place of the text in the request, for errors.

    Raises
    ------
    DynidentError
        For a point that is not three numbers, or four, or farther away than 10 km, and for a height that is no number
        above zero.
    """
    rest, has_lift, height = text.partition("^")
    link, has_place, place = rest.partition("@")
    try:
        lift = float(height) if has_lift else None
        numbers = [float(number) for number in place.split(",")] if has_place else []
        # Python reads "nan" and "inf" as numbers, too.
        if not all(abs(number) <= _FARTHEST for number in numbers) or len(numbers) not in (0, 3, 4):
            raise ValueError(place)
        if not all(0.0 < size <= _FARTHEST for size in (*numbers[3:], *([] if lift is None else [lift]))):
            raise ValueError(text)
    except ValueError:
        raise DynidentError(
            f"The contact {text!r} cannot be read; write a link, its point as three numbers in m behind an @ (a fourth "
            "is the radius of a ball), and the height in m above the lowest contact from which on it touches nothing "
            "behind a ^: foot, calf@0,0,-0.21 or calf@0,0,-0.21,0.02^0.03.",
            pointer=pointer,
            title=_TITLE,
        ) from None
    point = (numbers[0], numbers[1], numbers[2]) if numbers else None
    return Contact(link.strip(), point, numbers[3] if len(numbers) == 4 else 0.0, lift)


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
        For no list of texts, another base, a contact on a link that does not move by itself, a point that is not three
        numbers, or heights that nothing can be compared with.
    """
    names = expect_names(texts, "/contacts", _TITLE)
    if names and robot.base != "floating":
        raise DynidentError(
            f"Contacts are eliminated from the equations of a floating base, but {robot.name} has a {robot.base} one.",
            pointer="/contacts",
            title=_TITLE,
        )
    contacts = tuple(parse_contact(text) for text in names)
    for contact in contacts:
        find_contact_link(robot, contact)
    _check_heights(contacts)
    return contacts


def _check_heights(contacts: Sequence[Contact]) -> None:
    lifted = [contact for contact in contacts if contact.lift is not None]
    if not lifted:
        return
    if len(contacts) == 1:
        raise DynidentError(
            f"The height in {str(contacts[0])!r} is that above the lowest contact, but there is no other one. Name all "
            "feet, or leave the ^ and the height out.",
            pointer="/contacts",
            title=_TITLE,
        )
    if len({contact.point is None for contact in contacts}) > 1:
        raise DynidentError(
            f"With the height in {str(lifted[0])!r} contacts are compared, but some are points and some are links, "
            "whose heights are those of their frames. Give a point of every foot, or of none.",
            pointer="/contacts",
            title=_TITLE,
        )


def find_contact_link(robot: Robot, contact: Contact, pointer: str = "/contacts") -> int:
    """Return the index of the joint of the tree that carries the link of a contact.

    Parameters
    ----------
    robot : Robot
        The robot.
    contact : Contact
        The contact.
    pointer : str
        Place of the contact in the request, for errors.

    Raises
    ------
    DynidentError
        If no link that moves by itself has this name.
    """
    links = [joint.link or joint.name for joint in robot.tree.joints]
    if contact.link not in links[robot.n_massless :]:
        raise DynidentError(
            f"There is no link '{contact.link}' that moves by itself; links: {', '.join(links[robot.n_massless :])}.",
            pointer=pointer,
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
    return _compute_jacobian(robot, q, joint_frames(robot, q))


def _compute_jacobian(robot: Robot, q: FloatArray, frames: FloatArray) -> FloatArray:
    tree, blocks = robot.tree, []
    # Axes and origins of all joints (3, m, N): vector products of whole arrays take a tenth of the time of many calls.
    directions = np.stack([joint.axis for joint in tree.joints])
    axes = np.moveaxis(np.einsum("mnij,nj->mni", frames[:, :, :3, :3], directions), 2, 0)
    origins = np.moveaxis(frames[:, :, :3, 3], 2, 0)
    for contact in robot.contacts:
        link = find_contact_link(robot, contact)
        # The force acts on the part of a ball that touches the ground.
        place = locate_contact(robot, contact, frames) - contact.radius * find_upwards(robot)
        ancestors = tree.list_ancestors(link)
        turning = [k for k in ancestors if tree.joints[k].kind == "revolute"]
        sliding = [k for k in ancestors if tree.joints[k].kind != "revolute"]
        linear, angular = np.zeros((2, len(q), 3, tree.n))
        (ax, ay, az), (x, y, z) = axes[:, :, turning], place.T[:, :, None] - origins[:, :, turning]
        linear[:, :, turning] = np.stack([ay * z - az * y, az * x - ax * z, ax * y - ay * x], axis=1)
        linear[:, :, sliding] = np.moveaxis(axes[:, :, sliding], 0, 1)
        angular[:, :, turning] = np.moveaxis(axes[:, :, turning], 0, 1)
        blocks += [linear] if contact.point is not None else [linear, angular]
    jacobian = np.concatenate(blocks, axis=1)
    return jacobian if robot.linkage is None else jacobian @ robot.linkage.compute_jacobian(q)


def find_upwards(robot: Robot) -> FloatArray:
    """Return the unit vector (3,) against gravity; z where there is none."""
    size = float(np.linalg.norm(robot.gravity))
    return -robot.gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])


def locate_contact(robot: Robot, contact: Contact, frames: FloatArray) -> FloatArray:
    """Return the point of a contact in the world: the centre of a ball; of a sole the origin of its link.

    Parameters
    ----------
    robot : Robot
        The robot.
    contact : Contact
        The contact.
    frames : (m, N, 4, 4)
        Frames of the joints of the tree, as `joint_frames` gives them.

    Returns
    -------
    (m, 3)
        m.
    """
    frame = frames[:, find_contact_link(robot, contact)]
    return np.asarray(frame[:, :3, 3] + frame[:, :3, :3] @ np.array(contact.point or (0.0, 0.0, 0.0)))


def compute_contact_heights(robot: Robot, q: FloatArray) -> FloatArray:
    """Return how high (m, k) each contact is at positions q (m, n): its point, or the lowest one of a ball."""
    return _compute_heights(robot, joint_frames(robot, q))


def _compute_heights(robot: Robot, frames: FloatArray) -> FloatArray:
    up = find_upwards(robot)
    return np.stack(
        [locate_contact(robot, contact, frames) @ up - contact.radius for contact in robot.contacts], axis=1
    )


def _compute_shares(robot: Robot, frames: FloatArray) -> FloatArray:
    """Return the share (m, k) of each row of J that is eliminated: 1 where a contact may touch, 0 where it is lifted.

    From the height on at which a contact touches nothing, the share falls smoothly to 0 at twice that height: a step
    would put the measured torques, projected at measured positions, beside columns that are projected at filtered ones.
    """
    heights = _compute_heights(robot, frames)
    lowest, shares = heights.min(axis=1), []
    for contact, height in zip(robot.contacts, heights.T, strict=True):
        rise = 0.0 if contact.lift is None else np.clip((height - lowest) / contact.lift - 1.0, 0.0, 1.0)
        share = np.broadcast_to(1.0 - rise**2 * (3.0 - 2.0 * rise), lowest.shape)
        shares += [share] * (3 if contact.point is not None else 6)
    return np.stack(shares, axis=1)


def find_mixed_joints(robot: Robot) -> BoolArray:
    """Return which driven joints (n,) move a contact: the projection mixes their equations, and no others."""
    if robot.contacts and robot.linkage is not None:
        return np.ones(robot.n, dtype=bool)
    moved = {
        index for contact in robot.contacts for index in robot.tree.list_ancestors(find_contact_link(robot, contact))
    }
    return np.isin(np.arange(robot.n), sorted(moved))


def compute_contact_projection(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the matrix P = 1 - J⁺J that takes the forces of a robot's contacts away.

    Of a contact that is lifted only a share s of its rows is eliminated, and P is no projection there. With S the
    diagonal matrix of the shares, P is the part of 1 - A⁺A, A = [SJ, √(1 - S²)], that belongs to the joints: PJᵀf = 0
    still holds for all forces f of contacts with s = 1.

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
    n = robot.n
    if not robot.contacts:
        return np.broadcast_to(np.eye(n), (len(q), n, n))
    frames = joint_frames(robot, q)
    shares = _compute_shares(robot, frames)
    jacobian = shares[:, :, None] * _compute_jacobian(robot, q, frames)
    if (shares < 1.0).any():
        jacobian = np.concatenate([jacobian, np.sqrt(1.0 - shares**2)[:, :, None] * np.eye(shares.shape[1])], axis=2)
    return _project_on_null_space(jacobian)[:, :n, :n]


def _project_on_null_space(matrices: FloatArray) -> FloatArray:
    """Return 1 - A⁺A (m, n, n) of matrices A (m, k, n)."""
    if matrices.shape[1] > matrices.shape[2]:
        return np.asarray(np.eye(matrices.shape[2]) - np.linalg.pinv(matrices, rcond=_RANK) @ matrices)
    # With full rank A⁺A = QQᵀ for Aᵀ = QR, some six times as fast as singular values.
    basis, factor = np.linalg.qr(matrices.transpose(0, 2, 1))
    projection = np.eye(matrices.shape[2]) - basis @ basis.transpose(0, 2, 1)
    diagonal = np.abs(np.diagonal(factor, axis1=1, axis2=2))
    deficient = diagonal.min(axis=1) <= _SURE_RANK * diagonal.max(axis=1)
    if deficient.any():
        few = matrices[deficient]
        projection[deficient] = np.eye(few.shape[2]) - np.linalg.pinv(few, rcond=_RANK) @ few
    return np.asarray(projection)


def find_largest_zero_errors(robot: Robot, motions: Sequence[tuple[FloatArray, FloatArray]]) -> dict[str, float]:
    """Return the largest errors of joints' zero positions, by joint, that contacts which do not slide allow.

    A contact that stands moves by itself as soon as a joint between it and the base is somewhere else than measured.
    The error of each joint is what explains most of the computed sliding, alone.

    Parameters
    ----------
    robot : Robot
        The robot; nothing is said of joints that move no contact.
    motions : sequence of ((m, n), (m, n))
        Positions and velocities of recordings with the same zero positions.

    Returns
    -------
    dict of str to float
        Estimate and three standard deviations, rad or m.
    """
    if not robot.contacts or robot.linkage is not None:
        return {}
    joints = [j for j in np.flatnonzero(find_mixed_joints(robot)) if j >= robot.n_base]
    products, squares = np.zeros((2, len(joints)))
    for q, dq in motions:
        sliding, is_standing = _compute_sliding(robot, q, dq)
        slopes = np.zeros((len(joints), *sliding.shape))
        for k, joint in enumerate(joints):
            step = np.zeros(robot.n)
            step[joint] = _STEP
            slopes[k] = (_compute_sliding(robot, q + step, dq)[0] - sliding) / _STEP
        slopes, sliding = slopes[:, is_standing], sliding[is_standing]
        # Recordings in which feet roll or slide count for less.
        weight = 1.0 / max(float(np.mean(sliding**2)) if sliding.size else 0.0, np.finfo(float).tiny)
        products -= weight * (slopes @ sliding)
        squares += weight * (slopes**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        largest = np.abs(products / squares) + 3.0 / np.sqrt(squares)
    return {robot.joint_names[j]: float(most) for j, most in zip(joints, largest, strict=True) if np.isfinite(most)}


def _compute_sliding(robot: Robot, q: FloatArray, dq: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the velocities (m, k) of contacts, and which of them certainly touch."""
    frames = joint_frames(robot, q)
    velocities = np.einsum("mkn,mn->mk", _compute_jacobian(robot, q, frames), dq)
    return velocities, np.asarray(_compute_shares(robot, frames) == 1.0)


def _compute_elimination(projection: FloatArray, unknown: BoolArray) -> FloatArray:
    """Return the matrix E (m, n, n) that takes the torques of some joints out of the projected equations of the others.

    With P the projection of the contacts, E P has no column of these joints, as if J had a row more for each of them
    that stands; their own rows of it are zero.
    """
    own = projection * (unknown[:, :, None] & unknown[:, None, :])
    sizes, directions = np.linalg.eigh(own)
    # Of a torque that P takes away almost wholly, the rest tells nothing.
    inverse = np.where(sizes > _SHOWN, 1.0 / np.maximum(sizes, _SHOWN), 0.0)
    pseudoinverse = (directions * inverse[:, None, :]) @ np.swapaxes(directions, 1, 2)
    return np.asarray(np.eye(projection.shape[1]) - projection @ pseudoinverse)


def yield_mixing_matrices(robot: Robot, q: FloatArray, unknown: BoolArray | None) -> Iterator[Mixing]:
    """Yield how the equations of the joints that move a contact are mixed, a few samples at a time.

    Parameters
    ----------
    robot : Robot
        The robot, with contacts.
    q : ndarray (m, n)
        Positions of the driven joints, rad or m.
    unknown : ndarray (m, n) of bool, optional
        Joints of those that move a contact whose torques are not known.

    Yields
    ------
    (slice, ndarray (s, k, k), ndarray (s, k, k) or None)
        Samples, E P of the k joints of `find_mixed_joints`, and E; None where it is the identity.
    """
    mixed = np.flatnonzero(find_mixed_joints(robot))
    for first in range(0, len(q), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        mixing = compute_contact_projection(robot, q[part])[:, mixed][:, :, mixed]
        elimination = None
        if unknown is not None and unknown[part].any():
            stands = unknown[part][:, mixed]
            some = stands.any(axis=1)
            elimination = np.zeros_like(mixing)
            elimination[:] = np.eye(len(mixed))
            elimination[some] = _compute_elimination(mixing[some], stands[some])
            mixing = elimination @ mixing
        yield part, mixing, elimination


_AT_ONCE = 256
"""Samples: with fewer, calls cost more than they compute; with more, what is in between needs memory for nothing."""
