"""What a diagnosis ranks, in words: the same on the command line and in a notebook."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.diagnosis import RankedEffect
from dynident.reports.numbers import percent
from dynident.reports.words import place_text, title_of
from dynident.robot import Robot

COLUMNS = ("rank", "effect", "joints", "error before", "after", "drop", "significant")


def candidate_rows(ranked: Iterable[RankedEffect], robot: Robot) -> list[tuple[str, ...]]:
    """A row of `COLUMNS` for each."""
    return [
        (
            str(one.rank),
            title_of(one.effect),
            place_text(one.joints, robot.joint_names),
            percent(one.error_before),
            percent(one.error_after),
            percent(one.error_drop, 2),
            "yes" if one.significant else "no",
        )
        for one in ranked
    ]
