"""Find equations of closed loops that depend on others, in closed postures, and leave them out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.robot.loop_errors import LOOP_TITLE
from dynident.robot.loops import CLOSED, Closure
from dynident.robot.pointers import join_names

_POSTURES, _NEAR, _ROUNDS = 20, 0.1, 30
_DEPENDENT = 1e-9
"""Share of the largest singular value below which a direction counts as zero: the rank of the equations."""
_OPEN_WHEN_DROPPED = 1e-7
"""Gap (m, rad) that an equation left out may have: descriptions are written with a limited number of digits."""


def drop_dependent_equations(closure: Closure) -> Closure:
    """Return the closure without the equations that follow from its others.

    A `connect` of MJCF has three equations although two hold a loop in a plane, and a hinge may be written as two
    points. Closed postures near the start tell which equations are independent.

    Raises
    ------
    DynidentError
        Loops do not close at the start, or all of their equations together hold the driven joints as well.
    """
    start = closure.close_start()
    postures = _sample_closed_postures(closure, start)
    _, slopes = closure.evaluate(postures[:, : closure.n], postures[:, closure.n :])
    left_out: set[int] = set()
    for rows, unknowns, driven in closure.groups:
        if len(rows) <= len(unknowns):
            continue
        if not unknowns and not driven:
            left_out |= set(rows)
            continue
        if driven and len(postures) < 2:
            names = join_names(closure.names[k] for k in driven)
            held = join_names(dict.fromkeys(closure.get_loop(row).name for row in rows))
            raise DynidentError(
                f"The {len(rows)} equations of {held} hold the driven joints {names} where they start: no motion "
                "keeps the loops closed. Let less of the frames coincide, or drive fewer joints.",
                pointer=closure.loops[0].where,
                title=LOOP_TITLE,
            )
        if not unknowns:
            continue
        # Take the posture in which the passive joints are determined best, and pivoted QR of the transposed slopes:
        # the rows that it chooses last are those that depend on the others.
        part = slopes[:, rows][:, :, unknowns]
        singular = np.linalg.svd(part, compute_uv=False)
        best = int(np.argmax(singular[:, -1] / singular[:, 0]))
        rank = int(np.sum(singular[best] > _DEPENDENT * singular[best, 0]))
        order = scipy.linalg.qr(part[best].T, mode="r", pivoting=True)[1]
        left_out |= {rows[k] for k in order[rank:]}
    if not left_out:
        return closure
    loops = []
    for loop in closure.loops:
        loop_rows = closure.get_rows(loop)
        loops.append(replace(loop, equations=tuple(k for k, row in enumerate(loop_rows) if row not in left_out)))
    return replace(closure, loops=tuple(loops))


def _sample_closed_postures(closure: Closure, start: FloatArray) -> FloatArray:
    """Return closed postures (m, n + p) around the start, the start first."""
    rng = np.random.default_rng(0)
    reach = np.minimum(_NEAR, 0.25 * (closure.high - closure.low))
    postures = [start]
    for step in rng.uniform(-1, 1, (_POSTURES, closure.n)):
        posture = start.copy()
        posture[: closure.n] += reach * step
        for _ in range(_ROUNDS):
            gap, slopes = closure.evaluate(posture[None, : closure.n], posture[None, closure.n :])
            if np.abs(gap).max() < CLOSED:
                break
            # Newton's step by least squares: there are more equations than unknowns here, some of them dependent.
            posture[closure.n :] -= np.linalg.lstsq(slopes[0], gap[0], rcond=1e-10)[0]
        if np.abs(gap).max() < _OPEN_WHEN_DROPPED:
            postures.append(posture)
    return np.array(postures)
