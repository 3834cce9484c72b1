"""The client against each installation that the service is run as: every operation, and what goes wrong.

The other tests with a client speak to the smallest installation, unless another one is named with `--installation`.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from installations import LARGER, SMALLEST
from support.openapi_contract import COLLECTIONS, OPERATIONS, operation_of
from support.oracles import pinocchio_torque

from dynident.robot import robot_from_urdf
from dynident_client import Client, Computed, JobCancelled, JobFailed, ProblemError, Record
from dynident_client.collection_bases import Collection
from dynident_client.resource_objects import Measurement, Robot

GAINS = (20.0, 8.0)
MASS = 3.0
CENTRE = (0.4, 0.0, 0.0)
DRIVES = {"turn": {"drive_gain": GAINS[0]}, "swing": {"drive_gain": GAINS[1]}}
EFFECTS = ["rigid_body", "coulomb", "viscous"]
MOTION = {"duration": 6.0, "periods": 2, "sampling_rate": 100.0}
SPRING = {"effect": "joint_spring", "joints": ["turn"]}
QUICK = {"duration": 3.0, "harmonics": 3, "sampling_rate": 50.0}
INERTIAL = (
    '<inertial><origin xyz="0.2 0 0.1"/><mass value="{mass}"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
URDF = """
<robot name="arm">
  <link name="base"/>
  <link name="one">INERTIAL</link>
  <link name="two">INERTIAL<collision><geometry><mesh filename="two.stl"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="3" effort="200"/></joint>
  <joint name="swing" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0.5 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="3" effort="200"/></joint>
</robot>""".replace("INERTIAL", INERTIAL.format(mass=5.0))
LOAD = (
    f'<link name="load"><inertial><mass value="{MASS}"/>'
    '<inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="hold" type="fixed"><parent link="two"/><child link="load"/><origin xyz="0.4 0 0"/></joint></robot>'
)
LOADED = URDF.replace("</robot>", LOAD)
TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])


def as_stl() -> bytes:
    lines = ["solid two"]
    for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += ["vertex {} {} {}".format(*TETRAHEDRON[corner]) for corner in face]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid two\n"]).encode()


def written(path: Path, *, loaded: bool, seed: int) -> Path:
    """Currents of the arm along a motion, as CSV."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 8.0, 0.01)
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    for k, (rate, phase) in enumerate(((0.25, 0.0), (0.5, 1.0), (0.75, 2.0))):
        w, size = 2 * np.pi * rate, 0.5 / (k + 1)
        for j in range(2):
            at = w * t + phase + j
            q[:, j] += size * np.sin(at)
            dq[:, j] += size * w * np.cos(at)
            ddq[:, j] -= size * w**2 * np.sin(at)
    torque = pinocchio_torque(robot_from_urdf("arm", LOADED if loaded else URDF), q, dq, ddq)
    torque += 1.5 * np.sign(dq) + 2.0 * dq
    current = torque / GAINS + rng.normal(0.0, 0.01, torque.shape)
    pacsv.write_csv(
        pa.table({"t": t, "q1": q[:, 0], "q2": q[:, 1], "current1": current[:, 0], "current2": current[:, 1]}), path
    )
    return path


@dataclass
class Bench:
    """A client of one installation, and which operations of the contract it has had an answer of."""

    client: Client
    folder: Path
    answered: set[str] = field(default_factory=set)


# The largest has the database and the store of the one between, and differs by its cluster alone.
MARKS = dict(zip(LARGER, (pytest.mark.thorough, pytest.mark.slow), strict=True))


@pytest.fixture(scope="module", params=[SMALLEST, *(pytest.param(name, marks=MARKS[name]) for name in LARGER)])
def installation(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def bench(live: Client, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    made = Bench(live, tmp_path_factory.mktemp("bench"))

    def note(answer: httpx2.Response) -> None:
        if answer.is_success:
            made.answered.add(operation_of(answer.request))

    live._transport._http.event_hooks["response"].append(note)
    yield made
    live._transport._http.event_hooks["response"].remove(note)


@pytest.fixture(scope="module")
def robot(bench: Bench) -> Robot:
    return bench.client.robots.create("arm", urdf=URDF, drives=DRIVES)


def test_every_operation_of_the_client_does_what_it_says(bench: Bench, robot: Robot) -> None:
    told_of_the_service(bench.client)
    kept_of_a_robot(bench, robot)
    runs = recorded(bench, robot)
    model, diagnosis = identified(bench.client, robot, runs)
    campaigned(bench.client, robot, runs)
    told_by_currents(bench, robot)
    reported(bench, model, diagnosis)
    everything_is_listed_and_deleted(bench.client)
    stopped(bench.client)
    assert OPERATIONS - bench.answered == set()


def told_of_the_service(client: Client) -> None:
    assert client.health()["status"] == "ok"
    assert set(client.readiness()["checks"]) >= {"database", "objects", "engine"}
    assert "dynident_jobs" in client.metrics()
    assert "coulomb" in {one["id"] for one in client.effects()}
    assert isinstance(client.usage(), list)
    assert "ur10" in {robot["name"] for robot in client.known_robots()}


def kept_of_a_robot(bench: Bench, robot: Robot) -> None:
    mesh = bench.folder / "two.stl"
    mesh.write_bytes(as_stl())
    (sent,) = bench.client.robots.put_meshes(robot, {"two.stl": mesh})["meshes"]
    assert sent["size"] == mesh.stat().st_size
    (surface,) = bench.client.robots.geometry(robot)["surfaces"]
    assert len(surface["triangles"]) == 4
    first, turned = bench.client.robots.poses(robot, [[0.0, 0.0], [0.3, 0.0]])["poses"]
    assert len(first) == len(turned) == 2
    assert first != turned
    assert bench.client.robots.label(robot, tags=["tried"])["tags"] == ["tried"]
    assert bench.client.robots.get(robot).joints[0]["name"] == "turn"


def recorded(bench: Bench, robot: Robot) -> list[Measurement]:
    client = bench.client
    design = client.designs.create(robot, kind="random", trajectory=QUICK, random_trajectories=3).wait()
    assert len(client.designs.trajectory(design).splitlines()) == design.result["n_samples"] + 1
    assert client.designs.trajectory(design, "parquet")[:4] == b"PAR1"
    fast, slow = (json.loads(client.designs.trajectory(design, "json", speed=speed)) for speed in (1.0, 0.25))
    assert slow["t"][-1] == pytest.approx(4 * fast["t"][-1])
    assert slow["q"] == fast["q"]
    assert client.designs.trajectory(design, "parquet", speed=0.25)[:4] == b"PAR1"
    assert client.designs.clearances(design)
    effects = [{"effect": "coulomb"}, {"effect": "viscous"}, {**SPRING, "parameters": {"ks": 25.0, "bs": 1.0}}]
    runs = []
    for seed in (1, 2):
        told: list[float] = []
        made = client.simulations.create(robot, effects=effects, trajectory=MOTION, seed=seed)
        made.wait(lambda fraction, message, told=told: told.append(fraction))
        assert told[-1] == 1.0
        runs.append(client.measurements.get(made.result["measurement_id"]))
    content = b"".join(client.measurements.content(runs[0]))
    assert content[:4] == b"PAR1"
    assert len(client.measurements.raw(runs[0], ["q1"], points=100)["t"]) > 50
    assert client.measurements.standstills(runs[0])
    assert client.measurements.label(runs[0], tags=["first"])["tags"] == ["first"]
    file = bench.folder / "again.parquet"
    file.write_bytes(content)
    again = client.measurements.upload(robot, file)
    assert again["sha256"] == runs[0]["sha256"]
    looked_at = client.imports.upload(robot, file)
    taken = client.measurements.of_import(looked_at)
    shorter = client.measurements.revise(taken, windows=[[1.0, 9.0]])
    assert shorter["parent_id"] == taken.id
    recorded_while_the_robot_moves(client, robot, content)
    return runs


def recorded_while_the_robot_moves(client: Client, robot: Robot, content: bytes) -> None:
    live = client.measurements.begin(robot, "live")
    client.measurements.append_rows(live, content, offset=0, media_type="application/vnd.apache.parquet")
    first = next(event for event in client.measurements.follow(live) if event.event == "estimate")
    assert first.data["rows"] > 100
    done = client.measurements.append_rows(live, b"", offset=first.data["rows"], finished=True)
    assert done["n_samples"] == first.data["rows"]


def identified(client: Client, robot: Robot, runs: list[Measurement]) -> tuple[Record, Record]:
    model = client.identifications.create(robot, runs[:1], validation=runs[1:], effects=EFFECTS).wait()
    asked = {"robot_id": robot, "measurement_ids": runs[:1]}
    batch = client.identifications.create_many([{**asked, "effects": [{"effect": one}]} for one in EFFECTS[1:]])
    assert [one.wait().status for one in batch.identifications] == ["succeeded"] * 2
    assert client.identifications.batch(batch).states["succeeded"] == 2
    assert client.identifications.cancel_batch(batch).states["succeeded"] == 2  # nothing is left to be cancelled
    client.identifications.forget_batch(batch)
    diagnosis = client.diagnoses.create(model, candidates=["joint_spring", "offset"]).wait()
    assert diagnosis.result["candidates"][0]["effect"] == "joint_spring"
    assert client.diagnoses.evidence(diagnosis, 1)["joint"] == "turn"
    better = client.identifications.extend(model, diagnosis.result["recommended"]).wait()
    back = client.identifications.remove(better, ["joint_spring"]).wait()
    assert better.result["residual"]["relative_total"] < 0.5 * back.result["residual"]["relative_total"]
    assert [rung["id"] for rung in client.identifications.lineage(back)] == [model.id, better.id, back.id]
    assert client.identifications.compare_lineages(back, better)["common_ancestor"] == better.id
    assert client.identifications.essential(better)["essential"]
    assert client.identifications.correlation(better)["parameters"]
    assert len(client.identifications.tables(better)[0]["rows"]) == len(better.result["parameters"])
    assert client.identifications.verdict(better)["uses"]
    assert json.loads(client.identifications.export(better))["result"]["parameters"]
    assert client.diagnoses.why_not(diagnosis, "joint_spring", "turn")["code"] == "accepted"
    assert client.diagnoses.detection_limits(diagnosis)
    assert client.next_experiments.create(diagnosis).wait().status == "succeeded"
    rest = [[0.1] * len(robot.joints)]
    assert client.identifications.predict(better, rest, rest, rest)["torque"]
    assert "urdf" in {one["format"] for one in client.identifications.list_exports(better)["items"]}
    header, error = client.identifications.export_with_error(better, "cpp")
    assert b"inverse_dynamics" in header
    assert error is not None
    for archived in (True, False):
        assert client.identifications.label(better, archived=archived)["archived"] == archived
    comparison = client.comparisons.create(better, runs[1]).wait()
    assert client.comparisons.series(comparison, "turn", points=60)["t"]
    assert client.comparisons.residual_map(comparison, "turn", "q_turn", bins=4)["count"]
    assert client.comparisons.spectrum(comparison, "turn")["amplitude"]
    assert client.comparisons.autocorrelation(comparison, "turn")["effective_samples"] > 0
    assert client.validations.create(better, "direct").wait().result["verdict"]
    days = client.series.create(better, [[run] for run in runs], names=["mon", "tue"]).wait()
    assert client.series.figure(days).startswith(b"<svg")
    return better, diagnosis


def campaigned(client: Client, robot: Robot, runs: list[Measurement]) -> None:
    campaign = client.campaigns.create(robot, starts=1, random_trajectories=3, trajectory=QUICK)
    assert client.campaigns.ask(campaign).wait().result["promised"] is None
    model = client.campaigns.tell(campaign, runs[0]).wait()
    assert client.campaigns.get(campaign).identification_id == model.id


def told_by_currents(bench: Bench, robot: Robot) -> None:
    client = bench.client
    without, with_load = (
        client.measurements.upload(robot, written(bench.folder / f"{seed}.csv", loaded=loaded, seed=seed))
        for seed, loaded in enumerate((False, True))
    )
    gains = client.drive_gains.create(robot, [without], [with_load], mass=MASS, centre=CENTRE).wait()
    assert [one["drive_gain"] for one in gains.result["gains"]] == pytest.approx(GAINS, rel=0.05)
    ones = client.robots.create("arm", urdf=URDF, drives={name: {"drive_gain": 1} for name in DRIVES})
    run = client.measurements.upload(ones, bench.folder / "0.csv")
    assert len(client.current_models.create(ones, [run], effects=EFFECTS).wait().result["joints"]) == 2


def reported(bench: Bench, model: Record, diagnosis: Record) -> None:
    report = bench.client.reports.create(model).wait()
    assert report.content().lower().startswith(b"<!doctype html>")
    assert bench.client.reports.content(report) == report.content()
    bundle = b"".join(bench.client.robots.bundle(model["robot_id"]))
    with zipfile.ZipFile(io.BytesIO(bundle)) as unpacked:
        assert unpacked.testzip() is None
        rows = unpacked.read("tables/resources.jsonl").decode()
    assert model.id in rows
    assert diagnosis.id in rows


def everything_is_listed_and_deleted(client: Client) -> None:
    assert {one.state for one in client.jobs.page(limit=500)} == {"succeeded"}
    listed = [(one, collection) for collection in collections(client) for one in collection.all()]
    assert len({one.path for one, _ in listed}) == len(COLLECTIONS)
    # The newest first: nothing that is left rests on it, but for what a simulation has made.
    newest = sorted(listed, key=lambda each: each[0].id.partition("_")[2], reverse=True)
    for one, collection in sorted(newest, key=lambda each: each[1] is not client.simulations):
        assert collection.get(one).id == one.id
        if isinstance(one, Computed):
            assert client.jobs.get(one.job_id)["resource"]["id"] == one.id
            assert [event.data for event in client.jobs.events(one.job_id)][-1] == {"state": "succeeded"}
        collection.delete(one)
    assert all(len(collection.page()) == 0 for collection in collections(client))


def collections(client: Client) -> list[Collection[Any]]:
    return [getattr(client, name) for name in COLLECTIONS]


def stopped(client: Client) -> None:
    robot = client.robots.create("arm", urdf=URDF)
    long = client.designs.create(robot, time_budget=300.0, starts=50, trajectory={**MOTION, "harmonics": 5})
    next(one for one in client.jobs.events(long.job_id) if one.data.get("state") == "running")
    assert client.jobs.cancel(long.job_id)["id"] == long.job_id
    with pytest.raises(JobCancelled):
        long.wait()


def test_a_job_that_cannot_be_done_fails_in_words_and_what_is_needed_stays(live: Client) -> None:
    robot = live.robots.create("arm", urdf=URDF)
    run = live.measurements.get(live.simulations.create(robot, trajectory=MOTION).wait().result["measurement_id"])
    with pytest.raises(JobFailed) as failed:
        live.identifications.create(robot, [run], preprocessing={"position_cutoff": 80.0}).wait()
    assert failed.value.errors[0]["pointer"] == "/preprocessing/position_cutoff"
    for wrong, status in (
        (lambda: live.measurements.delete(run), 409),
        (lambda: live.measurements.get("mea_nothing"), 404),
        (lambda: live.identifications.create(robot, [run], effects=["magic"]), 422),
    ):
        with pytest.raises(ProblemError) as refused:
            wrong()
        assert refused.value.status == status
