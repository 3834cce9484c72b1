"""The candidates of a diagnosis as rows of text, for the command line and for notebooks."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.diagnosis import RankedEffect
from dynident.reports.numbers import percent
from dynident.reports.words import place_text, title_of
from dynident.robot import Robot

COLUMNS = ("rank", "effect", "joints", "error before", "after", "drop", "significant")


def candidate_rows(ranked: Iterable[RankedEffect], robot: Robot) -> list[tuple[str, ...]]:
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
            title_of(candidate.effect),
            place_text(candidate.joints, robot.joint_names),
            percent(candidate.error_before),
            percent(candidate.error_after),
            percent(candidate.error_drop, 2),
            "yes" if candidate.significant else "no",
        )
        for candidate in ranked
    ]
