"""The whole story of a user, through the Python client, against a service that listens."""

from __future__ import annotations

import json
import re
from pathlib import Path

import httpx2
import numpy as np
import pytest

from dynident.robot import library_table
from dynident_client import Client, JobFailed, ProblemError

pytestmark = pytest.mark.slow


def test_a_hidden_effect_is_found_added_and_reported(live: Client, tmp_path: Path) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    trajectory = {"duration": 10.0, "periods": 2, "sampling_rate": 200.0}
    design = live.designs.create(robot, kind="random", trajectory=trajectory).wait()
    assert design.result["n_samples"] > 4000
    table = live.designs.trajectory(design).splitlines()
    assert len(table) == design.result["n_samples"] + 1
    assert len(json.loads(live.designs.trajectory(design, "json"))["q"][0]) == 4
    assert live.designs.trajectory(design, "parquet")[:4] == b"PAR1"

    joint = robot.joints[0]["name"]
    drive = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
    hidden = {"effect": "joint_spring", "joints": [joint], "parameters": {"ks": 12.0, "bs": 1.0}}
    told: list[float] = []
    runs = []
    for seed, motion in ((1, {"design": design}), (2, {"trajectory": {**trajectory, "duration": 8.0}})):
        simulation = live.simulations.create(robot, effects=[*drive, hidden], seed=seed, **motion)
        simulation.wait(lambda fraction, message: told.append(fraction))
        runs.append(live.measurements.get(simulation.result["measurement_id"]))
    assert told
    assert all(check["status"] != "error" for run in runs for check in run.checks)
    assert b"".join(live.measurements.content(runs[0]))[:4] == b"PAR1"

    model = live.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
    comparison = live.comparisons.create(model, runs[1]).wait()
    assert comparison.result["relative"] == pytest.approx(model.result["validation"]["relative"], rel=0.05)
    figures = comparison.result
    # The trial repeats its motion of 8 s; it is another motion than the one that was learnt.
    assert (figures["held_out"], figures["repeated_motion"]) == (True, None)
    assert figures["noise_source"] in ("repeated_periods", "high_frequency")
    assert all(over > 0.9 for over in figures["over_noise"]), {
        k: figures[k]
        for k in ("noise_floor", "noise_source", "over_noise", "rms", "repetition", "notes", "effective_samples")
    }
    assert all(0 < few <= figures["n_samples"] for few in figures["effective_samples"])
    assert [len(one["pose"]) for one in figures["worst"]] == [4] * len(figures["worst"])
    fit = live.comparisons.create(model, runs[0]).wait().result
    assert fit["held_out"] is False
    assert (fit["noise_source"], round(fit["repetition"]["period"], 1)) == ("repeated_periods", 10.0)
    assert fit["lack_of_fit"]["p_value"][0] < 0.01
    assert live.comparisons.spectrum(comparison, joint, "angle")["amplitude"]
    assert live.comparisons.autocorrelation(comparison, joint)["effective_samples"] < figures["n_samples"]
    series = live.comparisons.series(comparison, joint, start=3.0, end=6.0, points=60)
    assert 20 < len(series["t"]) <= series["n_samples"]
    assert 3.0 <= series["t"][0] < series["t"][-1] <= 6.0
    seen = live.comparisons.residual_map(comparison, joint, f"q_{joint}", bins=8)
    assert sum(row[0] for row in seen["count"]) == comparison.result["n_samples"]

    diagnosis = live.diagnoses.create(model).wait()
    assert diagnosis.result["verdict"] == "missing_effect"
    first = diagnosis.result["candidates"][0]
    assert (first["effect"], first["joints"]) == ("joint_spring", [joint])

    assert live.diagnoses.why_not(diagnosis, first["effect"], joint)["code"] == "accepted"
    assert {row["effect"] for row in live.diagnoses.detection_limits(diagnosis)} > {first["effect"]}
    predicted = live.identifications.predict(model, np.zeros((1, 4)), np.zeros((1, 4)), np.zeros((1, 4)), interval=0.9)
    assert predicted["lower"] is not None
    assert (np.array(predicted["lower"]) < np.array(predicted["torque"])).all()
    drawn = live.diagnoses.evidence(diagnosis, 1)
    assert (drawn["effect"], drawn["joint"], drawn["variable"]) == ("joint_spring", joint, "position")
    assert drawn["explained"] > 0.3
    assert len(drawn["x"]) == len(drawn["residual"]) == len(drawn["fitted"]) == len(drawn["count"])
    for asked, status in (({"rank": 99}, 404), ({"rank": 1, "joint": "nose"}, 422)):
        with pytest.raises(ProblemError) as missing:
            live.diagnoses.evidence(diagnosis, **asked)
        assert missing.value.status == status

    better = live.identifications.extend(model, diagnosis.result["recommended"]).wait()
    before, after = (one.result["validation"]["relative"][0] for one in (model, better))
    assert after < 0.7 * before
    assert [rung["id"] for rung in live.identifications.lineage(better)] == [model.id, better.id]
    assert better["parent_id"] == model.id
    assert not any("do not confirm" in warning for warning in better.result["warnings"])

    back = live.identifications.remove(better, [{"effect": "joint_spring"}]).wait()
    assert back["parent_id"] == better.id
    assert [one["effect"] for one in back["removed"]] == ["joint_spring"]
    assert back.result["validation"]["relative"] == pytest.approx(model.result["validation"]["relative"], rel=1e-6)
    other = live.identifications.extend(model, [{"effect": "joint_spring", "joints": [robot.joints[1]["name"]]}]).wait()
    assert "do not confirm" in other.result["warnings"][0]
    compared = live.identifications.compare_lineages(back, other)
    assert [rung["id"] for rung in compared["items"]] == [model.id, better.id, back.id]
    assert [rung["id"] for rung in compared["against"]] == [model.id, other.id]
    assert (compared["common_ancestor"], compared["same_data"]) == (model.id, True)
    first, second, third = compared["differences"]
    assert first["validation_total"] == 0.0
    assert second["validation"][0] < 0
    assert (third["against_id"], third["validation"]) == (None, None)
    for effects, pointer in (([{"effect": "stribeck"}], "/effects/0"), ([{"effect": "magic"}], "/effects/0")):
        with pytest.raises(ProblemError) as refused:
            live.identifications.remove(better, effects)
        assert (refused.value.status, refused.value.errors[0]["pointer"]) == (422, pointer)
    with pytest.raises(ProblemError) as unknown:
        live.identifications.compare_lineages(back, "ide_nothing")
    assert unknown.value.status == 422
    (found,) = [p for p in better.result["parameters"] if p["effect"] == "joint_spring" and p["name"].startswith("ks")]
    assert found["value"] == pytest.approx(12.0, abs=4 * found["standard_deviation"])

    cross = live.validations.create(better, "cross").wait()
    assert cross.result["measurements"][0]["errors"]["relative"] == pytest.approx(
        better.result["validation"]["relative"], rel=0.05
    )
    direct = live.validations.create(better, "direct").wait()
    assert direct.result["measurements"][0]["measurement_id"] == runs[0].id
    physical = live.validations.create(better, "inertia_matrix").wait()
    assert isinstance(physical.result["inertia_matrix_positive_definite"], bool)

    report = live.reports.create(better, diagnosis=diagnosis).wait()
    page = report.save(tmp_path / "report.html").read_text(encoding="utf-8")
    assert "joint_spring" in page or "spring" in page
    # Whoever is sent the report finds the model.
    (back,) = re.findall(rf'<a href="(http[^"]+identification={better.id})">', page)
    assert httpx2.get(back).text.startswith("<!doctype html>")
    assert json.loads(live.reports.content(live.reports.create(better, format="json").wait()))["measurements"]
    assert json.loads(live.identifications.export(better))["result"]["parameters"]

    with pytest.raises(ProblemError) as needed:
        live.measurements.delete(runs[0])
    assert needed.value.status == 409
    assert model.id in {one["id"] for one in needed.value.problem["dependents"]}


def test_a_report_is_printed_and_what_cannot_be_asked_for_is_said_with_its_place(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    simulation = live.simulations.create(robot, trajectory={"duration": 8.0, "sampling_rate": 100.0}).wait()
    run = live.measurements.get(simulation.result["measurement_id"])
    model = live.identifications.create(robot, [run]).wait()
    printed = live.reports.create(model, format="pdf").wait()
    assert printed.result["media_type"] == "application/pdf"
    assert live.reports.content(printed).startswith(b"%PDF")
    for choice, pointer in (
        ({"estimator": "magic"}, "/estimator"),
        ({"effects": ["magic"]}, "/effects/0"),
        ({"effects": [{"effect": "coulomb", "joints": ["nose"]}]}, "/effects/0"),
        ({"validation": [run, run]}, "/validation_ids/1"),
        ({"validation": ["mea_nothing"]}, "/validation_ids/0"),
        ({"preprocessing": {"decimation": "often"}}, "/preprocessing/decimation"),
    ):
        with pytest.raises(ProblemError) as caught:
            live.identifications.create(robot, [run], **choice)
        assert caught.value.status == 422
        assert pointer in [field["pointer"] for field in caught.value.errors]
    with pytest.raises(JobFailed) as failed:
        live.identifications.create(robot, [run], preprocessing={"position_cutoff": 80.0}).wait()
    assert failed.value.errors[0]["pointer"] == "/preprocessing/position_cutoff"
    other = live.identifications.create(robot, [run]).wait()
    diagnosis = live.diagnoses.create(other, candidates=["offset"]).wait()
    with pytest.raises(ProblemError, match="neither"):
        live.reports.create(model, diagnosis=diagnosis)
