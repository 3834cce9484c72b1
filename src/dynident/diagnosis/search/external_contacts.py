"""Find contacts: intervals far above the rest whose residual a force on one link explains.

Holds how long a contact has to last, and how much of the residual the force must explain (70 %).

It cannot be held out, since it happens once. What speaks for it instead is that the few numbers of one wrench explain
the residual of all joints at all times of the interval, as noise or a missing function of the motion would not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import special

from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.held_out_scores import compute_fitted_errors
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.candidates.time_blocks_and_folds import Products
from dynident.diagnosis.residuals.failure_map_and_unknown_patterns import compute_median_error
from dynident.diagnosis.search.search_state import Finding, State
from dynident.effects import get_effect
from dynident.recordings import Preprocessing

# Share of a burst that a contact has to explain, and largest p-value with all bursts and links counted.
_EXPLAINED, _LARGEST_P = 0.7, 1e-6
_LASTING = 3.0
"""Widths of the filter (1 / cut-off) that a contact has to last. A shorter burst has one shape that all joints share,
and a wrench has a number for each of six joints, so that it explains whatever they say; a drive's delay at a step of
acceleration lasts one to two."""

_BAND = 20.0
"""Hz, where the torque is not filtered: an arm's motion and what answers to it."""


def find_contacts(state: State, preprocessing: Preprocessing) -> tuple[Finding, ...]:
    """Try every burst as a contact.

    Parameters
    ----------
    state : State
        The model, and its pool with bursts among the candidates.
    preprocessing : Preprocessing
        Filters of the torque: twice the cut-off independent samples a second come out of them.

    Returns
    -------
    tuple of Finding
        Contacts that explain their burst.
    """
    band = preprocessing.torque_cutoff or _BAND
    bursting = [
        candidate
        for candidate in state.pool.candidates
        if get_effect(candidate.effect).is_transient and _get_duration(candidate) >= _LASTING / band
    ]
    bursts: dict[tuple[tuple[str, ...], float, float], list[Candidate]] = {}
    for candidate in bursting:
        window = dict(candidate.shape)
        bursts.setdefault((candidate.runs, window["t0"], window["t1"]), []).append(candidate)
    contacts: list[Finding] = []
    for links in bursts.values():
        rows = state.data.select_for_candidates(state.base, np.zeros(2, dtype=bool))
        # Of the links that may be pushed, the one that leaves least.
        trials = (_test_contact(rows, state, link, 2 * band * _get_duration(link)) for link in links)
        judged, p = max(trials, key=lambda trial: trial[0].t)
        # Bonferroni: each burst is tried on every link.
        if judged.drop >= _EXPLAINED and p * len(bursting) <= _LARGEST_P:
            contacts.append(Finding(judged, (), p * len(bursting)))
            state = replace(state, base=state.base + judged.candidate.columns)
    return tuple(contacts)


def _get_duration(candidate: Candidate) -> float:
    window = dict(candidate.shape)
    return float(window["t1"] - window["t0"])


def drop_faded_contacts(state: State, preprocessing: Preprocessing) -> State:
    """Drop the contacts of which little is left beside what was found after them.

    They are looked for first, in what the plain model leaves: where friction is missing, an interval in which it is
    unusually large may look like one.
    """
    contacts = [finding for finding in state.findings if finding.is_transient]
    if len(contacts) in (0, len(state.findings)):
        return state
    # The contacts are taken out and looked for again, beside all that was found since.
    rest = state.drop_columns({k for finding in contacts for k in finding.columns})
    still_contacts = {contact.judged.candidate for contact in find_contacts(rest, preprocessing)}
    return state.drop_findings([finding for finding in contacts if finding.judged.candidate not in still_contacts])


def _test_contact(
    data: Products, state: State, candidate: Candidate, independent: float
) -> tuple[ScoredCandidate, float]:
    noise = state.noise
    before, after, separability, amplitudes = compute_fitted_errors(data, state.columns, candidate, noise)
    gains = ((before - after) / noise**2).sum(axis=1)
    whole = (before / noise**2).sum(axis=1)
    # Only the intervals that the contact is in gain; the others would dilute what it explains.
    strong = np.flatnonzero(gains > max(0.1 * float(gains.max(initial=0.0)), 0.0))
    usual = compute_median_error(whole)
    excess = float((whole[strong] - usual).sum())
    drop = float(gains[strong].sum()) / excess if excess > 0 else 0.0
    k = len(candidate.columns)
    freedom = max(independent * data.n_joints - k, 1.0)
    # A floor under what is left: with a residual of zero F would be infinite.
    remaining = max(excess - float(gains[strong].sum()), usual * 0.1, 1e-12)
    # An F test on the few blocks of the contact, with as many samples as the filter lets through.
    f = float(gains[strong].sum()) / k / (remaining / freedom)
    judged = ScoredCandidate(
        candidate=candidate,
        joints=tuple(range(data.n_joints)),
        before=before,
        after=after,
        drop=drop,
        t=float(np.sqrt(max(f, 0.0))),
        gains=gains,
        separability=separability,
        amplitudes=amplitudes,
        share_improved=float(np.mean(gains > 0)),
        measured=data.torque_squared(),
        after_weighted=(after / noise**2).sum(axis=1),
    )
    return judged, float(special.fdtrc(k, freedom, max(f, 0.0)))
