"""A joint without torque, counts of encoders and registers over HTTP, through all that is done with a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from support.drawn_recordings import FloatArray, log

from dynident.export import model_from_json
from dynident.robot.urdf_writer import urdf_from_robot
from dynident_client import Client, ProblemError

pytestmark = pytest.mark.slow

SILENT = 4


def silenced(tau: FloatArray) -> FloatArray:
    changed = tau.copy()
    changed[:, SILENT] = np.nan
    return changed


def test_a_model_of_joints_without_torque_goes_the_whole_way(live: Client, tmp_path: Path) -> None:
    given = [log("ur10", seed) for seed in (3, 13)]
    robot = live.robots.create("arm", urdf=urdf_from_robot(given[0].robot))
    runs = []
    for number, one in enumerate(given):
        path = tmp_path / f"run{number}.csv"
        counts = one.q * 131072 / (2.0 * np.pi)
        pacsv.write_csv(pa.table(one.columns(q=np.rint(counts), tau=silenced(one.tau))), path)
        runs.append(live.measurements.upload(robot, path, units={"q": "counts:131072"}))
    silent = given[0].robot.joint_names[SILENT]
    told = {check["name"]: check for check in runs[0]["checks"]}
    assert silent in told["joint_torque"]["detail"]
    with pytest.raises(ProblemError, match="encoder counts") as refused:
        live.measurements.upload(robot, tmp_path / "run0.csv")
    assert refused.value.status == 422
    model = live.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
    assert model.result["validation"]["relative_total"] < 0.05
    assert any(silent in warning for warning in model.result["warnings"])
    with pytest.raises(ProblemError):
        live.identifications.create(robot, runs[:1], model="power").wait()
    assert live.identifications.verdict(model)
    assert live.identifications.essential(model)
    diagnosis = live.diagnoses.create(model).wait()
    assert not [one for one in diagnosis.result["recommended"] if one["joints"] == [silent]]
    better = live.identifications.extend(model, [{"effect": "offset"}]).wait()
    # It has no equation of that joint: that is not a torque of zero.
    state = [[0.1] * len(given[0].robot.joint_names)]
    predicted = live.identifications.predict(better, state, state, state, interval=0.95)
    for rows in (predicted["torque"], predicted["lower"], predicted["model_upper"]):
        assert rows is not None
        assert [joint for joint, value in enumerate(rows[0]) if value is None] == [SILENT]
    comparison = live.comparisons.create(better, runs[1]).wait()
    assert comparison.result["over_noise"][SILENT] in (None, 0.0)
    assert live.comparisons.series(comparison, silent)["t"]
    assert live.comparisons.spectrum(comparison, silent, "angle") is not None
    for kind in ("direct", "cross", "simulation", "bootstrap", "inertia_matrix"):
        options = {"longest": 3.0} if kind == "simulation" else {}
        assert live.validations.create(better, kind, **options).wait().result["verdict"]
    for ending in ("urdf", "mjcf", "c", "casadi"):
        assert live.identifications.export(better, ending, nearest=True)
    document = live.identifications.export(better, "json")
    assert model_from_json(document.decode() if isinstance(document, bytes) else document) is not None
    for ending in ("html", "json"):
        report = live.reports.create(better, diagnosis=diagnosis, format=ending)
        assert silent.encode() in bytes(live.reports.content(report.wait()))
