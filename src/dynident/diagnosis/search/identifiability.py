"""Check whether the motion determines the model, and what may be named where it does not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import BoolArray
from dynident.diagnosis.candidates.accumulate import PhasedProducts
from dynident.diagnosis.candidates.products import Products, find_present
from dynident.diagnosis.candidates.scoring import compute_fitted_errors, compute_held_out_errors
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.search.state import State

MOST_FROM_PART_TO_PART = 1.6
"""Error on a fifth of the motion in a row that was left out over that on every fifth stretch: 1.0-1.25 on sound data,
1.6-3 where the motion is too poor to determine the model."""

MOST_OF_FIT = 0.5
"""Share of the squared error, fitted and held out, that something has to explain to be named where that is so.

On a clean delta robot, what passed the gate explained 0.03 of it; friction hidden on a passive joint, 0.91-0.95."""


def is_determined(rows: Products, state: State) -> bool:
    """Return whether the model that the search starts from predicts parts of the motion from the others.

    Where the motion does not determine it, what a candidate gains is what it happens to hold the model by. Stretches
    with what was found already, a contact, do not count: it happened once, no other part of the motion tells of it.

    Parameters
    ----------
    rows : Products
        Rows that are equations for the model.
    state : State
        The model so far and what was found.
    """
    columns = np.array(state.base, dtype=np.intp)
    usual = np.ones(rows.n_stretches, dtype=bool)
    for finding in state.picks:
        usual &= ~_find_active_blocks(rows, finding.columns)
    # Interleaved folds are surrounded by data of the fit; a contiguous fold is a motion that the fit has not seen.
    inside, ahead = (
        float((compute_held_out_errors(rows, columns, state.noise, kind)[usual] / state.noise**2).sum())
        for kind in ("interleaved", "contiguous")
    )
    return ahead <= MOST_FROM_PART_TO_PART**2 * inside


def is_main_explanation(data: PhasedProducts, state: State, scored: ScoredCandidate) -> bool:
    """Return whether a candidate takes away most of what the model leaves where it was fitted.

    There nothing is predicted, so that none of it is for holding a model that the motion does not determine; a column
    or a few that take so much of what all parameters together could not are no chance, either.

    Parameters
    ----------
    data : PhasedProducts
        Products of all columns.
    state : State
        The model so far and what was found.
    scored : ScoredCandidate
        The candidate.
    """
    # Fitted, not held out: what a poor motion leaves undetermined cannot be predicted by any model.
    rows = data.select_for_candidates(state.base, np.array(data.find_row_kinds(scored.candidate.columns)))
    columns = np.array(state.base, dtype=np.intp)
    before, after, _, _ = compute_fitted_errors(rows, columns, scored.candidate, state.noise)
    own = list(scored.joints)
    initial, remaining = before[:, own].sum(axis=0), after[:, own].sum(axis=0)
    # A group is judged by all of its joints together.
    if len(scored.candidate.joints) > 1:
        initial, remaining = initial.sum(keepdims=True), remaining.sum(keepdims=True)
    return bool((remaining <= (1.0 - MOST_OF_FIT) * initial).any() and scored.drop >= MOST_OF_FIT)


def _find_active_blocks(rows: Products, columns: Sequence[int]) -> BoolArray:
    """Return the blocks (s,) in which any of the columns is not zero."""
    is_shown = np.zeros(rows.n_stretches, dtype=bool)
    for joint, where in enumerate(rows.position):
        _, places = find_present(where, np.array(columns, dtype=np.intp))
        is_shown |= (rows.take_products(joint, places, places) > 0).any(axis=1)
    return is_shown
