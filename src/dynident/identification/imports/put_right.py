"""Apply the corrections of an import to a sample, and report them with the user's names."""

from __future__ import annotations

import re

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.imports.facts import Sample, fill_gaps
from dynident.identification.imports.fits import DynamicsFits
from dynident.identification.imports.groups import ColumnGroup
from dynident.identification.imports.proposal import Guess
from dynident.recordings.types import RecordingError


def condition_sample(
    fits: DynamicsFits, rows: Sample, position: ColumnGroup, effort: ColumnGroup, q: FloatArray
) -> tuple[FloatArray, list[Guess]]:
    """Correct positions as an import will, and report the corrections.

    Parameters
    ----------
    fits : Fits
    rows : Sample
        The rows with a time.
    position, effort : Group
    q : (m, n)
        Positions in rad or m.

    Returns
    -------
    tuple of array (m, n) and guesses
    """
    positions, efforts = list(position.columns), list(effort.columns)
    known = np.where(np.isfinite(rows.values[:, positions]), q, np.nan)
    try:
        right, _, checks = fits.condition_signals(known, rows.values[:, efforts])
    except RecordingError:
        # An error here is about the time, which is asked about elsewhere.
        return q, []
    joints = fits.robot.joint_names
    names = dict(zip((f"q_{name}" for name in joints), positions, strict=True))
    names |= dict(zip((f"tau_{name}" for name in joints), efforts, strict=True))
    put_right = []
    for check in checks:
        if check.status != "ok":
            detail = check.detail
            for ours, column in names.items():
                # The checks use the names of a stored recording; the user knows only the file's.
                detail = re.sub(rf"(?<!\w){re.escape(ours)}(?!\w)", rows.names[column], detail)
            put_right.append(Guess(f"rows/{check.name}", "put right", 0.95, detail))
    return fill_gaps(right), put_right
