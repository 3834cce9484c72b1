"""`dynident.validate`: run validations of a model and show their verdicts as a table."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.api.argument_checks import CheckedResult, check_arguments
from dynident.api.model import Model
from dynident.api.model_identification import as_model
from dynident.api.named_tables import Items
from dynident.api.recording_collection import SomeRecordings, as_recordings
from dynident.identification import Identification
from dynident.presentation.tables import ReportedTable
from dynident.presentation.validation_and_verdict_tables import VALIDATION_WORDS, build_validation_table
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.text_and_html_tables import join_html, render_paragraph
from dynident.validation import (
    LARGEST_ERROR,
    ValidationOutcome,
    Verdict,
    combine_verdicts,
    validate_cross,
    validate_direct,
    validate_inertia_matrix,
)
from dynident.verdict import Outcome


@dataclass(frozen=True)
class Validation(Outcome, CheckedResult):
    """One test of a model.

    Parameters
    ----------
    kind : str
        Its name, as `dynident validate` has it: "direct", "cross", "inertia_matrix".
    judged : ValidationOutcome
        Its result and the reason.
    title : str
        The test in words.
    """

    title: str

    @property
    def verdict(self) -> Verdict:
        """The result: pass, fail or not_evaluated."""
        return self.judged.verdict


@dataclass(frozen=True, eq=False)
class Validations(Items[Validation], CheckedResult):
    """Several tests of one model.

    Parameters
    ----------
    items : tuple of Validation
        The tests, in the order in which they were made.
    """

    items: tuple[Validation, ...]

    @property
    def verdict(self) -> Verdict:
        """The result of all tests: fail if one of them fails."""
        return combine_verdicts([(validation.title, validation.judged) for validation in self.items]).verdict

    def __repr__(self) -> str:
        return self._table().to_text(f"Validations({self.verdict})")

    def _repr_html_(self) -> str:
        title = f"Validations: {VALIDATION_WORDS[self.verdict].words}"
        return join_html(render_paragraph(title, strong=True), self._table().to_html())

    def _table(self) -> ReportedTable:
        return build_validation_table((validation.title, validation.judged) for validation in self.items)


@check_arguments
def validate(
    model: Model | Identification,
    validation: SomeRecordings | None = None,
    *,
    limit: float = LARGEST_ERROR,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> Validations:
    """Test a model on its own recordings, on others, and its inertia matrix over the whole joint range (§12.7).

    `dynident.validation` has more tests: a known load, a simulator against a recording, its drift, contact detection,
    all methods in one table.

    Parameters
    ----------
    model : Model
        The identified model, with or without its recordings.
    validation : recordings, optional
        Recordings to which no parameter was fitted; by default the model's own validation recordings.
    limit : float
        Largest relative torque error over all joints that passes.
    seed : int
        Of the random postures among which the worst one is searched for.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Validations
        Three tests: direct, cross and inertia matrix. Those without data are not evaluated.

    Raises
    ------
    DynidentError
        For a limit that is not above zero, or another robot's recordings.

    Examples
    --------
    >>> model = dy.identify(robot, runs[:1], validation=runs[1:])
    >>> tests = dy.validate(model)
    >>> tests.verdict
    'pass'
    >>> [test.kind for test in tests]
    ['direct', 'cross', 'inertia_matrix']
    """
    desk_model = as_model(model)
    held_out = desk_model.validation if validation is None else as_recordings(validation)
    identification = desk_model.identification
    # A test without data is no failure, but it must be seen that it was not made.
    no_data = ValidationOutcome("not_evaluated", "There are no such recordings.")
    direct = cross = no_data
    # A model from a file has no recordings, and is still tested by what it holds.
    if desk_model.recordings:
        direct = validate_direct(
            identification, desk_model.recordings.recordings, limit, scale_progress(progress, 0.0, 0.3)
        ).judged
    if held_out:
        cross = validate_cross(identification, held_out.recordings, limit, scale_progress(progress, 0.3, 0.6)).judged
    inertia = validate_inertia_matrix(identification, seed=seed, progress=scale_progress(progress, 0.6, 1.0)).judged
    return Validations(
        (
            Validation("direct", direct, "direct: on the identification's own data"),
            Validation("cross", cross, "cross: on held-out data"),
            Validation("inertia_matrix", inertia, "inertia matrix over the joint range"),
        )
    )
