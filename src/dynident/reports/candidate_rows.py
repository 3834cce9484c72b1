"""The candidates of a diagnosis as rows of text, for the command line and for notebooks."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.diagnosis import RankedEffect
from dynident.reports.numbers import format_percent
from dynident.reports.words import format_joints, get_effect_title
from dynident.robot import Robot

CANDIDATE_COLUMNS = ("rank", "effect", "joints", "error before", "after", "drop", "significant")


def format_candidates(ranked: Iterable[RankedEffect], robot: Robot) -> list[tuple[str, ...]]:
    """Return ranked candidates as rows of text.

    Parameters
    ----------
    ranked : iterable of RankedEffect
        Best first.
    robot : Robot
        The diagnosed robot.

    Returns
    -------
    list of tuples of str
        With the cells of `COLUMNS`.
    """
    return [
        (
            str(candidate.rank),
            get_effect_title(candidate.effect),
            format_joints(candidate.joints, robot.joint_names),
            format_percent(candidate.error_before),
            format_percent(candidate.error_after),
            format_percent(candidate.error_drop, 2),
            "yes" if candidate.significant else "no",
        )
        for candidate in ranked
    ]
