"""Models as files over HTTP: names, types, notes, and refusals that say what to do."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import casadi as ca
import httpx2
import mujoco
import numpy as np
import pytest

from dynident.export import ExportedFile, model_from_json
from dynident.export.export_request import FORMATS
from dynident.robot import library_table, robot_from_urdf
from dynident_client import Client, ProblemError
from dynident_client.resource_objects import Record
from dynident_service.identifications.adapters import build_file_response

DRIVES = [{"effect": name} for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous")]


def test_notes_travel_in_a_header_that_proxies_take() -> None:
    few = build_file_response(ExportedFile("a.urdf", "application/xml", b"<robot/>", ("Moment in N m², left out.",)))
    assert json.loads(few.headers["Dynident-Notes"]) == ["Moment in N m², left out."]
    assert few.headers["Dynident-Notes"].isascii()
    assert few.headers["Content-Disposition"] == 'attachment; filename="a.urdf"'
    many = build_file_response(ExportedFile("a.urdf", "application/xml", b"", tuple("x" * 500 for _ in range(40))))
    assert len(many.headers["Dynident-Notes"]) <= 3100
    assert json.loads(many.headers["Dynident-Notes"])[-1] == "35 more in the file"
    long = build_file_response(ExportedFile("a.urdf", "application/xml", b"", ("x" * 5000,)))
    assert json.loads(long.headers["Dynident-Notes"]) == ["1 notes in the file"]
    assert "Dynident-Notes" not in build_file_response(ExportedFile("a.c", "text/x-c", b"")).headers


@pytest.fixture(scope="module")
def model(live: Client) -> Record:
    robot = live.robots.create("My SCARA #1", modified_dh=library_table("scara"))
    trajectory = {"duration": 20.0, "sampling_rate": 200.0}
    simulation = live.simulations.create(robot, effects=[*DRIVES[1:], {"effect": "offset"}], trajectory=trajectory)
    run = live.measurements.get(simulation.wait().result["measurement_id"])
    effects = [*DRIVES, {"effect": "offset"}]
    return live.identifications.create(robot, [run], effects=effects).wait()


def answer_of(live: Client, model: Record, **query: str) -> httpx2.Response:
    return live.identifications._transport._http.get(f"/v1/identifications/{model.id}/export", params=query)


@pytest.mark.slow
def test_every_format_has_its_name_and_type(live: Client, model: Record) -> None:
    for format, name, media_type in (
        ("json", "my_scara_1.json", "application/json"),
        ("urdf", "my_scara_1.urdf", "application/xml"),
        ("mjcf", "my_scara_1.xml", "application/xml"),
        ("c", "dynident_my_scara_1.c", "text/x-c"),
        ("c_header", "dynident_my_scara_1.h", "text/x-c"),
        ("cpp_header", "dynident_my_scara_1.hpp", "text/x-c++"),
        ("casadi", "my_scara_1.casadi", "application/octet-stream"),
    ):
        answer = answer_of(live, model, format=format, nearest="true")
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"].split(";")[0] == media_type
        assert answer.headers["content-disposition"] == f'attachment; filename="{name}"'
        assert ("dynident-notes" in answer.headers) == (format in ("urdf", "mjcf"))
        if format in ("urdf", "mjcf"):
            assert any("offset" in note for note in json.loads(answer.headers["dynident-notes"]))


@pytest.mark.slow
def test_formats_are_listed_with_what_they_hold_and_cost(live: Client, model: Record) -> None:
    motion = {"duration": 8.0, "sampling_rate": 200.0}
    trial = live.simulations.create(
        model.data["robot_id"], effects=[*DRIVES[1:], {"effect": "offset"}], trajectory=motion, seed=5
    ).wait()
    held_out = live.measurements.get(trial.result["measurement_id"])
    request = model.data["request"]
    judged = live.identifications.create(
        model.data["robot_id"],
        request["measurement_ids"],
        validation=[held_out],
        effects=request["effects"],
        estimator="feasible",
    ).wait()
    http = live.identifications._transport._http
    listed = http.get(f"/v1/identifications/{judged.id}/exports", timeout=300).json()
    formats = {item["format"]: item for item in listed["items"]}
    assert set(formats) == set(FORMATS.names)
    assert all(item["contains"] for item in listed["items"])
    assert formats["json"]["held_out_error"] == pytest.approx(listed["held_out_error"])
    # URDF has no offset.
    assert formats["urdf"]["held_out_error"] > listed["held_out_error"]
    assert formats["kuka_load"]["held_out_error"] is None
    assert "payload" in formats["kuka_load"]["refusal"]
    for name, format in (("urdf", "urdf"), ("cpp", "cpp_header")):
        answer = http.get(f"/v1/identifications/{judged.id}/exports/{name}", timeout=300)
        assert answer.status_code == 200, answer.text
        assert float(answer.headers["X-Held-Out-Error"]) == pytest.approx(formats[format]["held_out_error"], rel=1e-4)
    assert http.get(f"/v1/identifications/{judged.id}/exports/fortran").status_code == 422


@pytest.mark.slow
def test_the_files_are_what_their_programs_read(live: Client, model: Record) -> None:
    document = json.loads(live.identifications.export(model))
    assert document["result"]["parameters"]
    read = model_from_json(json.dumps(document))
    state = [np.full((1, 4), value) for value in (0.1, 0.2, 0.3)]
    expected = read.torque(*state)[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.casadi"
        path.write_bytes(live.identifications.export(model, "casadi"))
        found = ca.Function.load(str(path))(*(one[0] for one in state))
    np.testing.assert_allclose(np.array(found)[:, 0], expected, rtol=1e-9)
    assert robot_from_urdf("read", live.identifications.export(model, "urdf", nearest=True).decode()).n == 4
    assert mujoco.MjModel.from_xml_string(live.identifications.export(model, "mjcf", nearest=True).decode()).nv == 4
    assert b"double tau[4]" in live.identifications.export(model, "c")


@pytest.mark.slow
def test_what_cannot_be_exported_is_a_problem_with_the_way_out(live: Client, model: Record) -> None:
    friction = live.identifications.create(
        model.data["robot_id"], model.data["request"]["measurement_ids"], effects=["coulomb", "viscous"]
    ).wait()
    with pytest.raises(ProblemError) as unfit:
        live.identifications.export(friction, "c")
    assert (unfit.value.status, "anyway" in unfit.value.problem["detail"]) == (409, True)
    with pytest.raises(ProblemError) as refused:
        live.identifications.export(friction, "urdf", anyway=True)
    assert refused.value.status == 422
    assert refused.value.problem["errors"][0]["pointer"] == "format"
    assert "C code" in refused.value.problem["detail"]
    assert b"double tau[4]" in live.identifications.export(friction, "c", anyway=True)
    with pytest.raises(ProblemError) as unknown:
        live.identifications.export(model, "fortran")  # type: ignore[arg-type]
    assert unknown.value.status == 422
