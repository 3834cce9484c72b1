"""Which payload each recording carries, by its metadata; reduced data with columns for unknown payloads."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import (
    DEFAULT_EFFECTS,
    OFFSETS,
    EffectChoice,
    ReferenceParameters,
    choose_payload,
    get_effect,
    get_role,
)
from dynident.errors import DynidentError
from dynident.estimation import Reduction
from dynident.identification.equations.model_and_data_checks import check_recordings, check_reduction
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording, choose_preprocessing
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import Model, build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import Robot

PLAIN_EFFECTS = (*DEFAULT_EFFECTS, OFFSETS)
"""Effects of the model beside a payload or gains, unless the caller names others."""

_TITLE = "Unusable payload"
_FIRST_MOMENTS = ("MXp", "MYp", "MZp")


@dataclass(frozen=True)
class KnownPayload:
    """A payload that a recording's metadata state.

    Parameters
    ----------
    mass : float
        The mass in kg.
    centre : (x, y, z) or None
        Its centre in m, in the frame of the last joint; None where it is not stated.
    """

    mass: float
    centre: tuple[float, float, float] | None = None

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameters of the payload effect that are known, by name."""
        if self.centre is None:
            return {"Mp": self.mass}
        # First moments are the mass times the centre, and linear in the torque as the mass is.
        moments = {name: self.mass * x for name, x in zip(_FIRST_MOMENTS, self.centre, strict=True)}
        return {"Mp": self.mass, **moments}


@dataclass(frozen=True, eq=False)
class LoadedData:
    """Recordings without and with payloads, reduced to a model in which every loaded recording has its own payload.

    Parameters
    ----------
    model : Model
        The model, with a payload for each loaded recording.
    reduction : Reduction
        The joints' torques in its columns.
    loaded : tuple of Recording
        The recordings with a payload.
    """

    model: Model
    reduction: Reduction
    loaded: tuple[Recording, ...]

    def payload_column(self, recording: Recording, parameter: str) -> int:
        """Return the number of a payload's parameter among those of the model.

        Parameters
        ----------
        recording : Recording
            The loaded recording.
        parameter : str
            Name of the parameter: "Mp", "MXp", …

        Returns
        -------
        int
            Its number among the base parameters.

        Raises
        ------
        DynidentError
            Where the parameter was absorbed by others.
        """
        for k, column in enumerate(self.model.kept):
            if get_role(column) == "load" and column.parameter == parameter and column.runs == (recording.name,):
                return k
        raise DynidentError(
            f"{parameter} of the payload in {recording.name} cannot be separated from other parameters",
            pointer="/recordings",
            title="Not identifiable",
        )


def read_known_payload(recording: Recording) -> KnownPayload:
    """Return the payload that a recording's metadata state.

    Raises
    ------
    DynidentError
        Where there is none, or its mass or centre is no usable number.
    """
    return parse_payload(recording.name, recording.payload)


def parse_payload(name: str, payload: Mapping[str, object] | None) -> KnownPayload:
    """Return the payload from a recording's name and metadata, without the recording itself.

    Parameters
    ----------
    name : str
        Name of the recording, for messages.
    payload : mapping, optional
        "mass" in kg and, where known, "centre" in m.

    Raises
    ------
    DynidentError
        Where there is none, or its mass or centre is no usable number.
    """
    if payload is None:
        raise _payload_error(name, "", 'no payload is given; give "payload": {"mass": …} in kg')
    # Metadata come from a user's file or request, so every value may be of any type.
    mass = _to_number(payload.get("mass"))
    if not (math.isfinite(mass) and mass > 0):
        stated = payload.get("mass")
        raise _payload_error(name, "/mass", f"the payload's mass is {stated!r}; give a number of kg above zero")
    centre = payload.get("centre")
    if centre is None:
        return KnownPayload(mass)
    numbers = [_to_number(x) for x in centre] if isinstance(centre, Sequence) else []
    if len(numbers) != 3 or not all(math.isfinite(x) for x in numbers):
        raise _payload_error(
            name, "/centre", f"the payload's centre is {centre!r}; give x, y and z in m in the last joint's frame"
        )
    return KnownPayload(mass, (numbers[0], numbers[1], numbers[2]))


def reduce_with_payloads(
    robot: Robot,
    unloaded: Sequence[Recording],
    loaded: Sequence[Recording],
    effects: Sequence[EffectChoice] = PLAIN_EFFECTS,
    preprocessing: Preprocessing | None = None,
    progress: Progress = ignore_progress,
) -> LoadedData:
    """Reduce recordings without and with a payload.

    Parameters
    ----------
    robot : Robot
        The robot.
    unloaded, loaded : sequence of Recording
        Recordings without and with the payload.
    effects : sequence of EffectChoice
        The model besides the payloads.
    preprocessing : Preprocessing, optional
        Filters; from the data where left out.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    LoadedData
        Model and equations, with a payload of its own for each loaded recording.

    Raises
    ------
    DynidentError
        Where one of the two kinds is missing, two loaded recordings have the same name, or an effect needs the load.
    """
    for pointer, word, group in (("/unloaded_ids", "without", unloaded), ("/loaded_ids", "with", loaded)):
        if not group:
            raise DynidentError(
                f"a recording {word} the payload is missing: record the same motion without and with it",
                pointer=pointer,
                title="Nothing to compare",
            )
    # Names tell the payloads apart, so two recordings must not share one.
    names = [recording.name for recording in (*unloaded, *loaded)]
    if len(set(names)) < len(names):
        raise DynidentError(
            "two recordings have the same name; give each a different name", pointer="/loaded_ids", title=_TITLE
        )
    for index, choice in enumerate(effects):
        effect = get_effect(choice.effect, f"/effects/{index}")
        if effect.needs_load or effect.in_some_runs:
            raise DynidentError(
                f"{choice.effect} cannot be used together with unknown gains and payloads; leave it out",
                pointer=f"/effects/{index}",
                title="Unfit effect",
            )
    recordings = [*unloaded, *loaded]
    check_recordings(robot, recordings, ())
    # A payload for each loaded recording, as an effect in that run alone: the name tells them apart.
    carried = [choose_payload(recording.name) for recording in loaded]
    # Loads need no predicted torque here, so the reference parameters are empty.
    model = build_model(robot, [*effects, *carried])
    chosen = preprocessing or choose_preprocessing(recordings)
    nothing = ReferenceParameters.massless(robot)
    reduction = reduce_recordings(model.observation, RegressorInputs(recordings, chosen, nothing), progress)
    check_reduction(model, reduction)
    return LoadedData(model, reduction, tuple(loaded))


def scale_torque(reduction: Reduction, factors: FloatArray) -> Reduction:
    """Return the same data with the torque of every equation multiplied by a factor (n,).

    Parameters
    ----------
    reduction : Reduction
        Factors of W and the torque, one equation a joint.
    factors : (n,)
        One factor for each joint.
    """
    equations = tuple(
        # Only the last column, which holds the torque, is scaled.
        equation.mix_columns(np.diag([*np.ones(len(equation.columns)), factor]), equation.columns)
        for equation, factor in zip(reduction.equations, factors, strict=True)
    )
    return Reduction(reduction.n_columns, equations, reduction.spans)


def _to_number(value: object) -> float:
    """Return the value as a number; NaN where it is none."""
    # True and False are integers to Python, and no masses.
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _payload_error(name: str, where: str, detail: str) -> DynidentError:
    return DynidentError(f"{name}: {detail}", pointer=f"/payload{where}", title=_TITLE)
