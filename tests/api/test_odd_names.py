"""Names with commas, quotes, line breaks and halves of surrogate pairs leave by every writer, and tables hold them."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from support.oracles import fourier_motion, pinocchio_torque, record

import dynident as dy
from dynident.api.recording_collection import CheckedRecording
from dynident.diagnosis.comparison.comparison_files import StoredComparison, write_comparison
from dynident.export import ExportFormat, export_model
from dynident.export.export_request import LOAD_FORMATS
from dynident.recordings import Recording
from dynident.robot.modified_dh import robot_from_modified_dh
from dynident.text_encoding import escape_surrogates
from dynident_service.designs.adapters import trajectory_as_csv, write_trajectory
from dynident_service.identifications.adapters import build_file_response

NAMES = st.text(st.characters(exclude_categories=()), min_size=1, max_size=12).filter(str.strip)
ODD = ('a,b;"c"\tb', "line\nbreak\ré\u2028ß", "\ud800", "'=1+1", "0\x1f")
NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
QUICK = dy.DesignRequest(
    kind="random", trajectory=dy.TrajectoryRequest(duration=2.0, sampling_rate=25.0, harmonics=2), random_trajectories=1
)


def odd(test):
    for name in ODD:
        test = example(name)(test)
    check = settings(max_examples=3, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    return check(given(NAMES)(test))


@cache
def plain() -> tuple[dy.Robot, tuple[Recording, ...]]:
    """A pendulum of a table, and three runs."""
    mass = {"mass": 4.0, "center_of_mass": [0.2, 0.01, 0.0], "inertia": [0.05, 0.0, 0.0, 0.06, 0.0, 0.04]}
    joint = {"name": "axis", "limits": {"position": [-2.5, 2.5], "velocity": 2.0}, "mass_properties": mass}
    robot = robot_from_modified_dh("pendulum", {"gravity": [0, -9.81, 0], "joints": [joint]})
    runs = []
    for seed in range(3):
        motion = fourier_motion(robot, 10.0, 100.0, seed)
        tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 1.5 * np.sign(motion.dq) + 0.8 * motion.dq
        runs.append(record(robot, motion, tau + np.random.default_rng(seed).normal(0.0, 0.05, tau.shape)))
    return robot, tuple(runs)


def robot_called(name: str) -> dy.Robot:
    robot, _ = plain()
    return replace(robot, name=name, joints=(replace(robot.joints[0], name=name),))


@cache
def model_called(name: str) -> dy.Model:
    robot = robot_called(name)
    runs = tuple(
        CheckedRecording(replace(one, name=f"{name} {k}", joint_names=(name,)), (), robot)
        for k, one in enumerate(plain()[1])
    )
    return dy.identify(robot, dy.Recordings(runs[:1]), validation=dy.Recordings(runs[1:]))


def header_of(content: bytes) -> list[str]:
    rows = list(csv.reader(io.StringIO(content.decode("utf-8"), newline="")))
    assert len(rows) > 10
    assert {len(row) for row in rows} == {len(rows[0])}
    return rows[0]


@odd
def test_a_trajectory_is_written_with_the_names_that_the_joints_have(tmp_path: Path, name: str) -> None:
    design = dy.design(robot_called(name), QUICK)
    wanted = ["t", f"q_{escape_surrogates(name)}", f"dq_{escape_surrogates(name)}", f"ddq_{escape_surrogates(name)}"]
    design.save(tmp_path / "motion.csv")
    design.save(tmp_path / "motion.yaml")
    design.save(tmp_path / "motion.parquet")
    assert header_of((tmp_path / "motion.csv").read_bytes()) == wanted
    assert pq.read_table(tmp_path / "motion.parquet").column_names == wanted
    stored = write_trajectory(design.design, tmp_path / "stored.parquet")
    assert header_of(b"".join(trajectory_as_csv(stored))) == wanted
    assert design.plot().svg
    assert design.to_frame() is not None


@odd
def test_every_table_of_a_model_holds_the_names(tmp_path: Path, name: str) -> None:
    model = model_called(name)
    compared = dy.compare(model, model.validation[:1])[0]
    compared.save(tmp_path / "comparison.csv")
    assert f"phase_{escape_surrogates(name)}" in header_of((tmp_path / "comparison.csv").read_bytes())
    stored = StoredComparison(write_comparison(compared.comparison, tmp_path / "comparison.parquet"))
    assert stored.joint_names == [escape_surrogates(name)]
    followed = dy.series(model, {f"{name} {k}": model.validation[k : k + 1] for k in range(2)})
    followed.save(tmp_path / "courses.csv")
    assert escape_surrogates(name) in {
        row["joint"] for row in csv.DictReader((tmp_path / "courses.csv").open(newline="", encoding="utf-8"))
    }
    for shown in (model.parameters, compared, model.errors, followed):
        assert shown._repr_html_()
        assert shown.to_frame() is not None


@odd
def test_every_format_writes_any_name(tmp_path: Path, name: str) -> None:
    model = model_called(name)
    for format in set(get_args(ExportFormat)) - LOAD_FORMATS:
        if format in ("urdf", "mjcf") and NOT_XML.search(escape_surrogates(name)):
            with pytest.raises(dy.DynidentError, match="XML cannot contain"):
                export_model(model.identification, format, nearest=True)
            continue
        file = export_model(model.identification, format, nearest=True)
        assert build_file_response(file).body
        if format in ("urdf", "mjcf"):
            assert ElementTree.fromstring(file.content).tag in ("robot", "mujoco")
        elif format == "json":
            assert json.loads(file.content)
    page = dy.report(model, validations=dy.validate(model), title=name)
    page.save(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8")
    model.plot().save(tmp_path / "model.svg")
    ElementTree.parse(tmp_path / "model.svg")


@pytest.mark.sweep
@pytest.mark.parametrize("name", ODD)
def test_a_report_with_any_name_is_printed(tmp_path: Path, name: str) -> None:
    model = model_called(name)
    dy.report(model, diagnosis=dy.diagnose(model), title=name).save(tmp_path / "report.pdf")
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
