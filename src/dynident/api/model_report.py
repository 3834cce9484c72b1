"""`dynident.report`: the report on a model as one file, HTML or PDF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from dynident.advice import AdvisedDiagnosis
from dynident.api.argument_checks import CheckedResult, check_arguments, require
from dynident.api.model import Model
from dynident.api.model_diagnosis import DiagnosedModel
from dynident.api.model_identification import as_model
from dynident.api.model_validation import Validations
from dynident.api.motion_design import DesignedMotion
from dynident.diagnosis import compare
from dynident.file_output import check_ending, write_atomically
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.reports import ReportedRecording, ReportedValidation
from dynident.text_encoding import encode_text

_MADE_BY = {"diagnosis": "diagnose", "validations": "validate", "design": "design"}
_ENDINGS = (".html", ".htm", ".pdf")


@dataclass(frozen=True, eq=False)
class Report(CheckedResult):
    """A page that needs no other files; a notebook shows it in a frame.

    Parameters
    ----------
    title : str
        Heading of the page.
    html : str
        The whole page, with its figures and styles in it.
    """

    title: str
    html: str

    def save(self, path: str | Path) -> None:
        """Write the report as an HTML page, or where the file's ending is .pdf, as PDF on A4.

        Parameters
        ----------
        path : path
            The file to write; its ending has to be .html, .htm or .pdf.

        Raises
        ------
        DynidentError
            For another ending than .html or .pdf, or a folder that does not exist.
        """
        path = check_ending(path, _ENDINGS)
        if path.suffix.lower() == ".pdf":
            from dynident.reports import render_pdf

            write_atomically(path, render_pdf(self.html))
        else:
            write_atomically(path, encode_text(self.html))

    def __repr__(self) -> str:
        return f"Report({self.title}, {len(self.html) // 1000} kB; save(…) writes it as HTML or PDF)"

    def _repr_html_(self) -> str:
        style = "width:100%;height:700px;border:1px solid #ccc"
        # The page goes into an attribute, in a frame of its own: its styles must not reach the notebook.
        title, page = escape(self.title, quote=True), escape(self.html, quote=True)
        return f'<iframe title="{title}" style="{style}" srcdoc="{page}"></iframe>'


@check_arguments
def report(
    model: Model,
    *,
    diagnosis: DiagnosedModel | AdvisedDiagnosis | None = None,
    validations: Validations | Sequence[ReportedValidation] | None = None,
    design: DesignedMotion | None = None,
    title: str = "",
    progress: Progress = ignore_progress,
) -> Report:
    """Report everything about a model on one page: errors, figures, parameters, data.

    Parameters
    ----------
    model : Model
        With its recordings.
    diagnosis : diagnosis, optional
        Of this model, or of the one that it was extended from.
    validations : validations, optional
        Results of `validate`, or as the report shows them, for a section of their own.
    design : designed motion, optional
        The experiment that the data come from.
    title : str
        The heading; the robot's name by default.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Report
        The page, which `save` writes as HTML or PDF.

    Raises
    ------
    DynidentError
        Where the model has no recordings.

    Examples
    --------
    >>> model = dy.identify(robot, runs[:1], validation=runs[1:])
    >>> dy.report(model, title="The arm in cell 4").save("report.html")
    """
    from dynident.reports import html_report

    model = as_model(model)
    for value, kind, name in (
        (diagnosis, (DiagnosedModel, AdvisedDiagnosis), "diagnosis"),
        (validations, (Validations, list), "validations"),
        (design, DesignedMotion, "design"),
    ):
        remedy = f"give what dy.{_MADE_BY[name]}(…) gives"
        require(value is None or isinstance(value, kind), value, name, remedy)
    model.check_data("report on the model")
    all_recordings = [*((item, False) for item in model.recordings), *((item, True) for item in model.validation)]
    runs = []
    for index, (item, held_out) in enumerate(all_recordings):
        # Comparing takes most of the time; the last fifth is left for drawing the page.
        share = scale_progress(progress, 0.8 * index / len(all_recordings), 0.8 * (index + 1) / len(all_recordings))
        comparison = compare(model.identification, item.recording, share)
        origin = () if item.source is None else (item.source.edits, item.source.sha256, item.source.metadata)
        runs.append(ReportedRecording(item.recording, comparison, held_out, item.checks, *origin))
    heading = title or f"Identification of {model.robot.name}"
    page = html_report(
        model.identification,
        runs,
        diagnosis=diagnosis.advised_diagnosis if isinstance(diagnosis, DiagnosedModel) else diagnosis,
        design=None if design is None else design.design,
        validations=[
            validation
            if isinstance(validation, ReportedValidation)
            else ReportedValidation(validation.title, validation.judged, kind=validation.kind)
            for validation in validations or ()
        ],
        title=heading,
    )
    progress(1.0, "written")
    return Report(heading, page)
