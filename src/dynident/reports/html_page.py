"""The report as one self-contained HTML file: which sections it has, in which order."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from functools import lru_cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from dynident.diagnosis import Diagnosis
from dynident.errors import DynidentError
from dynident.excitation import Design
from dynident.identification import Identification
from dynident.reports.reported_data import ReportedRecording, ReportedValidation, Section
from dynident.reports.sections.accuracy import build_errors_section, build_residuals_section, build_validation_section
from dynident.reports.sections.diagnosis import build_diagnosis_section
from dynident.reports.sections.model import (
    build_ladder_section,
    build_model_section,
    build_parameters_section,
    build_robot_section,
)
from dynident.reports.sections.provenance import build_provenance_section
from dynident.reports.sections.recordings_and_design import (
    build_data_section,
    build_design_section,
    build_promises_section,
)
from dynident.reports.sections.summary import build_summary_section


def html_report(
    identification: Identification,
    runs: Sequence[ReportedRecording],
    *,
    diagnosis: Diagnosis | None = None,
    design: Design | None = None,
    validations: Sequence[ReportedValidation] = (),
    title: str = "",
    created: datetime | None = None,
    address: str = "",
) -> str:
    """Write the report of an identification as one HTML file without external resources.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit and its ancestors, which are the ladder.
    runs : sequence of ReportedRecording
        Recordings to show, each with the model's prediction: those it was identified from and held-out ones.
    diagnosis : Diagnosis, optional
        Diagnosis of this model or of the one that it was extended from.
    design : Design, optional
        The experiment that the data come from.
    validations : sequence of ReportedValidation
        The results of the model's validations.
    title : str
        The heading; the robot's name by default.
    created : datetime, optional
        With its time zone; now by default.
    address : str
        URL of a page that shows the model, for the section on provenance.

    Returns
    -------
    str
        The whole page as HTML.

    Raises
    ------
    DynidentError
        Where there is no recording to show.
    """
    if not runs:
        raise DynidentError("give at least one recording to show in the report", pointer="/recordings")
    report_time = created or datetime.now(UTC)
    sections = build_sections(identification, runs, diagnosis, design, report_time, validations, address)
    robot = identification.model.robot.name
    return (
        _load_environment()
        .get_template("report.html")
        .render(title=title or f"Identification of {robot}", sections=[(s, _render_section(s)) for s in sections])
    )


def build_sections(
    identification: Identification,
    runs: Sequence[ReportedRecording],
    diagnosis: Diagnosis | None,
    design: Design | None,
    created: datetime,
    validations: Sequence[ReportedValidation] = (),
    address: str = "",
) -> list[Section]:
    """Return the sections of a report in their order.

    Those of diagnosis, validations and design are there only where these are given.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    runs : sequence of ReportedRecording
        Recordings to show, each with the model's prediction.
    diagnosis : Diagnosis or None
        Diagnosis of this model or of the one that it was extended from.
    design : Design or None
        The experiment that the data come from.
    created : datetime
        When the report was made, with its time zone.
    validations : sequence of ReportedValidation
        The results of the model's validations.
    address : str
        URL of a page that shows the model, or "".

    Returns
    -------
    list of Section
        The sections, from the summary to the provenance.
    """
    fitted_recordings = [run.recording for run in runs if not run.held_out]
    return [
        build_summary_section(identification, runs, diagnosis, created, validations),
        build_ladder_section(identification, diagnosis),
        build_errors_section(identification, runs, diagnosis),
        build_residuals_section(runs),
        *([build_diagnosis_section(identification, diagnosis, fitted_recordings)] if diagnosis is not None else []),
        *([build_validation_section(validations)] if validations else []),
        build_parameters_section(identification),
        build_model_section(identification),
        build_robot_section(identification),
        *_build_design_sections(design, identification),
        build_data_section(identification, runs),
        build_provenance_section(identification, runs, created, address),
    ]


def _build_design_sections(design: Design | None, identification: Identification) -> list[Section]:
    if design is None:
        return []
    promises = build_promises_section(design, identification)
    return [build_design_section(design, identification.model.robot), *([promises] if promises is not None else [])]


def _render_section(section: Section) -> Markup:
    return Markup(_load_environment().get_template(f"{section.template}.html").render(it=section.content))


@lru_cache(maxsize=1)
def _load_environment() -> Environment:
    return Environment(
        loader=PackageLoader("dynident.reports"),
        # Names of robots, joints and files are the user's and may hold markup; a misspelt variable is an error.
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
