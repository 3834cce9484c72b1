"""Drive gains over HTTP: from runs without and with a known load; another load weighed; what does not fit, refused."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest
from fastapi.testclient import TestClient
from support.oracles import fourier_motion, pinocchio_rows
from typer.testing import CliRunner

from dynident.errors import DynidentError
from dynident.progress import ignore_progress
from dynident.robot import robot_from_urdf
from dynident_cli.program_and_exit_codes import app
from dynident_client import Client, Computed, JobFailed, ProblemError, Record
from dynident_service.drive_gains.jobs import find_gains
from dynident_service.jobs.task_input_output import ObjectCache, Task
from dynident_service.storage_and_engine import Services

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ur10e"
URDF = """<robot name="two_links">
 <link name="base"/>
 <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
 <link name="upper"/>
 <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
  <origin xyz="0.5 0 0"/><axis xyz="0 1 0"/></joint>
 <link name="fore"/>
</robot>
"""
ARM = robot_from_urdf("two_links", URDF)
JOINTS = ("shoulder", "elbow")
GAINS = np.array([25.0, 14.0])
STATED = (20.0, 16.0)
OTHER_MASS = 1.2
MASS, CENTRE = 3.0, (0.3, 0.0, 0.05)
# XX XY XZ YY YZ ZZ MX MY MZ M of the two links; of a load of 1 kg at CENTRE.
LINKS = np.array([[0, 0, 0, 0.4, 0, 0, 1.0, 0, 0, 4.0], [0, 0, 0, 0.2, 0, 0, 0.6, 0, 0, 3.0]])
LOAD = np.array([0, 0, 0, CENTRE[0] ** 2 + CENTRE[2] ** 2, 0, 0, *CENTRE, 1.0])
MOTION = fourier_motion(ARM, 15.0, 100.0, 1, base_frequency=0.1, amplitude=1.5)
ROWS = pinocchio_rows(ARM, MOTION.q, MOTION.dq, MOTION.ddq)


def written(path: Path, mass: float, seed: int, signal: str = "current", scale: float = 1.0) -> Path:
    """A recording of the arm with a load, with noise on its currents."""
    standard = LINKS + np.outer([0.0, mass], LOAD)
    torque = ROWS @ standard.ravel() + 2.0 * np.sign(MOTION.dq) + 1.5 * MOTION.dq
    current = scale * (torque / GAINS + np.random.default_rng(seed).normal(0.0, 0.01, torque.shape))
    columns = {"t": MOTION.t}
    for j, name in enumerate(JOINTS):
        columns |= {f"q_{name}": MOTION.q[:, j], f"{signal}_{name}": current[:, j]}
    pacsv.write_csv(pa.table(columns), path)
    return path


@dataclass
class Lab:
    """A robot whose stated gains are wrong, and its runs."""

    client: Client
    folder: Path
    robot: Record
    unloaded: Record
    loaded: Record
    other: Record

    def asked(self, **changed: Any) -> Computed:
        good = {"robot": self.robot, "unloaded": [self.unloaded], "loaded": [self.loaded], "mass": MASS}
        return self.client.drive_gains.create(**{**good, **changed})

    def found(self, services: Services, **changed: Any) -> dict[str, Any]:
        """What the job finds, computed here: a worker takes its time to start."""
        made = self.asked(**changed)
        # A worker may have been fast: then there is nothing to cancel.
        with suppress(ProblemError):
            made.cancel()
        stored = services.resources.get("drive_gains", made.id)
        return dict(
            find_gains(Task(stored, {}, services.resources, services.objects, ObjectCache(), ignore_progress)).result
        )

    def refused(self, **changed: Any) -> tuple[str, str]:
        """Pointer and detail of the refusal of an otherwise good request."""
        with pytest.raises(ProblemError) as caught:
            self.asked(**changed)
        assert caught.value.status == 422
        return caught.value.errors[0]["pointer"], caught.value.errors[0]["detail"]

    def upload(self, mass: float = 0.0, seed: int = 9, payload: Any = None, robot: Any = None, **more: Any) -> Record:
        path = written(self.folder / "again.csv", mass, seed, **more)
        said = {"payload": payload, "accept": ["constant_torque"]}
        return self.client.measurements.upload(robot or self.robot, path, name="again", **said)


@pytest.fixture(scope="module")
def lab(client: TestClient, tmp_path_factory: pytest.TempPathFactory) -> Lab:
    here = Client("http://127.0.0.1", transport=client._transport)
    folder = tmp_path_factory.mktemp("gains")
    drives = {name: {"drive_gain": gain} for name, gain in zip(JOINTS, STATED, strict=True)}
    robot = here.robots.create("two links", urdf=URDF, drives=drives)
    runs = [
        here.measurements.upload(robot, written(folder / f"{name}.csv", mass, seed))
        for seed, (name, mass) in enumerate((("unloaded", 0.0), ("loaded", MASS), ("other", OTHER_MASS)))
    ]
    return Lab(here, folder, robot, *runs)


def test_gains_of_a_known_load_come_with_intervals_and_units(lab: Lab, services: Services) -> None:
    found = lab.found(services, weigh=[lab.other, lab.loaded])
    gains = found["gains"]
    assert [one["joint"] for one in gains] == list(JOINTS)
    assert [one["stated"] for one in gains] == list(STATED)
    assert [one["unit"] for one in gains] == ["N m/A"] * 2
    for one, true, stated in zip(gains, GAINS, STATED, strict=True):
        assert one["interval"][0] < true < one["interval"][1]
        assert one["drive_gain"] == pytest.approx(true, rel=0.03)
        assert one["factor"] == pytest.approx(one["drive_gain"] / stated)
        assert one["interval"][1] - one["drive_gain"] == pytest.approx(1.96 * one["standard_deviation"], rel=1e-3)
        assert one["identifiable"]


def test_another_load_is_weighed_with_the_gains(lab: Lab, services: Services) -> None:
    found = lab.found(services, weigh=[lab.other, lab.loaded])
    other, again = found["loads"]
    assert (other["measurement_id"], other["name"]) == (lab.other.id, "other")
    assert other["interval"][0] < OTHER_MASS < other["interval"][1]
    assert other["identifiable"]
    assert 0 < other["from_gains"] < other["standard_deviation"]
    assert again["mass"] == pytest.approx(MASS, rel=0.02)
    (warning,) = found["warnings"]
    assert warning.startswith("loaded is one of the runs")


@pytest.mark.slow
def test_gains_are_computed_listed_keep_their_runs_and_are_deleted(lab: Lab) -> None:
    made = lab.asked(centre=CENTRE, name="with 3 kg").wait()
    assert len(made.result["gains"]) == 2
    kept = lab.client.drive_gains
    assert made.id in [one.id for one in kept.all(robot_id=lab.robot.id)]
    assert list(kept.all(robot_id="rob_nothing")) == []
    assert kept.get(made)["request"]["centre"] == list(CENTRE)
    assert lab.client.jobs.get(made.job_id)["kind"] == "drive_gains"
    with pytest.raises(ProblemError) as needed:
        lab.client.measurements.delete(lab.loaded)
    assert needed.value.status == 409
    assert made.id in str(needed.value)
    kept.delete(made)
    with pytest.raises(ProblemError) as gone:
        kept.get(made)
    assert gone.value.status == 404


@pytest.mark.slow
def test_a_load_that_does_not_show_fails_as_a_problem(lab: Lab) -> None:
    runs = [lab.upload(0.0, 0), lab.upload(0.0, 0)]
    with pytest.raises(JobFailed) as failed:
        lab.asked(unloaded=runs[:1], loaded=runs[1:]).wait()
    assert failed.value.status == 422
    assert failed.value.errors[0]["pointer"] == "/loaded"


def test_a_load_that_its_measurement_states_needs_no_mass(lab: Lab, services: Services) -> None:
    """Nor does it matter that the two runs have the same name."""
    runs = [lab.upload(0.0, 0), lab.upload(MASS, 1, {"mass": MASS, "centre": list(CENTRE)})]
    found = lab.found(services, unloaded=runs[:1], loaded=runs[1:], mass=None)["gains"]
    stated = lab.found(services, centre=CENTRE)["gains"]
    assert [one["drive_gain"] for one in found] == pytest.approx([one["drive_gain"] for one in stated], rel=1e-9)


@pytest.mark.parametrize(
    ("changed", "pointer", "word"),
    [
        ({"robot": "rob_nothing"}, "/robot_id", "there is no robot"),
        ({"unloaded": ["mea_nothing"]}, "/unloaded/0", "there is no measurement"),
        ({"loaded": ["mea_nothing"]}, "/loaded/0", "there is no measurement"),
        ({"unloaded": []}, "/unloaded", "at least 1"),
        ({"loaded": []}, "/loaded", "at least 1"),
        ({"mass": None}, "/mass", "give mass"),
        ({"mass": 0.0}, "/mass", "mass is 0.0; it must be 1e-06 to"),
        ({"mass": 1e300}, "/mass", "mass is 1e+300; it must be 1e-06 to"),
        ({"mass": "much"}, "/mass", "number"),
        ({"centre": [0.1, 0.2]}, "/centre/2", "required"),
        ({"weigh": ["mea_nothing"]}, "/weigh/0", "there is no measurement"),
        ({"weigh_unloaded": ["mea_nothing"]}, "/weigh_unloaded", "give weigh"),
    ],
)
def test_requests_that_do_not_fit_are_refused_with_their_field(
    lab: Lab, changed: dict[str, Any], pointer: str, word: str
) -> None:
    found = lab.refused(**changed)
    assert found[0] == pointer
    assert word in found[1]


def test_a_run_is_without_the_load_or_with_it(lab: Lab) -> None:
    assert lab.refused(loaded=[lab.loaded, lab.unloaded])[0] == "/loaded/1"
    assert lab.refused(weigh=[lab.unloaded])[0] == "/weigh/0"
    assert lab.refused(weigh=[lab.other], weigh_unloaded=[lab.other])[0] == "/weigh/0"
    assert lab.refused(unloaded=[lab.unloaded, lab.unloaded])[0] == "/unloaded/1"


@pytest.mark.parametrize(
    ("payload", "word"),
    [({"mass": 0}, "above zero"), ({"mass": "two"}, "'two'"), ({"mass": 2.0, "centre": [0.1]}, "x, y and z")],
)
def test_a_measurement_that_states_no_usable_load_is_refused(lab: Lab, payload: dict[str, Any], word: str) -> None:
    pointer, detail = lab.refused(loaded=[lab.upload(payload=payload)], mass=None)
    assert pointer == "/loaded/0"
    assert word in detail


def test_another_robots_runs_and_coupled_motors_are_refused(lab: Lab) -> None:
    drives = {"shoulder": {"drive_gain": 1.0}, "elbow": {"drive_gain": 1.0, "coupling": {"shoulder": 1.0}}}
    coupled = lab.client.robots.create("coupled", urdf=URDF, drives=drives)
    assert lab.refused(robot=coupled)[0] == "/robot_id"
    plain = lab.client.robots.create("no gains", urdf=URDF)
    assert lab.refused(robot=plain)[0] == "/unloaded/0"


def test_torque_columns_of_a_robot_without_gains_give_factors(lab: Lab, services: Services) -> None:
    plain = lab.client.robots.create("no gains", urdf=URDF)
    runs = [lab.upload(mass, seed, robot=plain, signal="tau") for mass, seed in ((0.0, 0), (MASS, 1))]
    found = lab.found(services, robot=plain, unloaded=runs[:1], loaded=runs[1:])["gains"]
    assert [one["unit"] for one in found] == ["-", "-"]
    assert [one["stated"] for one in found] == [1.0, 1.0]
    assert [one["factor"] for one in found] == pytest.approx(list(GAINS), rel=0.03)


@pytest.mark.parametrize(
    ("mass", "scale", "word"),
    [
        (MASS, 0.0, "zero everywhere"),
        (MASS, 1e-300, "no effect"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_runs_that_tell_no_gains_are_named(lab: Lab, services: Services, mass: float, scale: float, word: str) -> None:
    unloaded, loaded = (lab.upload(carried, 0, scale=scale) for carried in (0.0, MASS))
    with pytest.raises(DynidentError, match=word) as refused:
        lab.found(services, unloaded=[unloaded], loaded=[loaded], mass=mass)
    assert refused.value.pointer == "/loaded"


def test_runs_that_are_taken_for_each_other_are_warned_of(lab: Lab, services: Services) -> None:
    found = lab.found(services, unloaded=[lab.loaded], loaded=[lab.unloaded])
    assert all(one["drive_gain"] < 0 for one in found["gains"])
    (warning,) = found["warnings"]
    assert "the gains of shoulder, elbow are negative" in warning
    assert "declared as runs without it" in warning


@pytest.mark.real_data
@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings of real robots are not here (../shared/data is missing)")
def test_gains_of_a_ur10e_are_those_of_the_command_line(live: Client) -> None:
    gains = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
    # Rows, counted from 1, between the standstills at both ends.
    rows = {"pair14_unloaded": (195, 4966), "pair14_loaded": (308, 5071)}
    windows = {}
    for name, (first, last) in rows.items():
        t = pq.read_table(DATA / f"{name}.parquet", columns=["t"])["t"].to_numpy()
        windows[name] = (float(t[first - 1]), float(t[last - 1]))
    urdf = DATA / "robot.urdf"
    said = [f"--windows={name}={start!r}:{end!r}" for name, (start, end) in windows.items()]
    files = [str(DATA / "pair14_unloaded.parquet"), "--loaded", str(DATA / "pair14_loaded.parquet")]
    stated = ["--mass", "2.805", "--drive-gains", ",".join(map(str, gains))]
    pair = DATA / "pair0131_loaded.parquet", DATA / "pair0131_unloaded.parquet"
    files += ["--weigh", str(pair[0]), "--weigh-unloaded", str(pair[1])]
    answer = CliRunner().invoke(app, ["gains", str(urdf), *files, *stated, *said, "--json"], prog_name="dynident")
    assert answer.exit_code == 0, answer.stderr
    told = json.loads(answer.stdout)

    drives = {
        name: {"drive_gain": gain} for name, gain in zip((one["joint"] for one in told["gains"]), gains, strict=True)
    }
    robot = live.robots.create("ur10e", urdf=urdf, drives=drives)
    runs = {
        name: live.measurements.upload(
            robot, DATA / f"{name}.parquet", windows=[windows[name]] if name in windows else []
        )
        for name in (*rows, "pair0131_unloaded", "pair0131_loaded")
    }
    found = (
        live.drive_gains.create(
            robot,
            [runs["pair14_unloaded"]],
            [runs["pair14_loaded"]],
            mass=2.805,
            weigh=[runs["pair0131_loaded"]],
            weigh_unloaded=[runs["pair0131_unloaded"]],
        )
        .wait()
        .result
    )
    assert len(found["gains"]) == len(told["gains"])
    for ours, theirs in zip(found["gains"], told["gains"], strict=True):
        assert ours["drive_gain"] == pytest.approx(theirs["drive_gain"], rel=1e-9)
        assert ours["interval"] == pytest.approx(theirs["interval"], rel=1e-6)
        assert (ours["joint"], ours["identifiable"]) == (theirs["joint"], theirs["identifiable"])
    (load,) = found["loads"]
    assert load["mass"] == pytest.approx(told["loads"][0]["mass"], rel=1e-9)
    assert load["interval"] == pytest.approx(told["loads"][0]["interval"], rel=1e-6)
    assert load["interval"][0] < 2.805 < load["interval"][1]
    assert load["mass"] == pytest.approx(2.80, abs=0.05)
