"""Typical slips get a sentence that names the argument and what to give instead."""

from __future__ import annotations

import inspect
import random
import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dynident as dy
from dynident.api.argument_checks import EXPECTED
from dynident.effects import Column, Effect, EffectChoice, ParameterSpec, Signals
from dynident.errors import ELSEWHERE, KnownNames
from dynident.excitation import CriterionChoice, TrajectoryRequest
from dynident.recordings import Recording
from dynident.schema.fields import Request

Q = np.zeros(4)


class NoEffect:
    """A class that is no effect."""

    id = "mine"


class Taken(Effect):
    """An effect whose parameter has the name of Coulomb friction's."""

    id = "taken"
    title = "Taken"
    formula = "F"
    parameters = (ParameterSpec("Fc", "N m", "the sign of the velocity"),)
    signature = "as dry friction"
    sources = ("this test",)

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        return [self._column(signals, self.parameters[0], j, signals.dq[j] ** 3) for j in joints]


class WithNumPy(Taken):
    """An effect whose columns are arrays."""

    id = "with_numpy"
    parameters = (ParameterSpec("Fnp", "N m", "the sign of the velocity"),)

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        return [np.zeros(3) for _ in joints]  # type: ignore[misc]


Desk = dict[str, Any]
SLIPS: dict[str, tuple[Callable[[Desk], object], str]] = {
    "a tuple for windows": (lambda d: d["read"](windows=(1, 5)), r"windows is \(1, 5\); give pairs"),
    "a window of metadata": (lambda d: dy.RecordingMetadata(windows=(1, 5)), r"windows\[0\] is 1; give 2 values"),
    "a number as a name": (lambda d: dy.IdentificationChoices(known={1: 2.0}), "a key of known is 1; give a text"),
    "truth for a number": (lambda d: d["model"].wald_test({"Fc1": True}), "give values by the names"),
    "a number of a joint": (lambda d: dy.diagnose(d["model"]).why_not("backlash", 2), "there is no joint '2'"),
    "a parameter that equals itself": (lambda d: d["model"].wald_test({"Fc1": "Fc1"}), "give values by the names"),
    "one condition twice": (lambda d: d["model"].wald_test({"Fc1": "Fv1", "Fv1": "Fc1"}), "says one thing twice"),
    "an unknown parameter to equal": (lambda d: d["model"].wald_test({"Fc1": "Fc9"}), "there is no parameter 'Fc9'"),
    "no number to test": (lambda d: d["model"].wald_test({"Fc1": float("nan")}), "give values by the names"),
    "a window backwards": (lambda d: d["read"](windows=[(5, 1)]), "end must be later"),
    "a list for a model": (lambda d: dy.diagnose([d["model"]]), "model is .*; give one model"),
    "two models at once": (lambda d: dy.compare([d["model"]] * 2, d["runs"]), "give one model"),
    "two models to compare": (lambda d: dy.compare(d["model"], d["model"]), r"dy\.Ladder\(\(a, b\)\)"),
    "a path for a model": (lambda d: dy.validate("model.npz"), "give one model.*load_model"),
    "a path for a robot": (lambda d: dy.identify("arm.urdf", d["runs"]), "robot is 'arm.urdf'; read the robot first"),
    "a path for recordings": (lambda d: dy.identify(d["robot"], "run1.csv"), "not a recording; read files and data"),
    "robot and recordings exchanged": (lambda d: dy.identify(d["runs"], d["robot"]), "robot is .*; read the robot"),
    "a number for effects": (lambda d: dy.identify(d["robot"], d["runs"], effects=3), "effects is 3; give texts"),
    "no candidates": (lambda d: dy.diagnose(d["model"], candidates=[]), "candidates has 0 items; .*at least 1"),
    "no candidates of changes": (
        lambda d: dy.changes(d["model"], before=d["runs"][:1], after=d["runs"][1:], candidates=[]),
        "candidates has 0 items; .*at least 1",
    ),
    "a misspelt candidate of changes": (
        lambda d: dy.changes(d["model"], before=d["runs"][:1], after=d["runs"][1:], candidates="stribek"),
        "'stribek'; did you mean 'stribeck'",
    ),
    "a class for an effect": (lambda d: dy.identify(d["robot"], d["runs"], effects=[NoEffect]), "give texts such as"),
    "a dictionary of effects": (lambda d: dy.identify(d["robot"], d["runs"], effects={"stribeck": 1}), "give texts"),
    "a misspelt effect": (lambda d: d["model"].extend("stribek"), "'stribek'; did you mean 'stribeck'"),
    "a misspelt joint": (lambda d: dy.diagnose(d["model"]).why_not("stribeck@elbo"), "mean 'elbow'"),
    "a parameter that is taken": (lambda d: dy.register(Taken), "Fc is a parameter of another effect"),
    "an effect in NumPy": (lambda d: dy.register(WithNumPy), "functions of CasADi"),
    "a misspelt argument": (
        lambda d: dy.identify(d["robot"], d["runs"], validate=d["runs"]),  # type: ignore[call-arg]
        "did you mean 'validation'",
    ),
    "a misspelt filter": (lambda d: dy.Filters(cutoff=5), "no argument 'cutoff'.*position_cutoff"),  # type: ignore[call-arg]
    "a frame for recordings": (lambda d: dy.identify(d["robot"], d["runs"].to_frame()), "Frame.* is not a rec"),
    "a text for an effect of one's own": (lambda d: dy.register("stribeck"), "no effect; derive a class"),
    "a class that is no effect": (lambda d: dy.register(NoEffect), "no effect; derive a class"),
    "a dictionary for choices": (lambda d: dy.identify(d["robot"], d["runs"], choices={}), "IdentificationChoices"),
    "a number for filters": (lambda d: dy.identify(d["robot"], d["runs"], filters=20.0), r"give dy\.Filters"),
    "a filter with its unit": (lambda d: dy.Filters(torque_cutoff="20 Hz"), "torque_cutoff is '20 Hz'; give a number"),
    "degrees for radians": (lambda d: d["model"].predict([90, 45, 0, 10], Q, Q), "looks like degrees"),
    "joints that are missing": (lambda d: d["model"].predict(Q[:3], Q, Q), r"shape \(3,\), but the robot has 4 joints"),
    "a transposed motion": (lambda d: d["model"].gravity(np.zeros((4, 100))), r"\(m, 4\) for m samples"),
    "a text for a state": (lambda d: d["model"].gravity("home"), "no array of numbers"),
    "shapes that differ": (lambda d: d["model"].predict(Q, Q, np.zeros((2, 4))), "arrays of the same shape"),
    "a percentage": (lambda d: d["model"].predict(Q, Q, Q, interval=95), r"interval is 95; .* 0\.95 for 95 %"),
    "alpha for the level": (lambda d: d["model"].conf_int(0.05), "alpha"),
    "recordings to predict": (lambda d: d["model"].predict(d["runs"]), r"dy\.compare\(model, recordings\)"),
    "a frame to predict": (lambda d: d["model"].predict(d["runs"].to_frame()), r"dy\.read_recordings\(frame"),
    "a value to fix": (
        lambda d: dy.identify(d["robot"], d["runs"], fixed={"Ia3": 0.2}),  # type: ignore[call-arg]
        r"choices=dy\.IdentificationChoices\(known=",
    ),
    "axes to draw in": (lambda d: d["model"].plot(ax=None), r"plot\(\)\.draw\(axes\)"),
    "a format of a table": (lambda d: d["model"].parameters.to_frame(librari="pandas"), "did you mean .library"),
    "no states": (lambda d: d["model"].predict(*np.zeros((3, 0, 4))), "q is empty; give one state or more"),
    "no postures": (lambda d: d["model"].mass_matrix(np.zeros((0, 4))), "q is empty"),
    "a goal for the request of a campaign": (
        lambda d: dy.Campaign(d["robot"], request={"error": 0.03}),  # type: ignore[arg-type]
        r"give dy\.CampaignRequest\(error=0\.03\)",
    ),
    "minutes with their unit": (
        lambda d: dy.Campaign(d["robot"], minutes="5 min"),  # type: ignore[arg-type]
        "minutes is '5 min'; give a number of minutes",
    ),
    "recordings to follow": (lambda d: next(dy.follow(d["robot"], d["runs"])), "dictionaries of arrays t, q and tau"),
    "rows to use": (lambda d: d["read"](mask=[True]), "windows="),
    "a step of too few joints": (lambda d: d["model"].predictor().step(Q[:2], Q[:2], Q[:2]), "one value a joint"),
    "a folder of recordings": (lambda d: dy.read_recordings(d["folder"], robot=d["robot"]), "is a folder"),
    "a folder for a robot": (lambda d: dy.load_robot(d["folder"]), "is a folder"),
    "a folder for a model": (lambda d: dy.load_model(d["folder"]), "is a folder"),
    "a recording for a model": (lambda d: dy.load_model(d["folder"] / "run1.csv"), "not a model file"),
    "a list of paths": (lambda d: dy.read_recordings(["a.csv"], robot=d["robot"]), "one by one"),
    "arrays without names": (lambda d: dy.read_recordings((Q, Q), robot=d["robot"]), "dictionary of arrays by name"),
    "arrays of two lengths": (lambda d: dy.read_recordings({"t": Q, "q1": Q[:2]}, robot=d["robot"]), "same length"),
    "one unit for all": (lambda d: d["read"](units="deg"), "units is 'deg'; give a dictionary"),
    "a dictionary for metadata": (lambda d: d["read"](metadata={"role": "friction"}), "RecordingMetadata"),
    "a misspelt role": (lambda d: dy.RecordingMetadata(role="frictoin"), "choose from"),
    "a number for gravity": (lambda d: dy.load_robot("scara", gravity=-9.81), "three components"),
    "a range for limits": (lambda d: dy.load_robot("scara", limits={"elbow": (-1, 1)}), r"dy\.Limits"),
    "all recordings to revise": (lambda d: dy.revise(d["runs"], signs={"tau1": -1}), r"runs\[0\]"),
    "a kind for a request": (lambda d: dy.design(d["robot"], "random"), 'kind="random"'),
    "a duration with its unit": (lambda d: dy.design(d["robot"], kind="random", duration="8 s"), "seconds"),
    "a limit in per cent": (lambda d: dy.validate(d["model"], limit=5), r"0\.05 for 5 %"),
    "a model for a diagnosis": (lambda d: dy.report(d["model"], diagnosis=d["model"]), r"dy\.diagnose"),
    "a text for validations": (lambda d: d["model"].verdict("direct"), r"dy\.validate"),
    "one day by its name": (lambda d: dy.series(d["model"], "today"), "recordings by day"),
    "a number for a path": (lambda d: d["model"].save(3), "path is 3; give the path of a file"),
    "a foreign ending": (lambda d: d["model"].export("arm.stl"), "must end in"),
    "a dictionary for a box": (lambda d: dy.Surroundings(boxes=[{"size": 1}]), r"\[0\] is .*give a Box, Box\(name"),
    "one box for many": (lambda d: dy.Surroundings(boxes=dy.Box("table", (1, 0, 0), (1, 1, 1))), "boxes is .*a list"),
    "a text for a number": (lambda d: dy.DesignRequest(time_budget="5"), "time_budget is '5'; give a number"),
    "a number for a name": (lambda d: dy.IdentificationChoices(prior=3), "prior is 3; give a text"),
    "a number for limits": (lambda d: dy.DesignRequest(limits={"elbow": 3}), r"limits\['elbow'\] is 3; give a Limits"),
    "a dictionary for a range": (lambda d: dy.Surroundings(tool_range={"low": 1}), "tool_range is .*give a ToolRange"),
    "a number for a posture": (lambda d: dy.DesignRequest(home=np.array(0.5)), r"home is 0\.5; give a list"),
    "a number for windows": (lambda d: dy.RecordingMetadata(windows=np.array(1.0)), r"windows is 1\.0; give a list"),
    "a number for steps": (lambda d: dy.RecordingMetadata(skip=3), "skip is 3; give a list"),
    "a list for a kind": (lambda d: dy.RecordingMetadata(effort_kind=["a"]), "there is no effort_kind 'a'"),
    "a number for a payload": (lambda d: dy.RecordingMetadata(payload=1.0), r"payload is 1\.0; give a dictionary$"),
    "a count of NumPy": (lambda d: TrajectoryRequest(harmonics=np.int64(-5)), "harmonics is -5; it must be"),
    "a distance of NumPy": (lambda d: dy.Surroundings(clearance=np.float32(-1)), r"clearance is -1\.0; it must be"),
    "no number of NumPy": (lambda d: dy.Limits(velocity=np.float32("nan")), "velocity is nan; it must be"),
    "a fraction": (lambda d: dy.Surroundings(clearance=Fraction(-1, 2)), r"clearance is -0\.5; it must be"),
    "a limit of NumPy": (lambda d: dy.validate(d["model"], limit=np.float32(-1)), r"limit is -1\.0; it must be"),
    "negative edges": (lambda d: dy.Box("a", np.zeros(3), -np.ones(3)), r"size is -1\.0; it must be above 0"),
    "a filter of a list": (lambda d: dy.Filters(position_cutoff=[3]), "give a number, None for no filter"),
    "edges in the plane": (lambda d: dy.Box("table", (1, 0, 0), (1, 1)), r"size is \(1, 1\); give 3 values"),
    "an option of choices": (
        lambda d: dy.identify(d["robot"], d["runs"], prior="description"),  # type: ignore[call-arg]
        r"choices=dy\.IdentificationChoices\(prior=…\)",
    ),
    "an option of a request": (
        lambda d: dy.design(d["robot"], surroundings=dy.Surroundings()),  # type: ignore[call-arg]
        r"request=dy\.DesignRequest\(surroundings=…\)",
    ),
    "an argument of statsmodels": (
        lambda d: d["model"].predict(Q, Q, Q, alpha=0.05),
        "predict takes no argument 'alpha'.*interval",
    ),
    "columns the wrong way round": (
        lambda d: dy.read_recordings({"t": Q, "angle": Q}, robot=d["robot"], columns={"angle": "q1"}),
        r'the standard name comes first: columns=\{"q1": "angle"\}',
    ),
    "a flag for progress": (lambda d: dy.identify(d["robot"], d["runs"], progress=True), "progress is True; give"),
}  # fmt: skip


@pytest.fixture(scope="module")
def desk_of_slips(desk: Path, robot: dy.Robot, runs: dy.Recordings, model: dy.Model) -> Desk:
    def read(**options: Any) -> dy.Recordings:
        return dy.read_recordings(desk / "run1.csv", robot=robot, **options)

    return {"folder": desk, "robot": robot, "runs": runs, "model": model, "read": read}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_gets_a_sentence(slip: str, desk_of_slips: Desk) -> None:
    make, words = SLIPS[slip]
    with pytest.raises(dy.DynidentError, match=words):
        make(desk_of_slips)


BOX = dy.Box("a", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
LINK = EffectChoice("rigid_body")
# What is given, beside the plain values that it stands for; iterators can be read only once, so each is made anew.
CONVERTED: dict[str, Callable[[], tuple[object, object]]] = {
    "a generator of boxes": lambda: (dy.Surroundings(boxes=(box for box in [BOX])), dy.Surroundings(boxes=(BOX,))),
    "a map of effects": lambda: (
        dy.IdentificationChoices(effects=map(EffectChoice, ["rigid_body"])),
        dy.IdentificationChoices(effects=(LINK,)),
    ),
    "effects of a criterion": lambda: (
        CriterionChoice("separation", effects=iter([LINK])),
        CriterionChoice("separation", effects=(LINK,)),
    ),
    "a zip of windows": lambda: (
        dy.RecordingMetadata(windows=zip([1, 4], [2, 5], strict=True)),
        dy.RecordingMetadata(windows=((1, 2), (4, 5))),
    ),
    "checks and steps one by one": lambda: (
        dy.RecordingMetadata(accept=iter(["clock"]), skip=iter(["registers"])),
        dy.RecordingMetadata(accept=("clock",), skip=("registers",)),
    ),
    "arrays": lambda: (dy.Box("a", np.zeros(3), np.ones(3)), BOX),
    "a posture as an array": lambda: (dy.DesignRequest(home=np.ones(2)), dy.DesignRequest(home=(1.0, 1.0))),
    "an order as an array": lambda: (
        dy.RecordingMetadata(permutation={"tau": np.array([2, 1])}),
        dy.RecordingMetadata(permutation={"tau": (2, 1)}),
    ),
    "a flag of NumPy": lambda: (dy.Surroundings(self_collision=np.False_), dy.Surroundings(self_collision=False)),
    "another flag": lambda: (
        dy.IdentificationChoices(weigh_turns=np.bool_(False)),
        dy.IdentificationChoices(weigh_turns=False),
    ),
    "a folder": lambda: (dy.Surroundings(mesh_folders=[Path("/tmp")]), dy.Surroundings(mesh_folders=("/tmp",))),
    "an array of one number": lambda: (dy.Surroundings(clearance=np.array(0.5)), dy.Surroundings(clearance=0.5)),
    "a filter of NumPy": lambda: (dy.Filters(torque_cutoff=np.float32(3)), dy.Filters(torque_cutoff=3.0)),
}


@pytest.mark.parametrize("given", CONVERTED)
def test_numbers_of_numpy_iterators_and_paths_are_what_they_stand_for(given: str) -> None:
    request, plain = CONVERTED[given]()
    assert request == plain
    assert repr(request) == repr(plain)


WRONG = (
    3.5,
    "some text",
    ["a", "b"],
    (1, 5),
    {"a": 1},
    {"a"},
    np.zeros(3),
    Path("x.csv"),
    b"bytes",
    object(),
    NoEffect,
)
FUNCTIONS = (dy.load_robot, dy.read_recordings, dy.inspect, dy.identify, dy.load_model, dy.compare, dy.diagnose,
             dy.validate, dy.design, dy.report, dy.changes, dy.series)  # fmt: skip
PLACES = [
    (function, name) for function in FUNCTIONS for name in inspect.signature(function).parameters if name in EXPECTED
]


@pytest.mark.parametrize("number", range(20))
def test_a_drawn_slip_names_the_argument_before_anything_is_computed(number: int, desk_of_slips: Desk) -> None:
    draw = random.Random(number)
    function, name = draw.choice(PLACES)
    expected = EXPECTED.get(f"{function.__name__}.{name}", EXPECTED[name])
    value = draw.choice([value for value in WRONG if not expected.admits(value)])
    arguments: dict[str, Any] = {
        "robot": desk_of_slips["robot"],
        "model": desk_of_slips["model"],
        "recordings": desk_of_slips["runs"],
        "source": "scara",
        "path": "run1.csv",
        "days": desk_of_slips["runs"],
        "before": desk_of_slips["runs"],
        "after": desk_of_slips["runs"],
    }
    wanted = {key for key, one in inspect.signature(function).parameters.items() if one.default is one.empty}
    given = {key: argument for key, argument in arguments.items() if key in wanted}
    with pytest.raises(dy.DynidentError) as raised:
        function(**{**given, name: value})
    assert str(raised.value).startswith(f"{name} is ")
    assert "; give " in str(raised.value) or "; read " in str(raised.value)
    assert raised.value.pointer == name


def test_python_itself_says_which_argument_is_missing(desk_of_slips: Desk) -> None:
    with pytest.raises(TypeError, match="takes 2 positional arguments but 3 were given"):
        dy.identify(desk_of_slips["robot"], desk_of_slips["runs"], "wls")  # type: ignore[misc]
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'recordings'"):
        dy.identify(desk_of_slips["robot"])  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("find", "words"),
    [
        (lambda model: model.cov_params, "use covariance"),
        (lambda model: model.paramters, "did you mean 'parameters'"),
        (lambda model: model.identificaton, "did you mean 'identification'"),
        (lambda model: model.params.iloc, r"to_frame\(\)\.iloc"),
        (lambda model: model.fittedvalues, r'compare\(model, recordings\)\.to_frame\(\)\["predicted"\]'),
        (lambda model: model.f_test, r"use wald_test\(\{"),
        (lambda model: model.recordings[0].recording.rows, "Recording has no attribute 'rows'; use n_samples"),
        (lambda model: model.recordings[0].shape, r"use to_frame\(\)\.shape"),
        (lambda model: model.plot().ax, r"Figure has no attribute 'ax'; use draw\(axes\)"),
        (lambda model: model.robot.joint_name, "Robot has no attribute 'joint_name'; did you mean 'joint_names'"),
        (lambda model: model.robot.names, "Robot has no attribute 'names'; use joint_names"),
        (lambda model: model.fit.relativ, "Errors has no attribute 'relativ'; did you mean 'relative'"),
        (
            lambda model: model.parameters[0].values,
            "IdentifiedParameter has no attribute 'values'; did you mean 'value'",
        ),
        (lambda model: model.residuals().plot, r"to_frame\(\)\.plot"),
    ],
)
def test_a_name_of_other_packages_leads_to_ours(find: Callable[[Any], object], words: str, model: dy.Model) -> None:
    with pytest.raises(AttributeError, match=words):
        find(model)


def test_every_public_result_names_the_attribute_that_was_meant() -> None:
    results = [getattr(dy, name) for name in dy.__all__]
    results = [item for item in results if isinstance(item, type) and not issubclass(item, (Exception, Request))]
    assert len(results) > 15
    # What a user writes down himself, such as limits, names its fields when it is made.
    stated = {dy.Box, dy.Wall, dy.Drive, dy.Limits, dy.EffectChoice, dy.Filters}
    assert [item.__name__ for item in results if not issubclass(item, KnownNames) and item not in stated] == []
    for name, others in ELSEWHERE.items():
        targets = [re.match(r"(dynident\.)?(\w+)", other)[2] for other in others.split(" or ")]
        assert all(any(hasattr(item, target) for item in (*results, Recording, dy)) for target in targets), name


def test_a_name_leads_to_nothing_that_the_class_lacks(runs: dy.Recordings) -> None:
    with pytest.raises(AttributeError) as raised:
        runs.score  # type: ignore[attr-defined]  # noqa: B018
    assert "held_out" not in str(raised.value)
