"""Errors on held-out recordings and outcomes of validations, collected for a verdict; the longest time looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison, compare
from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.recordings import Recording
from dynident.recordings.joint_phases import Phase
from dynident.validation import ValidationOutcome

LONGEST = 600.0
"""Seconds of a recording that are looked at, at most: what is judged does not change with more."""

FEWEST_ROWS = 10
"""Rows of a phase, below which its error is chance."""


@dataclass(frozen=True)
class Outcome:
    """How a validation of the model ended.

    Parameters
    ----------
    kind : str
        Kind of the validation, as `dynident validate` names it.
    judged : ValidationOutcome
        Its verdict and the reason.
    """

    kind: str
    judged: ValidationOutcome


@dataclass(frozen=True, eq=False)
class PhaseErrors:
    """Errors of the joints in one phase of their motion.

    Parameters
    ----------
    name : str
        The phase in words.
    share : (n,)
        Rms of the residual in the phase over that of the joint's torque on all rows; nan where there are few rows.
    """

    name: str
    share: FloatArray


@dataclass(frozen=True, eq=False)
class HeldOutEvidence:
    """A model, the held-out recordings with their residuals, and the outcomes of validations.

    Parameters
    ----------
    identification : Identification
        The identified model.
    held_out : Errors
        Errors on all held-out rows, which a model from a file has without its recordings.
    recordings : tuple of Recording
        Held-out recordings, at most `LONGEST` s of each.
    comparisons : tuple of Comparison
        The model on those of them that are long enough to be compared.
    outcomes : tuple of Outcome
        How validations of the model ended.
    """

    identification: Identification
    held_out: Errors
    recordings: tuple[Recording, ...]
    comparisons: tuple[Comparison, ...]
    outcomes: tuple[Outcome, ...]

    @classmethod
    def from_identification(
        cls,
        identification: Identification,
        held_out: Errors,
        validation: Sequence[Recording],
        outcomes: Sequence[Outcome],
    ) -> HeldOutEvidence:
        """Compare the model with its held-out recordings; those that are too short for that are left out.

        Parameters
        ----------
        identification : Identification
            The identified model.
        held_out : Errors
            Its errors on all held-out rows.
        validation : sequence of Recording
            Held-out recordings; none where the model comes from a file.
        outcomes : sequence of Outcome
            How validations of the model ended.

        Returns
        -------
        HeldOutEvidence
            What the verdicts on all uses rest on.
        """
        shortened = tuple(_shorten_recording(recording) for recording in validation)
        comparisons = []
        for recording in shortened:
            try:
                comparisons.append(compare(identification, recording))
            except DynidentError:
                continue
        return cls(identification, held_out, shortened, tuple(comparisons), tuple(outcomes))

    @property
    def error(self) -> float:
        """Relative held-out error over all joints where they move, by which models are judged."""
        judged = self.identification.held_out_judged
        return (self.held_out if judged is None else judged).relative_total

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.identification.model.robot.joint_names

    @cached_property
    def joint_errors(self) -> FloatArray:
        """Relative error (n,) of each joint where it moves, on all rows where it never does; 0 where it has no rows."""
        return compute_joint_errors(self.held_out, self.identification.held_out_moving)

    @cached_property
    def never_moving(self) -> list[str]:
        """Joints that stand throughout the held-out data."""
        moving = self.identification.held_out_moving
        if moving is None:
            return []
        return [name for j, name in enumerate(self.joints) if self.held_out.counts[j] > 0 and moving.counts[j] == 0]

    @cached_property
    def phases(self) -> tuple[PhaseErrors, ...]:
        """Errors while joints move, reverse, and start or stop: of the torque itself, without a band at rest."""
        if not self.comparisons:
            return ()
        whole = np.sqrt(
            self._compute_mean_square(
                [np.ones_like(comparison.moving) for comparison in self.comparisons], measured=True
            )
        )
        phase_errors = []
        for name, select_rows in _PHASES:
            rows = [select_rows(comparison) for comparison in self.comparisons]
            counts = sum(mask.sum(axis=0) for mask in rows)
            # Every phase is held against the torque on all rows: at a reversal the torque itself may be near zero, and
            # a share of that would say little about what the controller has to add.
            share = np.sqrt(self._compute_mean_square(rows, measured=False)) / np.where(whole > 0, whole, 1.0)
            phase_errors.append(PhaseErrors(name, np.where(counts >= FEWEST_ROWS, share, np.nan)))
        return tuple(phase_errors)

    def list_failed(self, *kinds: str) -> list[Outcome]:
        """List the validations of these kinds that failed."""
        return [outcome for outcome in self.outcomes if outcome.kind in kinds and outcome.judged.verdict == "fail"]

    def list_passed(self, kind: str) -> list[Outcome]:
        """List the validations of a kind that passed."""
        return [outcome for outcome in self.outcomes if outcome.kind == kind and outcome.judged.verdict == "pass"]

    def _compute_mean_square(self, rows: Sequence[BoolArray], *, measured: bool) -> FloatArray:
        """Return (n,): the mean square over rows (m, n) of all recordings."""
        values = [comparison.measured if measured else comparison.raw_residual for comparison in self.comparisons]
        squares = sum((v**2 * r).sum(axis=0) for v, r in zip(values, rows, strict=True))
        return np.asarray(squares / np.maximum(sum(r.sum(axis=0) for r in rows), 1))


def compute_joint_errors(errors: Errors, moving: Errors | None) -> FloatArray:
    """Return the relative error (n,) of each joint where it moves.

    A joint that never moves has its error on all rows, one without rows has 0.

    Parameters
    ----------
    errors : Errors
        Errors on all rows.
    moving : Errors or None
        Errors on the rows where each joint moves.

    Returns
    -------
    array (n,)
        Relative errors (n,), as fractions.
    """
    relative = np.where(errors.counts > 0, errors.relative, 0.0)
    if moving is None:
        return np.asarray(relative)
    return np.asarray(np.where(moving.counts > 0, moving.relative, relative))


def _select_starts(comparison: Comparison) -> BoolArray:
    # The joint moves, but so near to a halt that the filters mix both: it has just started, or is about to stop.
    return np.asarray((comparison.phase == Phase.STANDING) & comparison.off_halts)


_PHASES = (
    ("while they move", lambda comparison: comparison.moving),
    ("at reversals", lambda comparison: comparison.phase == Phase.REVERSING),
    ("at starts and stops", _select_starts),
)


def _shorten_recording(recording: Recording) -> Recording:
    """Return the first ten minutes of a recording, inside its windows."""
    begin = recording.segments[0].start_time
    if recording.segments[-1].start_time + recording.segments[-1].length * recording.period <= begin + LONGEST:
        return recording
    # Without windows all of the recording counts, so its beginning becomes the only window.
    if not recording.windows:
        return recording.with_windows(((begin, begin + LONGEST),))
    begin = min(start for start, _ in recording.windows)
    windows = [(start, min(end, begin + LONGEST)) for start, end in recording.windows if start < begin + LONGEST]
    return replace(recording, windows=tuple(windows))
