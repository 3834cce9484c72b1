"""First report section: how good the model is, what is doubtful, what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from markupsafe import Markup

from dynident.diagnosis import Diagnosis
from dynident.identification import Identification
from dynident.number_format import format_count, format_number
from dynident.presentation.labels import get_effect_title
from dynident.presentation.ladder_tables import describe_gain
from dynident.presentation.model_tables import build_quality_table
from dynident.presentation.tables import ReportedTable
from dynident.presentation.validation_and_verdict_tables import build_verdict_tables
from dynident.reports.figures.ladder import draw_drift
from dynident.reports.reported_data import ReportedRecording, ReportedValidation, Section
from dynident.reports.sections.model import LadderFigure, build_ladder_figure
from dynident.verdict import ModelVerdict, Outcome, verdict


@dataclass(frozen=True)
class Figure:
    """One number with its name and its meaning."""

    name: str
    value: str
    note: str


@dataclass(frozen=True)
class SummaryContent:
    """The content of the section: what, when, from which recordings, how good, and what is doubtful."""

    facts: tuple[tuple[str, str], ...]
    sentence: str
    ladder: LadderFigure
    figures: tuple[Figure, ...]
    diagnosis: Diagnosis | None
    recommended_added: bool
    warnings: tuple[str, ...]
    data_warnings: tuple[str, ...]
    verdict: ModelVerdict
    verdict_tables: tuple[ReportedTable, ...]
    drift: Markup | None


def build_summary_section(
    identification: Identification,
    runs: Sequence[ReportedRecording],
    diagnosis: Diagnosis | None,
    created: datetime,
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
    created : datetime
        When the report was made, with its time zone.
    validations : sequence of ReportedValidation
        The results of the model's validations.

    Returns
    -------
    Section
        Numbers, fitness for use, diagnosis and warnings.
    """
    model_verdict = verdict(
        identification,
        [run.recording for run in runs if not run.held_out],
        [run.recording for run in runs if run.held_out],
        {run.name: run.checks for run in runs},
        [Outcome(validation.kind, validation.judged) for validation in validations],
    )
    content = SummaryContent(
        _list_facts(identification, created),
        describe_gain(identification),
        build_ladder_figure(identification, diagnosis),
        _build_figures(identification),
        diagnosis,
        is_recommendation_added(identification, diagnosis),
        identification.warnings,
        _join_data_warnings(runs),
        model_verdict,
        tuple(build_verdict_tables(model_verdict)),
        _draw_drift(model_verdict, identification),
    )
    return Section("summary", "Summary", "summary", content)


def _draw_drift(model_verdict: ModelVerdict, identification: Identification) -> Markup | None:
    if model_verdict.drift is None or model_verdict.stop is not None:
        return None
    return draw_drift(model_verdict.drift, [joint.kind == "prismatic" for joint in identification.model.robot.joints])


def _list_facts(identification: Identification, created: datetime) -> tuple[tuple[str, str], ...]:
    robot, data = identification.model.robot, identification.data
    effects = dict.fromkeys(get_effect_title(choice.effect) for choice in identification.choices.effects)
    return (
        ("robot", f"{robot.name}, {format_count(robot.n, 'joint')}"),
        ("report made", created.astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC")),
        ("identified from", ", ".join(data.measurement_names)),
        ("held-out recordings", ", ".join(data.validation_names) or "none"),
        ("in the model", ", ".join(effects)),
    )


def _join_data_warnings(runs: Sequence[ReportedRecording]) -> tuple[str, ...]:
    """Return a sentence for each check that found something; recordings with the same finding share it."""
    places_by_check: dict[str, list[tuple[str, str]]] = {}
    for run in runs:
        for check in run.checks:
            if check.status != "ok":
                places_by_check.setdefault(check.name, []).append((run.name, check.detail))
    sentences = []
    for name, places in places_by_check.items():
        names = ", ".join(dict.fromkeys(recording for recording, _ in places))
        more = f" (And {len(places) - 1} more, with the recordings below.)" if len(places) > 1 else ""
        sentences.append(f"{names}: {name.replace('_', ' ')}. {places[0][1]}{more}")
    return tuple(sentences)


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
    table = build_quality_table(
        identification.fit_judged.relative_total,
        None if held_out is None else held_out.relative_total,
        [parameter.well_identified for parameter in identification.parameters],
        identification.equilibrated_condition_number,
        identification.n_equations,
        identification.equations_per_parameter,
    )
    inertia = Figure(
        "inertia matrix",
        "positive definite" if identification.inertia_matrix_positive_definite else "not positive definite",
        f"smallest scaled eigenvalue {format_number(identification.worst_inertia_eigenvalue, 2)}",
    )
    return (*(Figure(*texts) for texts in table.texts), inertia)
