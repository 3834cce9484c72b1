"""The tools (`inspect`, `identify`, `diagnose`, `design`, …): each calls the library and answers a view."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field

import dynident as dy
from dynident.advice import AdvisedDiagnosis
from dynident.api.model_diagnosis import DiagnosedModel
from dynident.api.motion_design import resolve_request
from dynident.diagnosis.diagnosis_request import DiagnosisChoices
from dynident.errors import DynidentError
from dynident.excitation import DesignRequest
from dynident.export import ExportChoices
from dynident.identification.identification_choices import IdentificationChoices
from dynident.progress import Progress, scale_progress
from dynident.robot.json_fields import parse_json
from dynident.text_encoding import encode_text
from dynident_service.agents import arguments
from dynident_service.agents.arguments import Folder
from dynident_service.designs.adapters import describe_design
from dynident_service.designs.wire_types import DesignResult
from dynident_service.diagnoses.adapters import describe_diagnosis, restore_diagnosis
from dynident_service.diagnoses.wire_types import DiagnosisResult, Reason
from dynident_service.identifications.adapters import describe_identification, show_verdict
from dynident_service.identifications.wire_types import IdentificationResult, VerdictView
from dynident_service.measurements.adapters import describe_inspection
from dynident_service.measurements.wire_types import InspectionView
from dynident_service.shared.field_by_field import to_request, to_view
from dynident_service.shared.wire_types import ViewModel
from dynident_service.validations.wire_types import VerdictWord

if TYPE_CHECKING:
    from dynident.api.figure import Figure

_READ = 0.3
"""Share of the progress that reading recordings takes."""


@dataclass(frozen=True)
class Answer:
    """The result of a tool: data, the text that a terminal would show, and a figure."""

    result: BaseModel
    text: str
    figure: Figure | None = None


@dataclass(frozen=True)
class Tool:
    """A tool: the function that does its work, its arguments and its result.

    `call` takes folder, arguments and progress; the docstring of `function`, the library's, describes the tool.
    """

    name: str
    function: Callable[..., object]
    arguments: type[BaseModel]
    result: type[BaseModel]
    call: Callable[[Folder, Any, Progress], Answer]
    writes: bool = True

    @property
    def description(self) -> str:
        """The first paragraph of the function's docstring."""
        return (self.function.__doc__ or "").partition("\n\n")[0].strip()


class IdentifiedModel(IdentificationResult):
    """An identified model, what it is fit for, and its file."""

    verdict: VerdictView
    file: str


class StoredDiagnosis(DiagnosisResult):
    """A diagnosis, and its file."""

    file: str


class StoredDesign(DesignResult):
    """A design, and the file of its trajectory."""

    file: str


class ModelTest(ViewModel):
    """One test of a model."""

    kind: str
    title: str
    verdict: VerdictWord
    reason: str


class ModelTests(ViewModel):
    """ModelTests of a model."""

    verdict: VerdictWord = Field(description="fail if one of them fails")
    tests: list[ModelTest]


class WrittenFile(ViewModel):
    """A file that was written."""

    file: str
    size: int = Field(description="Bytes")
    media_type: str
    notes: list[str] = Field(description="What the format cannot hold")


def _inspect(folder: Folder, given: arguments.InspectArguments, _: Progress) -> Answer:
    robot = None if given.robot is None else arguments.load_robot(folder, given.robot)
    inspected = dy.inspect(folder.find_recording(given.file, "/file"), robot, rate=given.rate)
    view = describe_inspection(inspected.inspection, inspected.inspection.sha256)
    # It is there to be drawn, and thousands of digits for who reads.
    view.preview.sketch.clear()
    return Answer(view, repr(inspected))


def _identify(folder: Folder, given: arguments.IdentifyArguments, progress: Progress) -> Answer:
    out = folder.find_new_file(given.out, "/out")
    robot = arguments.load_robot(folder, given.robot)
    choices = to_request(given, IdentificationChoices, effects=IdentificationChoices().effects, preprocessing=None)
    fitted = arguments.read_recordings(
        folder, robot, given.recordings, "recordings", scale_progress(progress, 0, _READ / 2)
    )
    held_out = arguments.read_recordings(
        folder, robot, given.validation, "validation", scale_progress(progress, _READ / 2, _READ)
    )
    model = dy.identify(
        robot,
        fitted,
        validation=held_out,
        effects=arguments.to_effects(given.effects),
        filters=arguments.to_filters(given.preprocessing),
        choices=choices,
        progress=scale_progress(progress, _READ, 1.0),
    )
    verdict = model.verdict()
    model.save(out)
    result = IdentifiedModel(
        **describe_identification(model.identification, None).model_dump(),
        verdict=show_verdict(verdict),
        file=given.out,
    )
    return Answer(result, _tell([fitted, held_out], f"{model.summary()}\n\n{verdict.summary}"), model.plot())


def _diagnose(folder: Folder, given: arguments.DiagnoseArguments, progress: Progress) -> Answer:
    out = folder.find_new_file(given.out, "/out")
    reading = scale_progress(progress, 0.0, _READ / 2)
    model, runs = _load_model_with(folder, given.model, given.recordings, reading)
    reading = scale_progress(progress, _READ / 2, _READ)
    held_out = arguments.read_recordings(folder, model.robot, given.validation, "validation", reading)
    choices = to_request(given, DiagnosisChoices)
    diagnosed = dy.diagnose(
        replace(model, recordings=runs, validation=held_out),
        candidates=choices.candidates,
        max_effects=choices.max_effects,
        significance=choices.significance,
        hardware=choices.hardware,
        progress=scale_progress(progress, _READ, 1.0),
    )
    diagnosis = diagnosed.advised_diagnosis if given.next_experiment else diagnosed.diagnosis
    view = describe_diagnosis(diagnosis, model.robot.name, diagnosed.examination.doubts)
    out.write_bytes(encode_text(view.model_dump_json(indent=1)))
    result = StoredDiagnosis(**view.model_dump(), file=given.out)
    return Answer(result, _tell([runs, held_out], repr(diagnosed)), diagnosed.plot() if diagnosed.candidates else None)


def _explain(folder: Folder, given: arguments.WhyNotArguments, _: Progress) -> Answer:
    reason = _load_diagnosis(folder, given.diagnosis).why_not(given.effect, given.joint)
    return Answer(to_view(Reason, reason), reason.text)


def _design(folder: Folder, given: arguments.DesignArguments, progress: Progress) -> Answer:
    out = folder.find_new_file(given.out, "/out")
    machine: dy.Robot | dy.Model
    if given.robot is not None and given.model is None:
        machine = arguments.load_robot(folder, given.robot)
    elif given.model is not None and given.robot is None:
        machine = _load_model(folder, given.model)
    else:
        raise DynidentError("give either the robot or a model of it", pointer="/robot", title="Nothing to design")
    request = to_request(given, DesignRequest, effects=None)
    if given.diagnosis is not None:
        proposed = resolve_request(_load_diagnosis(folder, given.diagnosis))
        request = replace(proposed, limits=request.limits, surroundings=request.surroundings)
    robot = machine.robot if isinstance(machine, dy.Model) else machine
    earlier = arguments.read_recordings(folder, robot, given.earlier, "earlier", scale_progress(progress, 0.0, 0.1))
    motion = dy.design(
        machine,
        request,
        effects=arguments.to_effects(given.effects),
        earlier=earlier,
        progress=scale_progress(progress, 0.1, 1.0),
    )
    motion.save(out)
    result = StoredDesign(**describe_design(motion.design).model_dump(), file=given.out)
    text = "\n".join([motion.summary, *motion.design.notes])
    return Answer(result, text, motion.plot())


def _find_changes(folder: Folder, given: arguments.ChangesArguments, progress: Progress) -> Answer:
    model, before = _load_model_with(folder, given.model, given.before, scale_progress(progress, 0.0, _READ / 2))
    after = arguments.read_recordings(
        folder, model.robot, given.after, "after", scale_progress(progress, _READ / 2, _READ)
    )
    changes = dy.changes(
        model,
        before=before,
        after=after,
        candidates=given.candidates,
        progress=scale_progress(progress, _READ, 1.0),
    )
    is_drawn = bool(changes.items or changes.diagnosis.friction)
    result = describe_diagnosis(changes.diagnosis, model.robot.name)
    return Answer(result, _tell([before, after], repr(changes)), changes.plot() if is_drawn else None)


def _validate(folder: Folder, given: arguments.ValidateArguments, progress: Progress) -> Answer:
    model, fitted = _load_model_with(folder, given.model, given.recordings, scale_progress(progress, 0.0, _READ / 2))
    held_out = arguments.read_recordings(
        folder, model.robot, given.validation, "validation", scale_progress(progress, _READ / 2, _READ)
    )
    tests = dy.validate(
        model.with_data(fitted) if fitted else model,
        held_out,
        limit=given.limit,
        progress=scale_progress(progress, _READ, 1.0),
    )
    views = [
        ModelTest(kind=test.kind, title=test.title, verdict=test.verdict, reason=test.judged.reason) for test in tests
    ]
    return Answer(ModelTests(verdict=tests.verdict, tests=views), _tell([fitted, held_out], repr(tests)))


def _export(folder: Folder, given: arguments.ExportArguments, _: Progress) -> Answer:
    model, out = _load_model(folder, given.model), folder.find_new_file(given.out, "/out")
    choices = to_request(given, ExportChoices)
    file = model.export(out, nearest=choices.nearest, anyway=choices.anyway)
    result = WrittenFile(file=given.out, size=len(file.content), media_type=file.media_type, notes=list(file.notes))
    return Answer(result, "\n".join([given.out, *file.notes]))


def _load_model(folder: Folder, path: str) -> dy.Model:
    return dy.load_model(folder.find_file(path, "/model"))


def _load_model_with(
    folder: Folder, path: str, recordings: arguments.Recordings, progress: Progress
) -> tuple[dy.Model, dy.Recordings]:
    model = _load_model(folder, path)
    return model, arguments.read_recordings(folder, model.robot, recordings, "recordings", progress)


def _tell(recordings: Iterable[dy.Recordings], text: str) -> str:
    """Return a text behind the findings of the recordings: with which columns they were read, for example."""
    lines = (f"{item.name}, {finding}" for runs in recordings for item in runs for finding in item.findings)
    return "\n".join([*lines, text])


def _load_diagnosis(folder: Folder, path: str) -> AdvisedDiagnosis:
    text = folder.find_file(path, "/diagnosis").read_text(encoding="utf-8", errors="replace")
    document: Any = parse_json(text, "/diagnosis", "Unusable diagnosis")
    return restore_diagnosis(document)


TOOLS = (
    Tool("inspect", dy.inspect, arguments.InspectArguments, InspectionView, _inspect, writes=False),
    Tool("identify", dy.identify, arguments.IdentifyArguments, IdentifiedModel, _identify),
    Tool("diagnose", dy.diagnose, arguments.DiagnoseArguments, StoredDiagnosis, _diagnose),
    Tool("why_not", DiagnosedModel.why_not, arguments.WhyNotArguments, Reason, _explain, writes=False),
    Tool("design", dy.design, arguments.DesignArguments, StoredDesign, _design),
    Tool("changes", dy.changes, arguments.ChangesArguments, DiagnosisResult, _find_changes, writes=False),
    Tool("validate", dy.validate, arguments.ValidateArguments, ModelTests, _validate, writes=False),
    Tool("export", dy.Model.export, arguments.ExportArguments, WrittenFile, _export),
)
