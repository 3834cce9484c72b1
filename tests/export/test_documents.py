"""JSON holds all that predicts; every format has a name and a type."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.exported_programs import MODELS, NAMES, run_signals
from support.models_with_chosen_parameters import (
    PLAIN,
    drives,
    from_standard,
    made_up,
    measured,
    path,
    predicted,
    signals,
)
from support.oracles import arm

from dynident.errors import DynidentError
from dynident.export import export_model, model_from_json, model_to_document, to_json
from dynident.regressors.observation_matrix import FurtherSignals
from dynident.robot.robot_model import INERTIAL_NAMES


@pytest.mark.parametrize("name", NAMES)
def test_json_read_back_predicts_the_same_torque(name: str) -> None:
    model = MODELS[name]()
    motion = path(model.model.robot)
    read = model_from_json(to_json(model))
    further = FurtherSignals(runs=run_signals(model), period=0.01, **signals(model.model.robot, len(motion.q)))
    found = read.torque(motion.q, motion.dq, motion.ddq, further=further)
    np.testing.assert_allclose(found, predicted(model, motion, run_signals(model)), rtol=1e-12, atol=1e-12)


def test_a_locked_joint_and_another_gravity_survive_json() -> None:
    from support.exported_robots import OWN

    from dynident.robot import robot_from_urdf

    robot = robot_from_urdf("mine", OWN, locked_joints={"grip": 0.02}, gravity=[0.0, 3.0, -9.0])
    model, motion = from_standard(robot, drives(robot)), path(robot)
    found = model_from_json(to_json(model)).torque(motion.q, motion.dq, motion.ddq)
    np.testing.assert_allclose(found, predicted(model, motion), rtol=1e-12, atol=1e-12)


def test_json_has_a_feasible_full_set_where_there_is_one() -> None:
    robot = arm("ur10")
    model = from_standard(robot, drives(robot))
    document = json.loads(to_json(model))
    standard = document["standard_parameters"]
    full = [standard[column["joint"]][column["parameter"]] for column in document["columns"]]
    base = [sum(weight * full[int(k)] for k, weight in one["grouping"].items()) for one in document["base_parameters"]]
    np.testing.assert_allclose(base, model.values, rtol=1e-9, atol=1e-12)
    assert set(standard[robot.joint_names[0]]) == {*INERTIAL_NAMES, "Ia", "Fc", "Fv"}
    assert model_to_document(made_up(robot, PLAIN))["standard_parameters"] is None


def test_names_and_media_types_of_files() -> None:
    model = measured()
    found = {format: export_model(model, format) for format in ("json", "urdf", "mjcf", "c", "casadi")}
    assert {format: (file.name, file.media_type) for format, file in found.items()} == {
        "json": ("scara.json", "application/json"),
        "urdf": ("scara.urdf", "application/xml"),
        "mjcf": ("scara.xml", "application/xml"),
        "c": ("dynident_scara.c", "text/x-c"),
        "casadi": ("scara.casadi", "application/octet-stream"),
    }
    assert not any(file.notes for format, file in found.items() if format in ("json", "c", "casadi"))


def test_an_unknown_format_is_refused_with_those_there_are() -> None:
    with pytest.raises(DynidentError, match=r"json, urdf, sdf, .*casadi"):
        export_model(measured(), "fortran")


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"format": "dynident model 1"}', '{"format": "dynident model 0"}', '{"model": 3}'],
)
def test_other_json_is_refused(text: str) -> None:
    with pytest.raises(DynidentError):
        model_from_json(text)


def test_a_damaged_document_is_refused_whatever_is_damaged() -> None:
    whole = json.loads(to_json(measured()))
    for key in ("format", "robot", "effects", "columns", "base_parameters", "reference"):
        for damage in ({}, [], -3, None, "text", [{}]):
            with pytest.raises(DynidentError):
                model_from_json(json.dumps(whole | {key: damage}))
