"""The figures behind a diagnosis's ranked effects: written once, read as they are asked for."""

from __future__ import annotations

import json
from collections.abc import Sequence

from dynident.diagnosis import Evidence
from dynident.robot import Robot
from dynident_service.adapters.answers import shown
from dynident_service.models import diagnoses as wire
from dynident_service.models.common import plain
from dynident_service.problems import ProblemError, unusable


def write_evidence(found: Sequence[Evidence], robot: Robot) -> bytes:
    """Write all figures of a diagnosis."""
    return json.dumps([plain(_shown(one, found, robot)) for one in found]).encode()


def read_evidence(content: bytes, rank: int, joint: str | None) -> wire.Evidence:
    """Read the figure of a ranked effect on a joint, or on that which it explains most of.

    Raises
    ------
    ProblemError
        404 where there is none of that rank, 422 where there is none for that joint.
    """
    found = [one for one in json.loads(content) if one["rank"] == rank]
    if not found:
        raise ProblemError(404, f"There is no figure for the effect of rank {rank}.", title="No figure")
    joints: list[str] = found[0]["joints"]
    wanted = joints[0] if joint is None else joint
    if wanted not in joints:
        raise unusable(f"there is no figure for {wanted!r}; there are some for: {', '.join(joints)}", "joint")
    return wire.Evidence.model_validate(next(one for one in found if one["joint"] == wanted))


def _shown(one: Evidence, found: Sequence[Evidence], robot: Robot) -> wire.Evidence:
    same = sorted((other for other in found if other.rank == one.rank), key=lambda other: -other.explained)
    return shown(
        wire.Evidence,
        one,
        joints=[other.joint for other in same],
        effort_unit=robot.joints[robot.joint_names.index(one.joint)].effort_unit,
    )
