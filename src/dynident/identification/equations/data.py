"""What an identification is solved from: recordings, reduced to the columns of one model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import Reduction
from dynident.identification.asked import RowsAsked
from dynident.identification.equations.checks import check_equations
from dynident.identification.equations.model_equations import equations_of
from dynident.progress import Progress, part, silent
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model
from dynident.regressors.rows import KeptRows, reduce_and_keep


@dataclass(frozen=True, eq=False)
class Data:
    """Recordings reduced to one model's columns, and where they come from.

    `equations` are the rows that the chosen model makes of them; `torque` those of the joints' torques, one equation a
    joint, which errors are reported in whatever the model (for the dynamic model the same object). `recordings` are
    there for estimators that go through the samples again; `rows` the filtered rows of `torque` where they are few.
    `friction` are tests of single joints' friction: the strategy separate_friction alone uses them.
    """

    equations: Reduction
    torque: Reduction
    recordings: tuple[Recording, ...]
    preprocessing: Preprocessing
    reference: ReferenceParameters
    rows: KeptRows | None = None
    friction: tuple[Recording, ...] = ()

    @property
    def weights(self) -> FloatArray:
        """(n,): what rows of the joints' torques count for where a joint turns round; 1 where it is not told apart."""
        return np.array([1.0 if e.turned is None else e.turned.weight for e in self.torque.equations])

    def weighing_turns(self, weights: FloatArray) -> Data:
        """The same where these rows count for weights (n,)."""
        torque = self.torque.weighing_turns(weights)
        return replace(self, torque=torque, equations=torque if self.equations is self.torque else self.equations)


def motions_and_friction(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Recordings of motions to identify from, and those that are tests of single joints' friction.

    Raises
    ------
    DynidentError
        Where there are tests of friction alone.
    """
    friction = tuple(recording for recording in recordings if recording.role == "friction")
    ordinary = tuple(recording for recording in recordings if recording.role != "friction")
    if friction and not ordinary:
        raise DynidentError(
            "all measurements have the role friction; add at least one motion of the whole robot, or give them another "
            "role",
            pointer="/measurement_ids",
            title="Nothing to identify from",
        )
    return ordinary, friction


def reduced(
    model: Model,
    rows: RowsAsked,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    progress: Progress = silent,
    known: KeptRows | None = None,
) -> Data:
    """Reduce recordings to the rows that are asked for, and of the joints' torques.

    Raises
    ------
    DynidentError
        Where the model cannot make equations of these columns or recordings.
    """
    ordinary, friction = motions_and_friction(recordings)
    share = 1.0 if rows.model == "dynamic" else 0.5
    found = torque_of(model, ordinary, preprocessing, reference, part(progress, 0.0, share), known)
    found = replace(found, friction=friction)
    if rows.model == "dynamic":
        return found
    equations = equations_of(model, rows, ordinary, preprocessing, reference, part(progress, share, 1.0))
    check_equations(model, rows.model, equations, found.torque)
    return replace(found, equations=equations)


def torque_of(
    model: Model,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    progress: Progress = silent,
    known: KeptRows | None = None,
) -> Data:
    """Reduce recordings to the rows of the dynamic model [12.18]."""
    reduction, rows = reduce_and_keep(model, recordings, preprocessing, reference, progress, known)
    return Data(reduction, reduction, tuple(recordings), preprocessing, reference, rows)
