"""A number that nobody means is refused in words, or answered within seconds; never a traceback."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.implausible_numbers import absurd_requests
from support.one_joint_robots import one_joint_recordings, one_joint_robot, one_joint_urdf

import dynident as dy
from dynident.diagnosis import DiagnosisChoices
from dynident.errors import DynidentError
from dynident.excitation import design_experiment
from dynident.identification.identification_choices import EssentialChoices, KnownLoad
from dynident.identification.identified_models.correlated_and_essential_parameters import essential_parameters
from dynident.identification.loads.payloads_of_recordings import parse_payload
from dynident.identification.methods.base_classes import ESTIMATORS
from dynident.motion.collision.surroundings import Box, ToolRange, Wall
from dynident.progress import ignore_progress
from dynident.recordings.preprocessing import preprocessing_from_request
from dynident.recordings.recording_metadata import Filters
from dynident.robot import robot_from_urdf
from dynident.simulation import ActingEffect, Simulated, Warming, build_simulation_request, simulate
from dynident.validation.validation_request import TRIALS, ValidationData, build_trial
from dynident_service.designs.adapters import design_to_reference

NAME = "pendulum"
SECONDS = 20
SHORT = dy.TrajectoryRequest(duration=2.0, sampling_rate=50.0, harmonics=2, intervals=4, points=3)
AROUND = dy.Surroundings(
    walls=(Wall("wall", (9.0, 0.0, 0.0), (-1.0, 0.0, 0.0)),),
    boxes=(Box("box", (9.0, 0.0, 0.0), (0.1, 0.1, 0.1)),),
    tool_range=ToolRange((-9.0, None, None), (9.0, None, None)),
    link_radius=0.05,
)
DESIGN = dy.DesignRequest(
    trajectory=SHORT,
    starts=1,
    random_trajectories=1,
    noise={"axis": 0.1},
    limits={"axis": dy.Limits(velocity=1.5)},
    home=(0.0,),
    criterion=dy.CriterionChoice("weighted", a_priori={"Fc1": 1.0}),
)


@contextmanager
def within_seconds() -> Iterator[None]:
    def late(number: int, frame: object) -> None:
        raise AssertionError(f"not within {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@cache
def model() -> dy.Model:
    runs = one_joint_recordings(NAME)
    return dy.identify(one_joint_robot(NAME), runs[:1], validation=runs[1:2])


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    columns = one_joint_recordings(NAME)[0]._read_samples().columns
    path = tmp_path_factory.mktemp("absurd") / "run.csv"
    names = [name for name in columns if name != "segment"]
    np.savetxt(
        path, np.column_stack([columns[name] for name in names]), "%.9g", ",", header=",".join(names), comments=""
    )
    return path


def _designed(request: Any) -> object:
    return dy.design(one_joint_robot(NAME), request)


def _identified(choices: Any) -> object:
    return dy.identify(one_joint_robot(NAME), one_joint_recordings(NAME)[:1], choices=choices)


def _simulated(stated: Any) -> object:
    robot = one_joint_robot(NAME)
    design = design_experiment(robot, replace(DESIGN, kind="random"))
    return simulate(robot, build_simulation_request(stated, robot, design_to_reference(design), 100.0))


def _filtered(choices: Any) -> object:
    run = one_joint_recordings(NAME)[0].recording
    return preprocessing_from_request({one.name: getattr(choices, one.name) for one in fields(choices)}, [run])


SIMULATED = Simulated(
    runs=1,
    parameters={"M1": 4.0},
    effects=(ActingEffect("stribeck", ("axis",), {"Fst": 1.0}, {"vs": 0.1}),),
    warming=Warming(),
)
CASES: dict[str, tuple[Callable[[], Any], Callable[[Any], object]]] = {
    "design": (lambda: DESIGN, _designed),
    "design around": (lambda: replace(DESIGN, surroundings=AROUND), _designed),
    "b_spline": (lambda: replace(DESIGN, trajectory=replace(SHORT, family="b_spline")), _designed),
    "points": (lambda: replace(DESIGN, trajectory=replace(SHORT, family="point_to_point")), _designed),
    "strokes": (lambda: replace(DESIGN, kind="constant_velocity", trajectory=replace(SHORT, speeds=(0.5,))), _designed),
    "reversals": (lambda: replace(DESIGN, kind="reversals", trajectory=replace(SHORT, amplitudes=(0.1,))), _designed),
    "sweep": (lambda: replace(DESIGN, kind="slow_sweep"), _designed),
    "set": (lambda: replace(DESIGN, kind="sequential"), _designed),
    "energy": (lambda: dy.IdentificationChoices(model="energy"), _identified),
    "filtered": (lambda: dy.IdentificationChoices(model="filtered"), _identified),
    "prior": (lambda: dy.IdentificationChoices(prior="description"), _identified),
    "filters": (Filters, _filtered),
    "simulation": (lambda: SIMULATED, _simulated),
    "diagnosis": (DiagnosisChoices, lambda choices: dy.diagnose(model(), max_effects=choices.max_effects)),
    "essential": (
        EssentialChoices,
        lambda choices: essential_parameters(model().identification, choices.ratio),
    ),
    "load": (KnownLoad, lambda load: parse_payload("run", load.override_payload({"mass": 1.0}))),
    "limits": (
        lambda: dy.Limits(position=(-1.0, 1.0)),
        lambda limits: dy.design(_read(limits={"axis": limits}), DESIGN),
    ),
    "drive": (
        lambda: dy.Drive(coupling={"axis": 0.0}),
        lambda drive: _read(drives={"axis": drive}),
    ),
}


def _estimated(name: str) -> tuple[Callable[[], Any], Callable[[Any], object]]:
    return ESTIMATORS.by_name[name], lambda found: _identified(dy.IdentificationChoices(estimator=found))


def _with_shape(pair: Any) -> object:
    stribeck = dy.EffectChoice("stribeck", ("axis",), (("vs", pair.at),))
    return _identified(dy.IdentificationChoices(effects=(*dy.IdentificationChoices().effects, stribeck)))


@dataclass(frozen=True)
class _Shape:
    at: float = 0.1


CASES |= {
    "shape constant": (_Shape, _with_shape),
    "separation": (
        _Shape,
        lambda one: _designed(
            replace(
                DESIGN,
                criterion=dy.CriterionChoice(
                    "separation", effects=(dy.EffectChoice("stribeck", ("axis",), (("vs", one.at),)),)
                ),
            )
        ),
    ),
}
CASES |= {f"estimator {name}": _estimated(name) for name in ESTIMATORS.names}


def _validated(kind: str) -> tuple[Callable[[], Any], Callable[[Any], object]]:
    short = {"longest": 2.0} if kind in ("simulation", "filters") else {}
    few = {"cutoffs": (5.0,)} if kind == "filters" else {}

    def make(trial: Any) -> object:
        stated = build_trial(kind, {one.name: getattr(trial, one.name) for one in fields(trial)})
        fit, held_out, _ = one_joint_recordings(NAME).recordings
        return stated.judge(ValidationData(model().identification, [held_out], [fit], ignore_progress))

    return lambda: replace(TRIALS.by_name[kind](), **short, **few), make


CASES |= {f"trial {kind}": _validated(kind) for kind in TRIALS.names if kind != "methods"}


def _read(**said: Any) -> dy.Robot:
    return robot_from_urdf("one", one_joint_urdf(NAME), **said)


def tried(make: Callable[[Any], object], request: Callable[[], Any]) -> list[str]:
    """What ended otherwise than with an answer or a refusal in words."""
    wrong = []
    for path, number, build in absurd_requests(request()):
        try:
            with within_seconds():
                make(build())
        except DynidentError:
            continue
        except Exception as error:
            wrong.append(f"{path} = {number}: {type(error).__name__}: {str(error)[:120]}")
    return wrong


@pytest.mark.sweep
@pytest.mark.parametrize("case", CASES)
def test_an_absurd_number_is_refused_or_answered(case: str) -> None:
    request, make = CASES[case]
    assert tried(make, request) == []


def test_absurd_numbers_said_of_a_file_are_refused_or_answered(table: Path) -> None:
    said = dy.RecordingMetadata(
        windows=((0.0, 19.0),),
        exclude=((3.0, 4.0),),
        scale={"tau1": 1.0},
        signs={"tau1": 1.0},
        permutation={"tau": (1,)},
        payload={"mass": 1.0},
        role="payload",
    )
    robot = one_joint_robot(NAME)
    assert tried(lambda one: dy.read_recordings(table, robot=robot, metadata=one), lambda: said) == []
    run = dy.read_recordings(table, robot=robot)[0]
    change = dy.Revision(windows=((0.0, 19.0),), scale={"tau1": 1.0}, torque_delay=0.0)
    assert tried(lambda one: dy.revise(run, one), lambda: change) == []
