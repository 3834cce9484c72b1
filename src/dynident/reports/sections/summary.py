"""The section that a reader needs first: how good the model is, and what is doubtful about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dynident.diagnosis import Diagnosis
from dynident.identification import Identification
from dynident.reports.number_format import format_count, format_number, format_percent
from dynident.reports.report_data import ReportedRecording, ReportedValidation, Section
from dynident.verdict import ModelVerdict, Outcome, State, verdict


@dataclass(frozen=True)
class Figure:
    """One number with its name and its meaning."""

    name: str
    value: str
    note: str


@dataclass(frozen=True)
class DriftRow:
    """How far a simulation drifts on one joint, as shares of its way, as text."""

    joint: str
    shares: tuple[str, ...]


_FIT: Mapping[State, str] = {"yes": "yes", "limited": "within limits", "no": "no", "not_judged": "not judged"}
_COLOURS: Mapping[State, str] = {"yes": "ok", "limited": "warning", "no": "error", "not_judged": "warning"}


@dataclass(frozen=True)
class SummaryContent:
    """The content of the section: numbers, fitness for use, diagnosis and warnings."""

    figures: tuple[Figure, ...]
    diagnosis: Diagnosis | None
    recommended_added: bool
    warnings: tuple[str, ...]
    data_warnings: tuple[str, ...]
    verdict: ModelVerdict

    @property
    def states(self) -> Mapping[State, str]:
        """What the state of each use is called."""
        return _FIT

    @property
    def colours(self) -> Mapping[State, str]:
        """The CSS class of each state."""
        return _COLOURS

    @property
    def drift(self) -> tuple[DriftRow, ...]:
        """The drift of a simulation, joint by joint; empty where none was made."""
        drift = self.verdict.drift
        if drift is None:
            return ()
        shares = drift.share.T.tolist()
        return tuple(
            DriftRow(joint, tuple(format_percent(fraction, 2) for fraction in joint_shares))
            for joint, joint_shares in zip(drift.joint_names, shares, strict=True)
        )


def build_summary_section(
    identification: Identification,
    runs: Sequence[ReportedRecording],
    diagnosis: Diagnosis | None,
    validations: Sequence[ReportedValidation] = (),
) -> Section:
    """Return the first section of a report.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    runs : sequence of ReportedRecording
        Recordings to show, each with the model's prediction.
    diagnosis : Diagnosis or None
        The diagnosis, if there is one.
    validations : sequence of ReportedValidation
        The results of the model's validations.

    Returns
    -------
    Section
        Numbers, fitness for use, diagnosis and warnings.
    """
    content = SummaryContent(
        _build_figures(identification),
        diagnosis,
        is_recommendation_added(identification, diagnosis),
        identification.warnings,
        tuple(
            f"{run.name}: {check.name.replace('_', ' ')}. {check.detail}"
            for run in runs
            for check in run.checks
            if check.status != "ok"
        ),
        verdict(
            identification,
            [run.recording for run in runs if not run.held_out],
            [run.recording for run in runs if run.held_out],
            {run.name: run.checks for run in runs},
            [Outcome(validation.kind, validation.judged) for validation in validations],
        ),
    )
    return Section("summary", "Summary", "summary", content)


def is_recommendation_added(identification: Identification, diagnosis: Diagnosis | None) -> bool:
    """Return whether the model already has every effect that the diagnosis recommends.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    diagnosis : Diagnosis or None
        The diagnosis, if there is one.

    Returns
    -------
    bool
        False where there is no recommendation.
    """
    if diagnosis is None or not diagnosis.recommended:
        return False
    # Each with its joints and shape constants: an effect on other joints is another one.
    return all(choice in identification.choices.effects for choice in diagnosis.recommended)


def _build_figures(identification: Identification) -> tuple[Figure, ...]:
    held_out = identification.held_out_judged
    good = sum(parameter.well_identified for parameter in identification.parameters)
    figures = []
    if held_out is not None:
        figures.append(Figure("held-out error", format_percent(held_out.relative_total), "relative, where joints move"))
    figures += [
        Figure(
            "error of the fit", format_percent(identification.fit_judged.relative_total), "relative, where joints move"
        ),
        Figure(
            "base parameters",
            str(identification.model.n_parameters),
            f"{good} of them determined by the data",
        ),
        Figure(
            "condition number",
            format_number(identification.condition_number),
            f"{format_count(identification.n_equations, 'equation')}, "
            f"{format_number(identification.equations_per_parameter)} a parameter",
        ),
        Figure(
            "inertia matrix",
            "positive definite" if identification.inertia_matrix_positive_definite else "not positive definite",
            f"smallest scaled eigenvalue {format_number(identification.worst_inertia_eigenvalue, 2)}",
        ),
    ]
    return tuple(figures)
