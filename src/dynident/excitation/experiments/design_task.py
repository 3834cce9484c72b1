"""What all kinds of experiments share: model, limits, rows of earlier runs, and verification on a fine grid.

Holds how many points are verified for each sample, and the speed that counts as standstill.

The next experiment complements the information of earlier runs about the parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.excitation.criteria.design_criterion import DesignCriterion, compute_row_weights
from dynident.excitation.criteria.optimality_criteria import Baseline, CriterionValues
from dynident.excitation.criteria.parameter_variances import ExpectedParameter, predict_uncertainties
from dynident.excitation.design_observation_matrix import DesignModel
from dynident.excitation.design_request import DesignRequest, compute_planned_seconds
from dynident.excitation.design_result import Run
from dynident.excitation.equation_type_rows import DYNAMIC_ROWS, RowModel
from dynident.motion.collision_free_paths import PieceChain
from dynident.motion.joint_trajectories import Motion, Piece, check_length, sample_pieces
from dynident.motion.limits.bounds import Bounds
from dynident.motion.limits.limit_margins import Margin, compute_margins
from dynident.progress import Checkpoints, NoCheckpoints, Progress, scale_progress
from dynident.recordings import Recording, choose_preprocessing
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.qr_accumulation import compute_used_duration


def build_earlier_rows(model: DesignModel, recordings: Sequence[Recording], request: DesignRequest) -> FloatArray:
    """Return rows that stand for earlier recordings besides the rows W / √N of one period of a design.

    They have the same WᵀW as all rows of the recordings, in proportion to the length of the new experiment: a minute
    recorded counts as much as a minute designed. Row j of every sample is joint j's.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    recordings : sequence of Recording
        The earlier runs.
    request : DesignRequest
        The design request, which gives the length of the new experiment.

    Returns
    -------
    (m n, b)
        Rows in the units of W / √N.

    Raises
    ------
    DynidentError
        A recording is another robot's, or the experiment is of a kind that earlier runs cannot be added to.
    """
    _check_addable(model, request)
    for recording in recordings:
        if recording.joint_names != model.robot.joint_names:
            raise DynidentError(
                f"{recording.name} has the joints {', '.join(recording.joint_names)}; the robot has "
                f"{', '.join(model.robot.joint_names)}",
                pointer="/earlier_ids",
                title="Another robot's measurement",
            )
    # Filtered as an identification would filter them, so that their rows are worth as much as it will make of them.
    preprocessing = choose_preprocessing(recordings)
    reduction = reduce_recordings(model.observation, RegressorInputs(recordings, preprocessing, model.reference))
    n, b = model.robot.n, model.n_parameters
    # The triangular factors have the inner products of all rows: a few rows stand for whole recordings.
    rows = np.zeros((max(equation.factors.shape[-1] for equation in reduction.equations), n, b))
    for joint, equation in enumerate(reduction.equations):
        k = len(equation.columns)
        # A joint's equation has some of the columns only. The last column of its factor is the torque, which a design
        # does not use.
        rows[: k + 1, joint, equation.columns] = equation.whole_factor[:, :k]
    seconds = sum(compute_used_duration(recording) for recording in recordings)
    per_second = reduction.n_rows / n / seconds
    equivalent_rows: FloatArray = rows.reshape(-1, b) / np.sqrt(compute_planned_seconds(request) * per_second)
    return equivalent_rows


def _check_addable(model: DesignModel, request: DesignRequest) -> None:
    """Raise `DynidentError` where the rows of earlier runs cannot be added to those of the design."""
    if request.kind == "sequential":
        raise DynidentError(
            "a set of test motions does not take earlier runs into account; leave the earlier runs out, or choose the "
            'kind "optimized"',
            pointer="/earlier_ids",
        )
    if not model.counted.all():
        raise DynidentError(
            "with locked joints, the parameters are grouped differently than in earlier runs of all joints; leave "
            "the earlier runs out, or let all joints move",
            pointer="/earlier_ids",
        )
    if request.model != "dynamic":
        raise DynidentError(
            f"earlier runs count only for the dynamic model; a design for the {request.model} model cannot take them "
            "into account",
            pointer="/earlier_ids",
        )


# Points of the fine grid per sample, on which limits are verified.
_CHECKS_PER_SAMPLE = 10
# Points that are evaluated at a time, and samples that the values are computed from.
_CHUNK = 50_000
_VALUED_SAMPLES = 10_000

STANDSTILL_VELOCITY = 1e-4
"""Velocity, rad/s or m/s, below which a joint of a planned motion, which has no noise, stands still."""


@dataclass(frozen=True, eq=False)
class DesignTask:
    """A design to be made.

    Parameters
    ----------
    request : DesignRequest
        The design request.
    model : DesignModel
        Model of the design.
    design_criterion : DesignCriterion
        Measure of a motion.
    limits : Bounds
        Limits that must hold.
    bounds : Bounds
        Limits that are designed for, slightly tighter.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.
    checkpoints : Checkpoints
        Storage for the state of the search.
    counts_moves : bool
        Whether the search weighs what a motion shows against the time of the moves from and to home.
    """

    request: DesignRequest
    model: DesignModel
    design_criterion: DesignCriterion
    limits: Bounds
    bounds: Bounds
    progress: Progress
    checkpoints: Checkpoints = field(default_factory=NoCheckpoints)
    counts_moves: bool = False

    @property
    def rate(self) -> float:
        """Sampling rate, Hz."""
        return self.request.trajectory.sampling_rate

    def verify_pieces(self, pieces: Sequence[Piece]) -> tuple[Margin, ...]:
        """Return the margins against the true limits, on a grid finer than the sampling.

        Parameters
        ----------
        pieces : sequence of Piece
            Pieces of the motion, one after the other.

        Returns
        -------
        tuple of Margin
            One for each limit.
        """
        check_length(pieces, self.rate)
        torque = self.model.torque if self.limits.has_torque_limits else None
        finely = _sample_finely(pieces, self.rate * _CHECKS_PER_SAMPLE, scale_progress(self.progress, 0.95, 1.0))
        return compute_margins(self.limits, finely, torque)

    def evaluate_pieces(self, pieces: Sequence[Piece], exciting: tuple[float, float]) -> MotionValues:
        """Return the values of the exciting part of a sequence of pieces.

        Parameters
        ----------
        pieces : sequence of Piece
            Pieces of the motion, one after the other.
        exciting : tuple of (float, float)
            Times between which the exciting part lies, s.
        """
        motion = sample_pieces(pieces, self.rate)
        inside = np.flatnonzero((motion.t >= exciting[0]) & (motion.t <= exciting[1]))
        # Some ten thousand samples give the values as well as all of them.
        samples = inside[:: max(1, len(inside) // _VALUED_SAMPLES)]
        dq = motion.dq[samples]
        # The equation of a joint that stands holds for any torque below its static friction: it tells nothing.
        w = self.model.observe_along(motion, samples) * (np.abs(dq) > STANDSTILL_VELOCITY).reshape(-1, 1)
        earlier = self.design_criterion.earlier
        if earlier is not None:
            # They count in proportion to how long the experiment is, not to how long it was asked for.
            earlier = earlier * np.sqrt(compute_planned_seconds(self.request) / (exciting[1] - exciting[0]))
        expected = self.predict_uncertainties(w.reshape(*dq.shape, -1), dq, DYNAMIC_ROWS, len(inside), earlier)
        return MotionValues(replace(self.design_criterion, earlier=earlier).evaluate(w, len(samples)), expected)

    def predict_uncertainties(
        self, w: FloatArray, dq: FloatArray, rows: RowModel, n_samples: float, earlier: FloatArray | None
    ) -> tuple[ExpectedParameter, ...]:
        """Return the expected uncertainty of the parameters.

        Parameters
        ----------
        w, dq : (m, n, b), (m, n)
            W and q̇ at representative samples.
        rows : RowModel
            Rows that the identification makes of them.
        n_samples : float
            Number of samples of the experiment.
        earlier : (r, b) or None
            Rows besides W / √m that stand for the information of earlier runs.

        Returns
        -------
        tuple of ExpectedParameter
            One for each base parameter.
        """
        noise = 1.0 / compute_row_weights(self.model, self.request.noise) if self.request.noise else None
        return predict_uncertainties(self.model, w, dq, rows, n_samples, noise=noise, earlier=earlier)


@dataclass(frozen=True, eq=False)
class MotionValues:
    """Values of a motion by the criteria, and parameter by parameter.

    Parameters
    ----------
    values : CriterionValues
        Values by all criteria.
    expected : tuple of ExpectedParameter
        Expected uncertainty of each parameter.
    """

    values: CriterionValues
    expected: tuple[ExpectedParameter, ...]


@dataclass(frozen=True, eq=False)
class DesignedExperiment:
    """A designed motion with all that a `Design` needs.

    Parameters
    ----------
    pieces : tuple of Piece
        Pieces of the motion from home to home.
    exciting : tuple of (float, float)
        Times between which the exciting part lies, s.
    period : float or None
        Period of the exciting part, s; None where it has none.
    valued : MotionValues
        Values of the exciting part.
    baseline : Baseline or None
        Values of random motions; None where there is nothing to compare.
    margins : tuple of Margin
        How near the motion comes to every limit.
    notes : tuple of str
        Notes for the user.
    runs : tuple of Run
        Test motions of a set.
    """

    pieces: tuple[Piece, ...]
    exciting: tuple[float, float]
    period: float | None
    valued: MotionValues
    baseline: Baseline | None
    margins: tuple[Margin, ...]
    notes: tuple[str, ...]
    runs: tuple[Run, ...] = ()


def _sample_finely(pieces: Sequence[Piece], rate: float, progress: Progress) -> Iterator[Motion]:
    """Yield pieces on grids of at least `rate`, ends included, in chunks."""
    # The moves of a chain one by one: at the times at which each was planned.
    single = [part for piece in pieces for part in (piece.pieces if isinstance(piece, PieceChain) else (piece,))]
    for number, piece in enumerate(single):
        t = np.linspace(0.0, piece.duration, int(np.ceil(piece.duration * rate)) + 1)
        # Chunks bound the memory: a long experiment on the fine grid has millions of samples.
        for first in range(0, len(t), _CHUNK):
            progress(number / len(single), "verifying")
            yield piece.evaluate(t[first : first + _CHUNK])
