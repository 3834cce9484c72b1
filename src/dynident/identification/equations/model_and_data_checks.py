"""Check that effects, recordings and reduced data fit together: temperature, runs, wrench, undetermined parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import EffectChoice, get_effect, get_role
from dynident.errors import DynidentError
from dynident.estimation import EquationFactors, EstimationError, PriorInformation, Reduction, build_weighted_factor
from dynident.identification.estimation_problem_options import ModelName
from dynident.recordings import Recording
from dynident.regressors.model_structure import Model
from dynident.robot import Robot

# Share of the largest norm, or singular value, below which a column, or a direction, is rounding.
_TINY = 1e-9


def find_undetermined_parameters(
    model: Model, reduction: Reduction, known: PriorInformation | None = None
) -> list[str]:
    """Return the names of the parameters whose column is zero, or depends on the others, on these data.

    What is known beside the data counts as rows of it, in units of each equation's torque.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    reduction : Reduction
        Factors of W and the torque, one equation a joint.
    known : PriorInformation, optional
        Rows of a prior, in the model's columns.
    """
    units = np.array([_get_row_unit(equation, known) for equation in reduction.equations])
    # A parameter that is held needs no data.
    own = np.arange(reduction.n_columns) if known is None else np.flatnonzero(~known.is_held)
    factor = build_weighted_factor(reduction, units, known)[:-1, :-1][:, own]
    norms = np.linalg.norm(factor, axis=0)
    largest = float(norms.max(initial=0.0))
    lost = norms <= _TINY * largest
    names = [model.kept[k].name for k in own]
    if not len(names):
        return []
    # Columns of zeros first: the scaling below would divide by their norms.
    if lost.any() or largest == 0.0:
        return [names[k] for k in np.flatnonzero(lost)]
    # Columns of equal size, or the units of the parameters would decide what counts as small.
    singular = np.linalg.svd(factor / norms, compute_uv=False)
    # Singular values alone take a third of the time, and mostly no direction is asked for.
    if singular[-1] > _TINY * singular[0]:
        return []
    _, singular, vt = np.linalg.svd(factor / norms)
    null = vt[singular <= _TINY * singular[0]]
    # All parameters with a noticeable part in an undetermined direction: naming only one of them would be arbitrary.
    involved = np.abs(null).max(axis=0, initial=0.0) > 0.05
    return [names[k] for k in np.flatnonzero(involved)]


def _get_row_unit(equation: EquationFactors, known: PriorInformation | None) -> float:
    """Return the unit that rows are counted in: 1 N m where nothing stands beside them, else the size of the torque."""
    # Rms of the torque: the norm of its column of the factor over the root of the number of rows.
    size = float(np.linalg.norm(equation.whole_factor[:, -1])) / max(float(equation.counts.sum()), 1.0) ** 0.5
    return 1.0 if known is None or not known.has_rows or size == 0 else size


def check_recordings(robot: Robot, recordings: Sequence[Recording], validation: Sequence[Recording]) -> None:
    """Raise where there is nothing to identify from, or a recording is another robot's.

    Parameters
    ----------
    robot : Robot
        The robot.
    recordings, validation : sequence of Recording
        Data of the fit, and held-out data.

    Raises
    ------
    DynidentError
    """
    if not recordings:
        raise DynidentError("give at least one measurement to identify from", pointer="/recordings")
    for pointer, group in (("/recordings", recordings), ("/validation", validation)):
        for index, recording in enumerate(group):
            # The order counts as well: columns are matched to joints by their place.
            if recording.joint_names != robot.joint_names:
                raise DynidentError(
                    f"{recording.name} has the joints {', '.join(recording.joint_names)}, but the robot has "
                    f"{', '.join(robot.joint_names)}",
                    pointer=f"{pointer}/{index}",
                    title="Another robot's measurement",
                )


def check_joint_torques(robot: Robot, name: ModelName, recordings: Sequence[Recording]) -> None:
    """Raise where a model needs the torques of all joints, or of the feet, and a recording lacks one of them.

    Parameters
    ----------
    robot : Robot
        The robot.
    name : str
        Of the equation type.
    recordings : sequence of Recording
        Recordings of the robot.

    Raises
    ------
    DynidentError
    """
    if robot.contacts and name != "dynamic":
        raise DynidentError(
            f"{robot.name} has contacts, whose unknown forces are eliminated from the dynamic model alone; choose it "
            f"instead of {name}",
            pointer="/model",
            title="Not with contacts",
        )
    # Work of a joint whose torque is missing cannot be told from work of the others in a sum.
    lacking = [recording for recording in recordings if recording.joints_without_torque]
    if lacking and name in ("power", "energy"):
        raise DynidentError(
            f"the {name} model adds up the work of all joints, but {lacking[0].name} has no torque of "
            f"{', '.join(lacking[0].joints_without_torque)}; choose the dynamic or the filtered model",
            pointer="/model",
            title="No torque",
        )


def check_temperature(
    effects: Sequence[EffectChoice], recordings: Sequence[Recording], validation: Sequence[Recording]
) -> None:
    """Raise where an effect needs the joints' temperature and a recording has none: a guess would pass for data.

    Parameters
    ----------
    effects : sequence of EffectChoice
        Effects with their joints and shape constants.
    recordings, validation : sequence of Recording
        Data of the fit, and held-out data.

    Raises
    ------
    DynidentError
    """
    for index, choice in enumerate(effects):
        if not get_effect(choice.effect, f"/effects/{index}").needs_temperature:
            continue
        cold = [recording.name for recording in (*recordings, *validation) if not recording.has_temperature]
        if cold:
            raise DynidentError(
                f"{choice.effect} needs the temperature of every joint, but {', '.join(cold)} has no columns "
                "temperature1, temperature2, …. Record them, or choose warm_up_friction, which needs only the time of "
                "the session",
                pointer=f"/effects/{index}",
                title="Temperature needed",
            )


def check_runs(
    effects: Sequence[EffectChoice], recordings: Sequence[Recording], validation: Sequence[Recording] = ()
) -> None:
    """Raise where an effect is limited to runs that do not exist, or needs to be limited and is not.

    Held-out runs may be named besides others: that they carry a load, too.

    Parameters
    ----------
    effects : sequence of EffectChoice
        Effects with their joints and shape constants.
    recordings, validation : sequence of Recording
        Data of the fit, and held-out data.

    Raises
    ------
    DynidentError
    """
    labels = dict.fromkeys(label for recording in recordings for label in recording.segment_names)
    known = {*labels, *(recording.name for recording in recordings)}
    besides = {label for recording in validation for label in (recording.name, *recording.segment_names)}
    for index, choice in enumerate(effects):
        # Names of recordings and of the runs within them both count.
        strangers = [run for run in choice.runs if run not in known | besides]
        if choice.runs and not strangers and not known & set(choice.runs):
            raise DynidentError(
                f"{choice.effect} is declared only in held-out runs, from which nothing is identified; also name the "
                f"runs with this effect among {', '.join(labels)}",
                pointer=f"/effects/{index}/runs",
                title="Unknown run",
            )
        if strangers:
            raise DynidentError(
                f"{choice.effect} is declared in {', '.join(strangers)}, but the runs are: {', '.join(labels)}",
                pointer=f"/effects/{index}/runs",
                title="Unknown run",
            )
        # A payload that the metadata state says in which runs the effect is.
        stated = any(recording.payload is not None for recording in recordings)
        if get_effect(choice.effect, f"/effects/{index}").in_some_runs and not choice.runs and not stated:
            raise DynidentError(
                f"{choice.effect} needs the runs in which it acts: name them (runs), out of {', '.join(labels)}, or "
                "give the payload in the metadata of the measurements with a payload",
                pointer=f"/effects/{index}/runs",
                title="Runs needed",
            )


STANDING_SHOWS_NO_MASS = (
    "The forces on its contacts are unknown, and a robot that only stands does not show its mass through them: add a "
    "recording in which it lifts its feet one after the other and shifts its weight"
)


def check_equations(model: Model, name: ModelName, equations: Reduction, torque: Reduction) -> None:
    """Raise where a model's equations do not determine what the joints' torques on the same data do.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    name : str
        Of the equation type.
    equations, torque : Reduction
        Rows of that type, and those of the joints' torques.

    Raises
    ------
    EstimationError
    """
    # The torques have to be asked, too: a parameter that they do not show either is the motion's fault, not the
    # equations'.
    lost = find_undetermined_parameters(model, equations)
    if not lost or find_undetermined_parameters(model, torque):
        return
    why = {
        "energy": "its equation adds up energy over intervals, and torques that do no work do not appear in it",
        "power": "its equation adds up power, and torques that do no work do not appear in it",
    }
    raise EstimationError(
        f"not identifiable with the {name} model ({why.get(name, 'its equations do not show them')}): "
        f"{', '.join(lost)}. The joint torques show them: choose the dynamic or the filtered model, leave these "
        "effects out, or record a motion whose joints do not swing together",
        pointer="/model",
        title="Not identifiable with this model",
    )


def check_torque(model: Model, torque: Reduction) -> None:
    """Raise where a joint's torque is zero throughout although its motion asks for some.

    Its residual would vanish as its weight grows: the weighting would be singular, and the joint would decide alone.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    torque : Reduction
        Rows of the joints' torques.

    Raises
    ------
    EstimationError
    """
    dead = [
        name
        # On a base that nothing touches no torque acts.
        for name, equation in list(zip(model.robot.joint_names, torque.equations, strict=True))[model.robot.n_base :]
        if equation.whole_factor[:, :-1].any() and not equation.whole_factor[:, -1].any()
    ]
    if dead:
        raise EstimationError(
            f"the torque of {', '.join(dead)} is zero everywhere, so no weight of this joint can be computed; check "
            "which column has its torque and that the drive was on, or lock the joint",
            pointer="/recordings",
            title="No torque",
        )


def check_reduction(model: Model, reduction: Reduction, known: PriorInformation | None = None) -> None:
    """Raise where the data, with what is known beside them, cannot determine the model; name what is missing.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    reduction : Reduction
        Factors of W and the torque, one equation a joint.
    known : PriorInformation, optional
        Rows of a prior.

    Raises
    ------
    EstimationError
    """
    # The reasons are checked from the most basic one on, so that the message names the real cause.
    if reduction.n_rows == 0:
        raise EstimationError(
            "no rows are left after filtering; use a longer recording or wider windows",
            pointer="/recordings",
            title="Too few samples",
        )
    if not any(equation.whole_factor[:, -1].any() for equation in reduction.equations):
        raise EstimationError(
            "the torque is zero everywhere: it was not recorded, or the motors were off. From a robot that swings "
            "freely only ratios can be identified, inertia and friction over "
            f"gravity{_describe_ratios(model, reduction)}. For the parameters themselves record the torque of a "
            "motion that the motors drive, or check which columns contain it",
            pointer="/recordings",
            title="No torque",
        )
    unseen = find_undetermined_parameters(model, reduction, known)
    if unseen:
        stands = f". {STANDING_SHOWS_NO_MASS}" if model.robot.contacts else ""
        why = (
            "(in this motion they act alike, as friction and an offset do where a joint moves in one direction only); "
            "add a run in which the joint also moves back, or leave one of the effects out"
            if _act_alike(model, reduction, unseen)
            else "(the data do not determine the parameters of a joint that moves too little"
            f"{_name_still_joints(model, unseen)}); lock that joint, leave its effects out, or add a run in which it "
            "moves; if it did move, its position was not recorded"
        )
        raise EstimationError(
            f"not identifiable from these data: {_name_parameters(model, unseen)} {why}{stands}",
            pointer="/recordings",
            title="Not identifiable",
        )


def _name_still_joints(model: Model, unseen: Sequence[str]) -> str:
    """Return ": joint1, joint4", the joints without any friction that is determined; "" where there is none."""
    friction: dict[str, list[str]] = {}
    for column in model.kept:
        if get_role(column) in ("dry", "damping"):
            friction.setdefault(column.link, []).append(column.name)
    still = [joint for joint, names in friction.items() if set(names) <= set(unseen)]
    return f": {', '.join(still)}" if still else ""


def _act_alike(model: Model, reduction: Reduction, names: Sequence[str]) -> bool:
    """Tell whether each of these parameters acts on its joint as another one of them does, up to a factor."""
    places = [k for k, column in enumerate(model.kept) if column.name in names]
    factor = build_weighted_factor(reduction, np.ones(len(reduction.equations)))[:-1, places]
    norms = np.linalg.norm(factor, axis=0)
    if not norms.all():
        return False
    cosines = np.abs((factor / norms).T @ (factor / norms)) - np.eye(len(places))
    return bool((cosines.max(axis=0) > 1.0 - _TINY).all())


_HOMOGENEOUS = 0.3
"""Share of the next singular value of W, of columns of the same size, below which the smallest one stands apart: there
is then one direction W χ = 0, which noise leaves uncertain by about this share."""

_MOST_RATIOS = 8


def _describe_ratios(model: Model, reduction: Reduction) -> str:
    """Describe the parameters up to a common factor, where W χ = 0 determines their ratios; else return nothing.

    The solution is the right singular vector of W's smallest singular value, of columns of the same size.
    """
    w = build_weighted_factor(reduction, np.ones(len(reduction.equations)))[:-1, :-1]
    sizes = np.linalg.norm(w, axis=0)
    nonzero = np.flatnonzero(sizes > 1e-9 * sizes.max(initial=0.0))
    if len(nonzero) < 2:
        return ""
    _, singular, right = np.linalg.svd(w[:, nonzero] / sizes[nonzero])
    share = right[-1]
    moments = [k for k, column in enumerate(nonzero) if model.kept[column].parameter in ("MX", "MY", "MZ")]
    # Two small singular values would be two free directions, and no set of ratios.
    if not moments or singular[-1] > _HOMOGENEOUS * singular[-2]:
        return ""
    # Ratios are given to a first moment: gravity acts on it, so it is the best determined one of a robot that swings.
    lead = max(moments, key=lambda k: abs(share[k]))
    parameters = [model.kept[k] for k in nonzero]
    # Undo the scaling of the columns.
    values = share / sizes[nonzero]
    values = values / abs(values[lead])
    # Either sign solves the equations; moments of inertia and friction are positive in one of them.
    positive = [k for k, column in enumerate(parameters) if column.parameter in ("XX", "YY", "ZZ", "Ia", "Fv", "Fc")]
    if sum(values[k] * sizes[nonzero[k]] for k in positive) < 0:
        values = -values
    # The parameters that shape the motion most are named first.
    order = [k for k in np.argsort(-np.abs(share)) if k != lead][:_MOST_RATIOS]
    named = ", ".join(f"{parameters[k].name} = {values[k]:.3g} {parameters[k].unit}" for k in (lead, *order))
    return f"; up to a common factor {named}"


def _name_parameters(model: Model, names: Sequence[str]) -> str:
    """Return the names of parameters, and their joints where these are one or two."""
    joints = dict.fromkeys(column.link for column in model.kept if column.name in names and column.link)
    few = f" of {' and '.join(joints)}" if 0 < len(joints) <= 2 else ""
    return ", ".join(names) + few


_OTHER_MASSES, _ALIKE, _OTHER_UNITS = 1.75, 0.8, 100.0
"""Ratio of the first moments to those of the description from which on they are told: 0.7 to 1.66 on open recordings
without a load; the cosine between both above which one factor describes the difference; and the ratio from which on a
unit is wrong."""


def describe_other_masses(model: Model, values: FloatArray, known: BoolArray) -> tuple[str, ...]:
    """Say by how much the links that the data ask for are heavier or lighter than those of the description.

    Parameters
    ----------
    model : Model
        The model.
    values : (b,)
        Its base parameters.
    known : (b,)
        The first moments among them that the data determine.
    """
    described = model.describe_base_parameters()
    if described is None or described.shape != values.shape:
        return ()
    ours, theirs = values[known], described[known]
    size = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
    if not size or float(ours @ theirs) < _ALIKE * size:
        return ()
    times = float(ours @ theirs / (theirs @ theirs))
    if 1.0 / _OTHER_MASSES < times < _OTHER_MASSES:
        return ()
    if not 1.0 / _OTHER_UNITS < times < _OTHER_UNITS:
        return (
            f"The data ask for links {times:.2g} times as heavy as those of the description (by their first moments). "
            "No other robot, load or gain is so far off: first compare the units of the description (kg, m) and of the "
            "torques.",
        )
    return (
        f"The data ask for links {times:.2g} times as heavy as those of the description (by their first moments). "
        "Identification does not use its masses. If they should be right, this is the description of another robot or "
        "size, the robot carried a load that it does not contain, or the drive gains are others.",
    )
