"""Joints that move but whose torque was not recorded: some drivers have no interface for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.recordings.columns import Layout, mark_not_recorded
from dynident.recordings.raw import FileSource
from dynident.recordings.types import Check


def mark_empty_torques(layout: Layout, file: FileSource) -> Layout:
    """Mark torques without a number in any row of a file as not recorded.

    Not where motors act on several joints: each torque is then made of several columns. Nor where no torque holds a
    number, of which the checks say that nothing can be identified from it.

    Parameters
    ----------
    layout : Layout
    file : FileSource

    Returns
    -------
    Layout
    """
    if layout.mixing is not None:
        return layout
    torques = Layout(t=layout.t, segment=None, q=layout.tau, tau=())
    holds_numbers = np.zeros(len(layout.tau), dtype=bool)
    for rows in file.rows(torques):
        holds_numbers |= np.isfinite(rows.values).any(axis=0)
        # As a rule the first rows show that every torque was recorded.
        if holds_numbers.all():
            return layout
    if not holds_numbers.any():
        return layout
    tau = tuple(
        torque if recorded else mark_not_recorded(position)
        for torque, position, recorded in zip(layout.tau, layout.q, holds_numbers, strict=True)
    )
    empty = {int(joint) for joint in np.flatnonzero(~holds_numbers)}
    return replace(layout, tau=tau, without_torque=tuple(sorted(empty | set(layout.without_torque))))


def report_missing_torques(layout: Layout, joint_names: Sequence[str]) -> tuple[Check, ...]:
    """Return a warning that names the joints without torque, if there are any."""
    if not layout.without_torque:
        return ()
    names = [joint_names[joint] for joint in layout.without_torque]
    several = len(names) > 1
    return (
        Check(
            "joint_torque",
            "warning",
            f"{', '.join(names)} {'have' if several else 'has'} no torque: {'their' if several else 'its'} equation"
            f"{'s are' if several else ' is'} left out, {'their' if several else 'its'} motion is used. What only "
            f"{'these torques' if several else 'this torque'} would show ({'their' if several else 'its'} friction and "
            "drive inertia, of a first joint its inertia, too) is not identifiable. If a joint is none of the robot's, "
            f"as a finger is not, lock it: {', '.join(names)}.",
        ),
    )
