"""A request is stated once: a new estimator in a file of its own is in the contract and on the command line."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path

import pytest
from support.installed_versions import older_than_locked
from support.openapi_contract import CONTRACT
from typer.testing import CliRunner

from dynident.diagnosis import DiagnosisChoices
from dynident.errors import DynidentError
from dynident.excitation import DesignRequest
from dynident.export import ExportChoices
from dynident.identification import IdentificationChoices
from dynident.identification.identification_choices import EssentialChoices, KnownLoad
from dynident.identification.methods.base_classes import ESTIMATORS, MODELS, PRIORS, STRATEGIES, Estimator
from dynident.recordings import RecordingMetadata, Revision
from dynident.recordings.recording_metadata import Filters
from dynident.reports import ReportChoices
from dynident.robot import Drive, Limits
from dynident.robot.bundled_arms import library_names, robot_from_library
from dynident.schema.fields import declare_field, get_description
from dynident.schema.registry import kind_to_document
from dynident.simulation import ActingEffect, Simulated, Warming, list_drive_effects, resolve_true_effects
from dynident.simulation.virtual_robot_request import list_usual_effects
from dynident.validation.validation_request import TRIALS, build_trial
from dynident_cli.program_and_exit_codes import app
from dynident_service.designs import wire_types as designs
from dynident_service.identifications import wire_types as identifications
from dynident_service.measurements.adapters import show_revision, to_recording_metadata, to_revision
from dynident_service.measurements.wire_types import MeasurementMetadata
from dynident_service.shared.field_by_field import to_body, to_body_value, to_request

PAGE = (Path(__file__).parents[2] / "docs" / "own-methods.md").read_text(encoding="utf-8")
NEW = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[0]

# The package is told of a second folder, as if the file lay in it.
PROGRAM = """
import json, sys
import dynident.identification.methods.estimator_options as home
home.__path__.append({folder!r})
from dynident_service.shared.field_by_field import to_request
from dynident_service.openapi import build_request_types
from dynident_service.identifications.wire_types import IdentificationRequest
from dynident.identification import IdentificationChoices
from dynident_service.openapi import render_contract

document = json.loads(render_contract())
field = document["components"]["schemas"]["IdentificationRequest"]["properties"]["estimator"]
body = {{"robot_id": "r", "measurement_ids": ["m"], "estimator": {{"name": "tempered", "power": 0.7}}}}
choices = to_request(IdentificationRequest.model_validate(body), IdentificationChoices, preprocessing=None)
print(json.dumps({{
    "field": field,
    "options": document["components"]["schemas"]["Tempered"]["properties"],
    "client": build_request_types(document),
    "taken": [choices.solver.name, choices.solver.power],
}}))
from dynident_cli.program_and_exit_codes import app
app(["identify", "--help"], prog_name="dynident")
"""


@pytest.fixture(scope="module")
def grown(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, object], str]:
    """The contract with a new estimator, and the help of the command line."""
    if older_than_locked("fastapi"):
        pytest.skip("the client's types are written from the contract of a newer FastAPI")
    folder: Path = tmp_path_factory.mktemp("estimators")
    (folder / "tempered.py").write_text(NEW)
    command = [sys.executable, "-c", PROGRAM.format(folder=str(folder))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, _, rest = done.stdout.partition("\n")
    return json.loads(first), " ".join(rest.split())


def test_a_new_estimator_is_in_the_contract_with_its_options_and_words(grown) -> None:
    told, _ = grown
    names, options = told["field"]["anyOf"]
    assert names["enum"] == [*ESTIMATORS.names, "tempered"]
    assert options["$ref"].endswith("/Tempered")
    assert told["options"]["power"]["maximum"] == 1
    assert told["field"]["x-choices"][-1]["label"] == "tempered least squares"
    assert told["taken"] == ["tempered", 0.7]


def test_a_new_estimator_is_in_the_signature_of_the_client(grown) -> None:
    client = grown[0]["client"]
    assert "class Tempered(TypedDict, total=False):" in client
    assert '"tempered"] | Tempered' in client


def test_a_new_estimator_is_in_the_help_of_the_command_line(grown) -> None:
    assert "tempered:power=… (between ols and wls)" in grown[1]


def test_every_kind_says_what_it_is_called_and_what_it_is_for() -> None:
    for kinds in (ESTIMATORS, STRATEGIES, MODELS, PRIORS):
        for kind in kinds:
            assert kind.name
            assert kind.label
            assert kind.words.endswith(".")


def test_every_field_of_a_design_says_what_it_is() -> None:
    groups = ("criterion", "trajectory", "standing")
    parts = [type(one.default_factory()) for one in fields(DesignRequest) if one.name in groups[1:]]
    for request in (DesignRequest, *parts, IdentificationChoices):
        for one in fields(request):
            assert get_description(one).words or one.name in groups, one.name


def test_an_option_that_an_estimator_has_not_is_refused_with_those_it_has() -> None:
    with pytest.raises(DynidentError, match="has no option 'force'") as caught:
        ESTIMATORS.from_document({"name": "wls", "force": 2})
    assert caught.value.pointer == "/estimator/force"


def test_a_design_comes_back_from_the_wire_as_it_was_asked_for() -> None:
    body = {
        "robot_id": "r",
        "criterion": {"name": "separation", "effects": [{"effect": "stribeck", "joints": ["a"]}]},
        "trajectory": {"family": "b_spline", "speeds": [0.1, 0.2], "dwell": [0.0, 1.0]},
        "limits": {"a": {"velocity": 1.0}},
        "surroundings": {"boxes": [{"name": "crate", "center": [0, 0, 1], "size": [1, 1, 1]}]},
        "model": None,
    }
    asked = to_request(designs.DesignRequest.model_validate(body), DesignRequest)
    assert asked.model == "dynamic"
    assert asked.surroundings.boxes[0].size == (1.0, 1.0, 1.0)
    again = designs.DesignRequest.model_validate({"robot_id": "r", **to_body_value(asked)})
    assert to_request(again, DesignRequest) == asked


def test_the_filters_of_an_identification_stay_what_they_are_without_data() -> None:
    body = identifications.IdentificationRequest.model_validate({"robot_id": "r", "measurement_ids": ["m"]})
    assert to_request(body, IdentificationChoices, preprocessing=None) == IdentificationChoices()


@pytest.mark.parametrize(("kind", "field"), [("direct", "mass"), ("payload", "limit"), ("bootstrap", "cutoffs")])
def test_what_a_validation_does_not_take_is_refused(kind: str, field: str) -> None:
    with pytest.raises(DynidentError, match="leave it out") as caught:
        build_trial(kind, {field: 1.0})
    assert caught.value.pointer == f"/{field}"


def test_every_validation_says_what_it_is() -> None:
    assert all(one.words for one in TRIALS.choices)


def test_an_estimator_with_options_is_told_with_them_and_kept_in_the_file_of_the_model() -> None:
    @dataclass(frozen=True)
    class Halved(Estimator):
        """An estimator with an option."""

        name = "halved"
        share: float = declare_field("A share", default=0.5, above=0, at_most=1)

        def solve(self, problem):
            raise NotImplementedError

    assert (Halved().request_value, Halved().name_with_options) == ("halved", "halved")
    assert Halved(0.2).name_with_options == "halved (share 0.2)"
    assert kind_to_document(Halved(0.2)) == {"name": "halved", "share": 0.2}
    with pytest.raises(DynidentError, match="above 0 and at most 1") as caught:
        Halved(2.0)
    assert caught.value.pointer == "/share"


def test_every_field_of_a_simulation_says_what_it_is_and_none_stated_is_the_default_everywhere() -> None:
    for request in (Simulated, ActingEffect, Warming):
        for one in fields(request):
            assert get_description(one).words or one.name in ("effects", "noise", "shape_parameters"), one.name
    body = {"robot_id": "r", "design_id": "d"}
    assert to_request(designs.SimulationRequest.model_validate(body), Simulated) == Simulated()


def test_a_virtual_robot_asked_for_by_its_usual_effects_is_the_typical_one() -> None:
    for name in library_names():
        robot = robot_from_library(name)
        assert set(resolve_true_effects(list_usual_effects(), robot)) == set(list_drive_effects(robot))


BODIES = (
    (DiagnosisChoices, "DiagnosisRequest", "diagnose"),
    (KnownLoad, "DriveGainsRequest", "gains"),
    (ReportChoices, "ReportRequest", "report"),
    (RecordingMetadata, "MeasurementMetadata", ""),
    (Revision, "RevisionRequest-Input", ""),
    (Filters, "Preprocessing", ""),
    (Limits, "Limits", ""),
    (Drive, "Drive", ""),
)


@pytest.mark.parametrize(("science", "asked", "verb"), BODIES)
def test_the_words_of_a_field_are_those_of_the_contract_and_of_the_help(science: type, asked: str, verb: str) -> None:
    if older_than_locked("fastapi"):
        pytest.skip("older ones give the same schemas other names")
    told = CONTRACT["components"]["schemas"][asked]["properties"]
    shown = " ".join(CliRunner().invoke(app, [verb, "--help"], env={"COLUMNS": "200"}).output.split()) if verb else ""
    for one in fields(science):
        about = get_description(one)
        assert about.words, one.name
        assert told[one.name]["description"] == about.sentence
        assert told[one.name].get("x-unit", "") == about.unit
        assert not verb or about.option == "-" or about.sentence in shown


@pytest.mark.parametrize(("science", "path"), [(EssentialChoices, "essential"), (ExportChoices, "export")])
def test_the_parameters_of_a_query_are_the_fields_of_what_it_asks_for(science: type, path: str) -> None:
    operation = CONTRACT["paths"][f"/v1/identifications/{{identification_id}}/{path}"]["get"]
    told = {one["name"]: one for one in operation["parameters"] if one["in"] == "query"}
    assert set(told) == {one.name for one in fields(science)}
    for one in fields(science):
        assert told[one.name]["description"] == get_description(one).sentence
        assert told[one.name]["schema"]["default"] == one.default


def test_what_is_said_of_a_file_comes_back_from_the_wire_as_it_was_said() -> None:
    said = RecordingMetadata(
        "run", columns={"q1": "a"}, permutation={"tau": (2, 1)}, windows=((0.0, 1.0),), accept=("joint_motion",)
    )
    assert to_recording_metadata(to_body(MeasurementMetadata, said, robot_id="r")) == said
    change = Revision(exclude=((2.0, 3.0),), permutation={"q": (2, 1)}, signs={"tau2": -1.0})
    assert to_revision(show_revision(change)) == change
