"""Find contacts, intervals whose residual a force on one link explains; and the links that loads of some runs are on.

Holds how long a contact has to last, how much of the residual the force must explain (70 %), and what a load explains
by chance.

A contact cannot be held out, since it happens once. What speaks for it instead is that the few numbers of one wrench
explain the residual of all joints at all times of the interval, as noise or a missing function of the motion would not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from scipy import special

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.candidate_pool import Candidate, build_pool_of_choices
from dynident.diagnosis.candidates.fold_fit import ProductSums
from dynident.diagnosis.candidates.held_out_scores import JointBlocks, score_fitted
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.candidates.time_blocks_and_folds import Products
from dynident.diagnosis.residuals.failure_map_and_unknown_patterns import compute_median_error
from dynident.diagnosis.search.search_state import Finding, State, gather_state
from dynident.effects import get_effect, get_role
from dynident.identification import Identification
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import RegressorInputs

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
    score = score_fitted(data, state.columns, candidate, noise)
    before, after = score.before, score.after
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
        separability=score.separability,
        amplitudes=score.amplitudes,
        share_improved=float(np.mean(gains > 0)),
        measured=data.torque_squared(),
        after_weighted=(after / noise**2).sum(axis=1),
    )
    return judged, float(special.fdtrc(k, freedom, max(f, 0.0)))


_CHANCE = 18.3
"""Squared error, in units of white noise, that ten parameters of a load take away by chance in 5 % of cases: χ²."""

_SHOWN = 1e-6
"""Least eigenvalue, of columns of length one, of a combination of a load's parameters that the motion shows."""


@dataclass(frozen=True, eq=False)
class LoadGains:
    """What loads of some runs, on any link, explain beside a model, on the rows that it is fitted to.

    A load moves with its link: its columns are those of the link's own inertia in its runs, which are combinations of
    the model's base columns. So products of the base columns by run tell what every load explains.

    Parameters
    ----------
    model : Model
        The model.
    sums : ProductSums
        Products of the columns of the model, and of findings behind them, over all blocks and over those of each run.
    labels : tuple of str
        Labels of the runs; none where not every run has rows.
    loaded : frozenset of str
        Labels of the runs whose recording states a load.
    chance : float
        Squared error, in units of the noise, that a load takes away by chance.
    """

    model: Model
    sums: ProductSums
    labels: tuple[str, ...]
    loaded: frozenset[str]
    chance: float

    @classmethod
    def from_state(cls, model: Model, state: State, inputs: RegressorInputs) -> LoadGains:
        """Sum products by run beside a state's columns, in units of its noise.

        Parameters
        ----------
        model : Model
            The model, whose base columns stand first in the state.
        state : State
            The model and findings beside which the loads are.
        inputs : RegressorInputs
            Recordings and filters that the products are of.
        """
        blocks, runs = JointBlocks.from_products(state.rows, state.columns, ()), state.rows.number_sets(("runs",))
        sums = blocks.sum_sets(state.noise, runs)
        if blocks.known is not None:
            known = sums.add_known(blocks.known, blocks.base)
            ww, wy = (np.concatenate([new[:1], old[1:]]) for new, old in ((known.ww, sums.ww), (known.wy, sums.wy)))
            sums = replace(sums, ww=ww, wy=wy)
        labels = tuple(dict.fromkeys(label for recording in inputs.recordings for label in recording.segment_names))
        loaded = (recording.segment_names for recording in inputs.recordings if recording.payload is not None)
        plan, period = inputs.preprocessing, max(recording.period for recording in inputs.recordings)
        # Rows that are closer than two to a period of the filter's cut-off tell nothing of their own.
        dependent = 0.5 / (plan.torque_cutoff * plan.decimation * period) if plan.torque_cutoff else 1.0
        has_rows = len(labels) == len(runs.members) - 1
        chance = _CHANCE * max(1.0, dependent)
        return cls(model, sums, labels if has_rows else (), frozenset(chain.from_iterable(loaded)), chance)

    @property
    def carriers(self) -> tuple[str, ...]:
        """Names of the joints whose links may carry something."""
        # The first coordinates of a base that moves carry no link.
        return self.model.robot.joint_names[self.model.robot.n_massless :]

    def list_links(self, runs: Sequence[str]) -> list[str]:
        """List the links on which a load of these runs explains most, the outermost first.

        None where runs have no rows, or no load explains more than chance; more than one where the best of them
        explains no more than chance beyond the others.
        """
        gains = self.compute_gains(runs)
        best = max(gains.values(), default=0.0)
        # Things are usually attached at the outer end of an arm.
        return [name for name in reversed(gains) if gains[name] >= best - self.chance] if best > self.chance else []

    def compute_gains(self, runs: Sequence[str]) -> dict[str, float]:
        """Return the squared error, in units of the noise, that a load of these runs takes away, by link."""
        # What names no runs is in those whose recordings state a load.
        numbers = [1 + k for k, label in enumerate(self.labels) if label in (runs or self.loaded)]
        if not numbers:
            return {}
        right, square = self._project_runs(numbers)
        return {name: self._compute_gain(name, right, square) for name in self.carriers}

    def _project_runs(self, numbers: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the products (p,), (p, p) of the columns in some runs with Y and each other, less what W explains."""
        ww, wy = self.sums.ww, self.sums.wy
        own, torque = ww[numbers].sum(axis=0), wy[numbers].sum(axis=0)
        explained = own @ self._inverse
        return torque - explained @ wy[0], own - explained @ own

    @cached_property
    def _inverse(self) -> FloatArray:
        """Inverse (p, p) of the products of all columns; columns without rows have none."""
        products = self.sums.ww[0]
        size = np.sqrt(np.diag(products))
        size[size == 0] = 1.0
        return np.asarray(np.linalg.pinv(products / np.outer(size, size), hermitian=True) / np.outer(size, size))

    def _compute_gain(self, name: str, right: FloatArray, square: FloatArray) -> float:
        base = self.model.base
        inertia = [
            k for k, column in enumerate(self.model.columns) if column.link == name and get_role(column) == "link"
        ]
        combination, b = base.grouping[:, inertia], base.count
        columns, own = combination.T @ square[:b, :b] @ combination, combination.T @ right[:b]
        length = np.sqrt(np.maximum(np.diag(columns), 0.0))
        has = length > 0
        values, vectors = np.linalg.eigh(columns[np.ix_(has, has)] / np.outer(length[has], length[has]))
        shown = values > _SHOWN
        return float(((vectors[:, shown].T @ (own[has] / length[has])) ** 2 / values[shown]).sum())


def propose_carriers(
    identification: Identification, groups: Sequence[tuple[str, ...]], inputs: RegressorInputs
) -> dict[tuple[str, ...], list[str]]:
    """List the links on which a load of some runs alone would explain most, by the labels of these runs."""
    if not groups:
        return {}
    model = identification.model
    state = gather_state(model, build_pool_of_choices(model, ()), inputs, identification.noise)
    loads = LoadGains.from_state(model, state, inputs)
    return {runs: loads.list_links(runs) for runs in groups}
