"""Check that no finding makes the prediction worse, in the order in which they would be added."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.accumulate import PhasedProducts
from dynident.diagnosis.candidates.familywise_test import compute_evenness
from dynident.diagnosis.candidates.products import can_leave_out_runs
from dynident.diagnosis.candidates.scoring import compute_held_out_errors

_CHANCE = 3.5
"""t of a joint's larger error over the stretches of time from which on it is more than chance: of the some forty joints
and findings that are looked at, one in fifty diagnoses would show it."""

_IN_PASSING = 0.1
"""Share of what a finding takes away in all that it may add on one joint: what sits on the wrong link helps most joints
and disturbs another."""

_NOTICED = 1.005
"""Times the error of a joint, or of all together, from which on anybody would notice that it grew."""


def select_harmless(
    data: PhasedProducts,
    base: tuple[int, ...],
    columns: Sequence[tuple[int, ...]],
    noise: FloatArray,
) -> list[int]:
    """Select the findings that make the prediction worse nowhere, in the order in which they are to be added.

    One that hurts waits for the next that does not, and is tried again beside it: friction judged on torque that is
    late is not what it is once the delay is known. Whole runs are left out of the fit where the others determine the
    model without them, else a tenth of one in a row.

    Parameters
    ----------
    base : tuple of int
        Columns of the model.
    columns : sequence of tuple of int
        Columns of each finding, the most important first.
    noise : (n,)
        Standard deviation of the noise of each joint, N m or N.
    data : PhasedProducts
        Products of all columns.

    Returns
    -------
    list of int
        Numbers of the findings.
    """
    accepted: list[int] = []
    waiting = list(range(len(columns)))
    while (number := next((k for k in waiting if _is_harmless(data, base, columns[k], noise)), None)) is not None:
        accepted.append(number)
        waiting.remove(number)
        base += columns[number]
    return accepted


def _is_harmless(data: PhasedProducts, base: tuple[int, ...], own: tuple[int, ...], noise: FloatArray) -> bool:
    # The rows of the larger model for both, so that the errors are of the same samples.
    rows = data.select_for_model(base + own)
    plain, grown = (np.array(model, dtype=np.intp) for model in (base, base + own))
    # Whole runs are the harder test: they are other motions, or other days.
    kind = "runs" if can_leave_out_runs(rows, grown) else "parts"
    before, after = (compute_held_out_errors(rows, model, noise, kind) for model in (plain, grown))
    # As in scoring, no loss counts for more than there was: a part left out may be what decides.
    return not _is_harmful(before / noise**2, np.minimum(after, 2.0 * before) / noise**2)


def _is_harmful(before: FloatArray, after: FloatArray) -> bool:
    """Return whether squared errors (s, n), in units of the noise, grow on any joint beyond chance, or on the whole."""
    removed = float(before.sum() - after.sum())
    if after.sum() > _NOTICED**2 * before.sum():
        return True
    # A joint is harmed where its error grows noticeably, by much of what the finding removes in all, and beyond chance.
    added = (after - before).sum(axis=0)
    grown = (after.sum(axis=0) > _NOTICED**2 * before.sum(axis=0)) & (added > _IN_PASSING * removed)
    return bool((grown & (compute_evenness((after - before).T) >= _CHANCE)).any())
