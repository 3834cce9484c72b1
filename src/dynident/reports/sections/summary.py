"""First report section: how good the model is, what is doubtful, what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from dynident.diagnosis import Diagnosis
from dynident.identification import Identification
from dynident.number_format import format_count, format_number, format_percent
from dynident.reports.labels import CONDITION_MEANING, format_joints, get_effect_title
from dynident.reports.reported_data import ReportedRecording, ReportedValidation, Section
from dynident.reports.sections.model import (
    LadderFigure,
    build_ladder_figure,
    select_comparable_errors,
)
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
    content = SummaryContent(
        _list_facts(identification, created),
        describe_gain(identification),
        build_ladder_figure(identification, diagnosis),
        _build_figures(identification),
        diagnosis,
        is_recommendation_added(identification, diagnosis),
        identification.warnings,
        _join_data_warnings(runs),
        verdict(
            identification,
            [run.recording for run in runs if not run.held_out],
            [run.recording for run in runs if run.held_out],
            {run.name: run.checks for run in runs},
            [Outcome(validation.kind, validation.judged) for validation in validations],
        ),
    )
    return Section("summary", "Summary", "summary", content)


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


def describe_gain(identification: Identification) -> str:
    """Return the model's error, that of the model that it began from, and what was added and removed.

    Parameters
    ----------
    identification : Identification
        The identified model, with its ladder.

    Returns
    -------
    str
        One sentence for the errors, one for each kind of change.
    """
    models = list(identification.ladder())
    kind, errors = select_comparable_errors(models)
    data = "on held-out data" if kind == "held out" else "in the fit"
    last = f"Where joints move, the relative error of the torque is {format_percent(errors[-1].relative_total)} {data}"
    if len(models) == 1:
        return f"{last}."
    all_joints = identification.model.robot.joint_names
    kinds = {
        "Added": [choice for model in models for choice in model.step.added],
        "Removed": [choice for model in models for choice in model.step.removed],
    }
    changes = "".join(
        f" {kind}: "
        + "; ".join(f"{get_effect_title(each.effect)} on {format_joints(each.joints, all_joints)}" for each in choices)
        + "."
        for kind, choices in kinds.items()
        if choices
    )
    return f"{last}; it was {format_percent(errors[0].relative_total)} before.{changes}"


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
            format_number(identification.equilibrated_condition_number),
            CONDITION_MEANING,
        ),
        Figure(
            "equations",
            str(identification.n_equations),
            f"{format_number(identification.equations_per_parameter)} a parameter",
        ),
        Figure(
            "inertia matrix",
            "positive definite" if identification.inertia_matrix_positive_definite else "not positive definite",
            f"smallest scaled eigenvalue {format_number(identification.worst_inertia_eigenvalue, 2)}",
        ),
    ]
    return tuple(figures)
