"""The report of an identification as one self-contained HTML file."""

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
from dynident.reports.run import ReportedRun
from dynident.reports.section import Section
from dynident.reports.sections.data import data_section
from dynident.reports.sections.design import design_section
from dynident.reports.sections.diagnosis import diagnosis_section
from dynident.reports.sections.errors import errors_section
from dynident.reports.sections.ladder import ladder_section
from dynident.reports.sections.model import model_section
from dynident.reports.sections.parameters import parameters_section
from dynident.reports.sections.promises import promises_section
from dynident.reports.sections.provenance import provenance_section
from dynident.reports.sections.residuals import residuals_section
from dynident.reports.sections.robot import robot_section
from dynident.reports.sections.summary import summary_section
from dynident.reports.sections.validation import validation_section
from dynident.reports.validated import ReportedValidation


def html_report(
    identification: Identification,
    runs: Sequence[ReportedRun],
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
        With its ancestors, which are the ladder.
    runs : sequence of ReportedRun
        Recordings to show, each with the model's prediction: those it was identified from and held-out ones.
    diagnosis : Diagnosis, optional
        Of this model or of the one that it was extended from.
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

    Raises
    ------
    DynidentError
        Where there is no recording to show.
    """
    if not runs:
        raise DynidentError("give at least one recording to show in the report", pointer="/measurement_ids")
    report_time = created or datetime.now(UTC)
    sections = sections_of(identification, runs, diagnosis, design, report_time, validations, address)
    robot = identification.model.robot.name
    return (
        _environment()
        .get_template("report.html")
        .render(title=title or f"Identification of {robot}", sections=[(s, _filled(s)) for s in sections])
    )


def sections_of(
    identification: Identification,
    runs: Sequence[ReportedRun],
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
    runs : sequence of ReportedRun
    diagnosis : Diagnosis or None
    design : Design or None
    created : datetime
    validations : sequence of ReportedValidation
    address : str
        URL of a page that shows the model, or "".

    Returns
    -------
    list of Section
    """
    fitted_recordings = [run.recording for run in runs if not run.held_out]
    return [
        summary_section(identification, runs, diagnosis, validations),
        ladder_section(identification, diagnosis),
        errors_section(identification, runs, diagnosis),
        residuals_section(runs),
        *([diagnosis_section(identification, diagnosis, fitted_recordings)] if diagnosis is not None else []),
        *([validation_section(validations)] if validations else []),
        parameters_section(identification),
        model_section(identification),
        robot_section(identification),
        *_design_sections(design, identification),
        data_section(identification, runs),
        provenance_section(identification, runs, created, address),
    ]


def _design_sections(design: Design | None, identification: Identification) -> list[Section]:
    if design is None:
        return []
    promises = promises_section(design, identification)
    return [design_section(design, identification.model.robot), *([promises] if promises is not None else [])]


def _filled(section: Section) -> Markup:
    return Markup(_environment().get_template(f"{section.template}.html").render(it=section.content))


@lru_cache(maxsize=1)
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("dynident.reports"),
        # Names of robots, joints and files are the user's and may hold markup; a misspelt variable is an error.
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
