"""Decide whether an added effect helps on held-out data, which step of the ladder is best, and the warnings.

Holds by how much a joint may become worse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import get_effect
from dynident.estimation import Reduction
from dynident.estimation.residual_errors import compute_evenness, compute_t
from dynident.identification.identified_models.identification_result import Identification
from dynident.number_format import format_percent
from dynident.regressors.errors_by_phase import (
    FittedPhase,
    compute_errors_by_phase,
    compute_moving_errors,
    compute_phase_squares,
)
from dynident.regressors.row_phases import remembers_path, shows_at_starts

SURE_T, _CHANCE = 2.0, 1.0
"""t of the gain over blocks of time: sure from the first on; below the second it is less than its own spread."""

WORSE_ERROR = 1.02
"""Ratio of held-out errors from which on a joint is said to be worse, where it is no chance either."""

IN_PASSING = 0.1
"""Share of what an addition takes away in all that it may add on one joint: what sits on the wrong link helps most
joints and disturbs another; what is right changes other joints' parameters a little."""

SAME_ERROR = 1.005
"""Ratio of the errors where joints move up to which nobody would notice a difference: then it decides whether held-out
data confirm what was added, and otherwise the model with fewer effects is better."""

# Blocks from which a spread can be told.
_FEWEST = 4

ClaimedRows = FittedPhase
"""Rows that an effect claims to explain: those where joints move; for friction that remembers the path, reversals as
well; for friction at low speed, starts as well."""


@dataclass(frozen=True, eq=False)
class HeldOutGain:
    """What a step of the ladder gains on one kind of held-out rows, the same rows without it and with it.

    Parameters
    ----------
    rows : str
        The kind of rows; reversals and starts are those of the joints on which the effect acts.
    before, after : float
        Relative error of these rows without the step and with it.
    t : float
        t of the gain over blocks of time, all joints in units of their noise (`compute_evenness`).
    """

    rows: ClaimedRows
    before: float
    after: float
    t: float

    @property
    def is_sure(self) -> bool:
        """Whether the error falls, and by more than chance."""
        return self.after < self.before and self.t >= SURE_T


def list_addition_warnings(grown: Identification) -> tuple[str, ...]:
    """Return warnings where an addition does not help on held-out data, or not surely, or where a joint got worse.

    Parameters
    ----------
    grown : Identification
        With the step from the model that was added to.

    Returns
    -------
    tuple of str
        Sentences for the user.
    """
    gains = compute_step_gains(grown)
    if not gains:
        return ()
    titles = " and ".join(dict.fromkeys(get_effect(choice.effect).title for choice in grown.step.added))
    sentences = []
    if not _select_confirming_rows(gains):
        # The kind of rows that speaks most for the addition.
        best = max(gains, key=lambda gain: gain.t if gain.after < gain.before else -np.inf)
        errors = f"on held-out recordings the error changes {_describe_changes(grown, gains)}"
        if best.after >= best.before or best.t < _CHANCE:
            by_chance = ", no more than by chance" if best.t > -_CHANCE else ""
            sentences.append(
                f"Held-out data do not confirm {titles}: {errors} (t = {best.t:.1f}){by_chance}. Remove it unless you "
                "know that it exists."
            )
        else:
            sentences.append(
                f"{titles} helps, but this is not certain: {errors}, unevenly over the motion (t = {best.t:.2f}; "
                f"certain from {SURE_T:g}). Hold out another motion before you rely on it."
            )
    worse = _list_worse_joints(grown)
    if worse:
        sentences.append(f"With {titles} the held-out error is larger on {', '.join(worse)}.")
    return tuple(sentences)


_WORDS: Mapping[ClaimedRows, str] = MappingProxyType(
    {"moving": "where joints move", "reversing": "at reversals", "starting": "at starts"}
)


def _describe_changes(grown: Identification, gains: Sequence[HeldOutGain]) -> str:
    """Describe how the errors change, those where joints move by the figures that the ladder shows."""
    parent = grown.step.parent
    changes = []
    for gain in gains:
        before, after = gain.before, gain.after
        if gain.rows == "moving" and parent is not None and parent.held_out_judged and grown.held_out_judged:
            before, after = parent.held_out_judged.relative_total, grown.held_out_judged.relative_total
        changes.append(f"{_WORDS[gain.rows]} from {format_percent(before)} to {format_percent(after)}")
    return "; ".join(changes)


def compute_step_gains(grown: Identification) -> tuple[HeldOutGain, ...]:
    """Compute what the last step of a ladder gains on the held-out rows that its effects claim to explain.

    Both models are judged on the same rows: those of the larger model, which has the columns of the smaller one. At
    rest static friction holds a joint with any torque, so that these rows judge nothing.

    Parameters
    ----------
    grown : Identification
        With the step from the model that was added to.

    Returns
    -------
    tuple of HeldOutGain
        That of moving rows first; none where nothing was added, or there are no held-out data.
    """
    compared = _StepComparison.from_step(grown)
    if compared is None:
        return ()
    n = len(compared.data.equations)
    claims: list[tuple[ClaimedRows, BoolArray]] = [("moving", np.ones(n, dtype=bool)), *_list_claims(grown)]
    gains = [compared.compute_gain(rows, joints) for rows, joints in claims]
    return tuple(gain for gain in gains if gain is not None)


def list_confirming_rows(grown: Identification) -> tuple[ClaimedRows, ...] | None:
    """List the kinds of held-out rows that confirm what the last step of a ladder added.

    Parameters
    ----------
    grown : Identification
        With the step from the model that was added to.

    Returns
    -------
    tuple of str or None
        Kinds of rows; none of them where nothing confirms it; None where nothing was added, or nothing is held out.
    """
    gains = compute_step_gains(grown)
    return _select_confirming_rows(gains) if gains else None


def _select_confirming_rows(gains: Sequence[HeldOutGain]) -> tuple[ClaimedRows, ...]:
    """Select the kinds of rows that confirm an addition: reversals and starts do where moving rows get no worse."""
    harmless = all(gain.after <= SAME_ERROR * gain.before for gain in gains if gain.rows == "moving")
    return tuple(gain.rows for gain in gains if gain.is_sure and harmless)


def _list_claims(grown: Identification) -> list[tuple[ClaimedRows, BoolArray]]:
    """Return the kinds of rows besides moving ones that the added effects claim, with the joints (n,) of each."""
    parent, observation = grown.step.parent, grown.model.observation
    first = 0 if parent is None else parent.model.n_parameters
    starts = shows_at_starts(observation)[first:].any(axis=0)
    turns = remembers_path(observation, grown.model.signals)[first:].any(axis=0)
    return [("reversing", np.asarray(turns)), ("starting", np.asarray(starts))]


@dataclass(frozen=True, eq=False)
class _StepComparison:
    """Two models of a ladder on the same held-out rows, in blocks of time.

    Parameters
    ----------
    data : Reduction
        The held-out rows in the larger model's columns.
    before, after : (c,)
        Parameters of the smaller model, those of its missing columns zero, and of the larger one.
    noise : (n,)
        The smaller model's noise: in its own, the better model would be judged by the stricter rule.
    """

    data: Reduction
    before: FloatArray
    after: FloatArray
    noise: FloatArray

    @classmethod
    def from_step(cls, grown: Identification) -> _StepComparison | None:
        """Return the comparison with the model below; None where nothing was added, or nothing is held out."""
        parent, data = grown.step.parent, grown.data.held_out
        if parent is None or data is None or not grown.step.added or not parent.model.n_parameters <= data.n_columns:
            return None
        # An extension keeps the base parameters of the model, and puts those of the new columns behind them.
        before = np.pad(parent.values, (0, data.n_columns - parent.model.n_parameters))
        return cls(data, before, grown.values, np.where(parent.noise > 0, parent.noise, 1.0))

    def compute_gain(self, rows: ClaimedRows, joints: BoolArray) -> HeldOutGain | None:
        """Return the gain on one kind of rows of these joints (n,); None where there are no such rows."""
        before, after = (
            getattr(compute_errors_by_phase(self.data, values), rows).select(joints)
            for values in (self.before, self.after)
        )
        if not before.counts.any():
            return None
        drops = self.compute_block_drops(rows)[joints]
        # Without blocks to compare, the total error alone decides.
        t = float(compute_evenness(drops.sum(axis=0)[None])[0]) if drops.shape[1] >= _FEWEST else SURE_T
        return HeldOutGain(rows, before.relative_total, after.relative_total, t)

    def compute_block_drops(self, rows: ClaimedRows) -> FloatArray:
        """Return the drop of the squared error of every joint and block (n, s), in units of the joint's noise."""
        before, after = (compute_phase_squares(self.data, values, rows) for values in (self.before, self.after))
        return np.asarray((before - after) / self.noise[:, None] ** 2)


def _list_worse_joints(grown: Identification) -> list[str]:
    """List the joints on which an addition raises the held-out error where they move, noticeably and beyond chance."""
    compared = _StepComparison.from_step(grown)
    if compared is None:
        return []
    # An addition may help on the whole and hurt a joint, which a total hides.
    old, new = (compute_moving_errors(compared.data, values).relative for values in (compared.before, compared.after))
    drops = compared.compute_block_drops("moving")
    return [
        f"{name} ({format_percent(old[j])} to {format_percent(new[j])})"
        for j, name in enumerate(grown.model.robot.joint_names)
        if new[j] > WORSE_ERROR * old[j]
        and -drops[j].sum() > IN_PASSING * drops.sum()
        and (drops.shape[1] < _FEWEST or compute_t(-drops[j]) >= SURE_T)
    ]


@dataclass(frozen=True)
class BestStep:
    """The step of a ladder that predicts held-out data best, and those after it that raise the error.

    Parameters
    ----------
    best : int
        Number of the best step, from the first model of the ladder on.
    rises : tuple of int
        Steps above the best one whose held-out error is larger, by more than nobody would notice.
    equal : tuple of int
        Other steps whose held-out error nobody would tell from the smallest one, as that of the best step: it is then
        the earliest of them, or one that is preferred.
    """

    best: int
    rises: tuple[int, ...]
    equal: tuple[int, ...] = ()


def find_best_of_errors(totals: Sequence[float], preferred: Sequence[bool]) -> BestStep | None:
    """Return the best step by the held-out errors of a ladder's models, over all joints; None where there are none.

    Parameters
    ----------
    totals : sequence of float
        Held-out errors where joints move, the first model's first.
    preferred : sequence of bool
        Whether each model is better than the one before if their errors are the same: it adds what held-out data
        confirm, or it has fewer effects.

    Returns
    -------
    BestStep or None
        The best step, and those after it that raise the error.
    """
    if not totals:
        return None
    # All are compared with the smallest error: compared with each other, small differences would add up.
    same = [k for k, total in enumerate(totals) if total <= SAME_ERROR * min(totals)]
    best = max((k for k in same if preferred[k]), default=same[0])
    rises = tuple(k for k in range(best + 1, len(totals)) if k not in same)
    return BestStep(best, rises, tuple(k for k in same if k != best))


def compute_block_squares(data: Reduction, values: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the squared error of every block of time (s,) for parameters (b,), each joint in units of its noise (n,).

    Parameters
    ----------
    data : Reduction
        The joints' torques in blocks of time.
    values : (b,)
        Base parameters.
    noise : (n,)
        Standard deviation of each joint's residual; 0 counts as 1.
    """
    parts: Sequence[FloatArray] = [
        equation.sum_squares(values) / sigma**2
        for equation, sigma in zip(data.equations, np.where(noise > 0, noise, 1.0), strict=True)
    ]
    return np.asarray(np.sum(parts, axis=0))
