"""Effects taken out of an identified model: small algebra on its reduced data, no recording is read again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import EffectChoice, columns_of, effect_by_id
from dynident.effects.catalogue import joints_of
from dynident.effects.written import constant_in_words
from dynident.errors import DynidentError
from dynident.estimation import Reduction
from dynident.identification.shapes.shape_columns import shape_places
from dynident.identification.study.concluding import Part, conclude
from dynident.identification.study.result import Identification, LadderStep
from dynident.regressors.base_parameters import base_parameters_among
from dynident.regressors.model import Model, build_model, check_columns
from dynident.robot import Robot
from dynident.threads import single_threaded

_TITLE = "Nothing to remove"


@single_threaded
def remove(identification: Identification, removed: Sequence[EffectChoice]) -> Identification:
    """Take effects out of an identified model and solve again for the parameters that are left.

    The columns of the smaller model are combinations of those that the reduced data hold, so the result is that of
    identifying it anew. Predicted loads stay those of the larger model.

    Parameters
    ----------
    identification : Identification
    removed : sequence of EffectChoice
        Each is taken off its joints, or off all where it names none; with shape constants or runs only what has these.

    Raises
    ------
    DynidentError
        Where one of them is not in the model, or nothing would be left.
    """
    known = identification.model
    kept = effects_without(identification.choices.effects, removed, known.robot)
    choices = replace(identification.choices, effects=kept)
    model, weights = smaller_model(known, kept, choices.tolerance)
    data = identification.data.combined(weights)
    shaped = combined_shapes(identification, kept, weights)
    to_solve = data.to_solve(identification.estimate.reference)
    smaller = conclude(model, choices, to_solve, data, Part(known, weights), lambda _: shaped)
    return replace(smaller, step=LadderStep(identification, removed=tuple(removed)))


def effects_without(
    effects: Sequence[EffectChoice], removed: Sequence[EffectChoice], robot: Robot
) -> tuple[EffectChoice, ...]:
    """The effects that are left when others are taken away, wholly or off some joints.

    Raises
    ------
    DynidentError
        Where one of them is not there, or nothing would be left.
    """
    left = tuple(effects)
    for index, choice in enumerate(removed):
        pointer = f"/effects/{index}"
        joints_of(choice, robot, pointer)
        rest = tuple(part for one in left for part in _without(one, choice, robot))
        if rest == left:
            place = f" on {', '.join(choice.joints)}" if choice.joints else ""
            place += "".join(f", {constant_in_words(choice.effect, name, value)}" for name, value in choice.shape)
            names = ", ".join(dict.fromkeys(one.effect for one in left))
            detail = f"the model has no {choice.effect}{place}; it has: {names}"
            raise DynidentError(detail, pointer=pointer, title=_TITLE)
        left = rest
    if not left:
        raise DynidentError("nothing would be left in the model; keep at least one effect", pointer="/effects")
    return left


def _without(one: EffectChoice, taken: EffectChoice, robot: Robot) -> tuple[EffectChoice, ...]:
    """What is left of one choice: itself, the same on fewer joints, or nothing."""
    other_shape = not set(taken.shape) <= set(one.shape)
    other_runs = bool(taken.runs) and taken.runs != one.runs
    if one.effect != taken.effect or other_shape or other_runs:
        return (one,)
    if effect_by_id(one.effect).scope == "robot":
        return ()
    gone = joints_of(taken, robot)
    before = joints_of(one, robot)
    left = [joint for joint in before if joint not in gone]
    if len(left) == len(before):
        return (one,)
    return (replace(one, joints=tuple(robot.joint_names[j] for j in left)),) if left else ()


def smaller_model(
    known: Model, effects: Sequence[EffectChoice], tolerance: float, pointer: str = "/effects"
) -> tuple[Model, FloatArray]:
    """The model of some of a model's effects, and what its columns are made of (b, b'); nothing is compiled anew.

    Raises
    ------
    DynidentError
        Where an effect has columns that the known model does not.
    """
    where = {column.key: k for k, column in enumerate(known.columns)}
    columns = columns_of(effects, known.signals)
    check_columns(columns)
    strangers = sorted({column.effect for column in columns if column.key not in where})
    if strangers:
        raise DynidentError(
            f"the reduced data have no columns for {', '.join(strangers)}; identify from the recordings for that",
            pointer=pointer,
            title="Recordings needed",
        )
    base = base_parameters_among(known.base, known.observation, [where[c.key] for c in columns], tolerance)
    model = build_model(known.robot, effects, tolerance=tolerance, signals=known.signals, base=base)
    return model, _combinations(known, model)


def combined_shapes(
    identification: Identification, effects: Sequence[EffectChoice], weights: FloatArray | None = None
) -> Reduction | None:
    """The rows that tell how sure shape constants are, for a model of some of the effects.

    None where there are none, or the constant of an effect is to be told of on fewer joints than it was looked at on.
    """
    before, after = shape_places(identification.model.effects), shape_places(effects)
    where = {(identification.model.effects[p.choice], p.spec.name): k for k, p in enumerate(before)}
    wanted = [(effects[p.choice], p.spec.name) for p in after]
    shaped = identification.data.shaped
    if shaped is None or not wanted or any(one not in where for one in wanted):
        return None
    b = identification.model.n_parameters
    own = np.eye(b) if weights is None else weights
    whole = np.zeros((b + len(before), own.shape[1] + len(wanted)))
    whole[:b, : own.shape[1]] = own
    for k, one in enumerate(wanted):
        whole[b + where[one], own.shape[1] + k] = 1.0
    return shaped.combined(whole)


def _combinations(known: Model, smaller: Model) -> FloatArray:
    """(b, b'): what the smaller model's columns are made of, in columns that the known model keeps.

    Mostly these are the same columns. One that was absorbed by what is removed comes back as its combination.
    """
    where = {column.key: k for k, column in enumerate(known.columns)}
    return np.asarray(known.base.grouping[:, [where[column.key] for column in smaller.kept]])
