"""Add effects to a model (`extend`): new columns are evaluated on the recordings, and the model is solved again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate, takewhile

import numpy as np

from dynident.effects import EffectChoice, ReferenceParameters, get_effect
from dynident.errors import DynidentError
from dynident.estimation.residual_errors import compute_t
from dynident.identification.equations.model_and_data_checks import check_recordings, check_runs, check_temperature
from dynident.identification.equations.reduced_recordings import reduce_torque, split_friction_tests
from dynident.identification.identified_models.fit_model import identify_model, is_read_again
from dynident.identification.identified_models.gravity_from_poses import (
    ACTING_AT_REST,
    are_poses,
    build_model_at_rest,
    identify_poses,
)
from dynident.identification.identified_models.held_out_gain import (
    SURE_T,
    compute_block_squares,
    list_addition_warnings,
)
from dynident.identification.identified_models.identification_result import Identification, LadderStep
from dynident.identification.identified_models.identify_from_recordings import (
    add_digests,
    check_same_recordings,
    solve_for_reference,
)
from dynident.identification.identified_models.remove_and_solve_again import solve_submodel
from dynident.identification.shape_refinement import list_shape_variables, reduce_with_shapes
from dynident.identification.shape_search import check_choices, complete_shapes, lacks_shape
from dynident.parallel import defer, single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Recording
from dynident.regressors.model_structure import Model, extend_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.row_cache import reduce_without_rest
from dynident.regressors.row_phases import have_same_instants


@dataclass(frozen=True)
class RunWithEffect:
    """A held-out run in which the added effects act.

    Parameters
    ----------
    run : str
        Label of the run.
    ratio : float
        Root of its squared error without the effects over that with them.
    """

    run: str
    ratio: float


def needs_search_in_held_out_runs(choice: EffectChoice, validation: Sequence[Recording]) -> bool:
    """Tell whether an effect acts in some runs only, and no held-out run is named among them.

    Parameters
    ----------
    choice : EffectChoice
        The effect with its runs.
    validation : sequence of Recording
        Held-out recordings.

    Returns
    -------
    bool
        True where the held-out runs with the effect have to be found.
    """
    held_out = {label for recording in validation for label in (recording.name, *recording.segment_names)}
    return bool(choice.runs) and bool(held_out) and not held_out & set(choice.runs)


def find_runs_with_effects(
    grown: Identification, base: Model, added: Sequence[EffectChoice], validation: Sequence[Recording]
) -> tuple[RunWithEffect, ...]:
    """Find the held-out runs that are predicted better with the added effects than without them, beyond chance.

    Parameters
    ----------
    grown : Identification
        Identified with the effects `added` to the model `base`, in none of the held-out runs.
    base : Model
        The model before the effects were added.
    added : sequence of EffectChoice
        The effects, with the runs of the identification data that they act in.
    validation : sequence of Recording
        Held-out recordings, whose runs are tested one by one.

    Returns
    -------
    tuple of RunWithEffect
        Empty where no run is predicted better.
    """
    names = tuple(recording.name for recording in validation)
    everywhere = tuple(replace(choice, runs=choice.runs + names) if choice.runs else choice for choice in added)
    # Let the effect act in every held-out run at first. The parameters stay those of the fit, so that one reduction
    # of each run serves both predictions.
    model = extend_model(base, everywhere, tolerance=grown.choices.tolerance)
    # The effect in other runs would need parameters that were not identified.
    if model.n_parameters != grown.model.n_parameters:
        return ()
    # The prediction without the effect: its parameters set to zero, all others as they are.
    without = np.where([bool(set(column.runs) & set(names)) for column in model.kept], 0.0, grown.values)
    findings = []
    for label, run in _iterate_runs(validation):
        data = reduce_torque(model, RegressorInputs((run,), grown.preprocessing, grown.estimate.reference)).torque
        off, on = (compute_block_squares(data, values, grown.noise) for values in (without, grown.values))
        # The gain has to stand out of its own scatter over blocks of time, or a run that was only lucky would count.
        if compute_t(off - on) >= SURE_T:
            findings.append(RunWithEffect(label, float(np.sqrt(off.sum() / on.sum()))))
    return tuple(findings)


def describe_runs_with_effects(added: Sequence[EffectChoice], findings: Sequence[RunWithEffect]) -> str:
    """Describe the effects and the held-out runs that they were found in.

    Parameters
    ----------
    added : sequence of EffectChoice
        The effects that were added.
    findings : sequence of RunWithEffect
        The runs that they were found in.

    Returns
    -------
    str
        A sentence for the user.
    """
    titles = " and ".join(dict.fromkeys(get_effect(choice.effect).title for choice in added if choice.runs))
    runs = ", ".join(f"{finding.run} (error {finding.ratio:.2g} times as large without it)" for finding in findings)
    return (
        f"{titles} also appears in held-out runs and is assumed there: {runs}. If this is wrong, name the runs "
        "yourself."
    )


def _iterate_runs(recordings: Sequence[Recording]) -> Iterator[tuple[str, Recording]]:
    """Yield every run of the recordings by itself, with its label."""
    for recording in recordings:
        for label in recording.segment_names:
            # A run may have several segments with one label.
            own = [item for k, item in enumerate(recording.segments) if recording.name_segment(k) == label]
            yield label, replace(recording, segments=tuple(own))


@single_threaded
def extend(
    identification: Identification,
    added: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    progress: Progress = ignore_progress,
) -> Identification:
    """Add effects to an identified model, one step of the ladder each, on the data it was identified from.

    The last step is returned; those below it are its parents. An effect that adds nothing to those before it gets none.

    Parameters
    ----------
    identification : Identification
        The identified model.
    added : sequence of EffectChoice
        Shape constants that are left open are found from the data.
    recordings : sequence of Recording
        Those that the model was identified from.
    validation : sequence of Recording
        Data that no parameter sees.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    Identification
        The model with all the effects that add something.

    Raises
    ------
    DynidentError
        Where nothing would be added, or the recordings are not those of the model.
    """
    new = tuple(choice for choice in added if choice not in identification.choices.effects)
    if not new:
        raise DynidentError("all of these effects are already in the model", pointer="/effects", title="Nothing to add")
    check_choices(new, identification.model.robot)
    check_recordings(identification.model.robot, recordings, validation)
    check_temperature(new, recordings, validation)
    check_runs(new, recordings, validation)
    # The ladder compares models, so all its models have to be fitted to the same samples.
    check_same_recordings(identification, recordings)
    if are_poses(recordings, validation):
        return _extend_at_rest(identification, new, recordings, validation)
    # One step for each effect, so that each step of the ladder shows what its effect is worth.
    grown, idle, done = identification, [], 0
    while done < len(new):
        together = _list_for_one_pass(grown, new[done:], validation)
        count = max(len(together), 1)
        step_progress = scale_progress(progress, done / len(new), (done + count) / len(new))
        if together:
            larger, useless, count = _add_together(grown, together, recordings, validation, step_progress)
            idle += useless
        else:
            larger = _add_effect(grown, new[done], recordings, validation, step_progress)
            idle += [] if larger is not None else [new[done].effect]
        grown = larger or grown
        done += count
    # Nothing was added by any of them: an error, since the user would look for a new model.
    if grown is identification:
        raise DynidentError(
            f"{', '.join(idle)} adds nothing: its columns are combinations of those in the model",
            pointer="/effects",
            title="Nothing to add",
        )
    # Once at the end: hashing the samples reads all recordings.
    grown = add_digests(grown, recordings, validation)
    if not idle:
        return grown
    left_out = f"{', '.join(idle)} added nothing to the other effects and was left out."
    return grown.with_changes(warnings=defer(lambda: (*grown.warnings, left_out)))


def extend_at_once(
    identification: Identification,
    added: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    progress: Progress = ignore_progress,
) -> Identification:
    """Add several effects, whose shape constants are known, as one step of the ladder.

    Parameters
    ----------
    identification : Identification
        The identified model.
    added : sequence of EffectChoice
        Effects with values for all shape constants.
    recordings : sequence of Recording
        Those that the model was identified from.
    validation : sequence of Recording
        Held-out recordings, if any.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    Identification
        The model with all of the effects.

    Raises
    ------
    DynidentError
        Where they add nothing, or not all of it is determined.
    """
    grown = _identify_with_effects(identification, tuple(added), recordings, validation, progress)
    if grown is None:
        raise DynidentError("the columns of these effects are combinations of those in the model", pointer="/effects")
    return grown


def _extend_at_rest(
    identification: Identification,
    new: tuple[EffectChoice, ...],
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
) -> Identification:
    """Return a model of poses with more effects, as one step.

    Raises
    ------
    DynidentError
        Where one of them does not act at rest.
    """
    in_motion = [choice.effect for choice in new if choice.effect not in ACTING_AT_REST]
    if in_motion:
        raise DynidentError(
            f"{', '.join(in_motion)} cannot be identified from poses at rest, which show only "
            f"{', '.join(ACTING_AT_REST)}",
            pointer="/effects",
            title="Nothing to add",
        )
    choices = replace(identification.choices, effects=identification.choices.effects + new)
    robot = identification.model.robot
    choices, lost = choices.move_known(
        identification.model, build_model_at_rest(robot, choices.effects, choices.tolerance)
    )
    grown = identify_poses(robot, recordings, validation, choices).with_warnings(lost)
    return grown.with_changes(step=LadderStep(identification, added=new))


def _list_for_one_pass(
    identification: Identification, added: Sequence[EffectChoice], validation: Sequence[Recording]
) -> tuple[EffectChoice, ...]:
    """Return the first effects, as far as one fit does for all: none depends on a fit with others."""
    choices = identification.choices
    if not (choices.model == "dynamic" and choices.solver.from_reduced and choices.plan.from_reduced):
        return ()
    # Loads that are in the model already are predicted with its parameters, and these change with every effect.
    if identification.model.needs_load:
        return ()
    return tuple(
        takewhile(
            lambda choice: (
                not (
                    lacks_shape(choice)
                    or get_effect(choice.effect).first_order
                    or needs_search_in_held_out_runs(choice, validation)
                )
            ),
            added,
        )
    )


def _add_together(
    identification: Identification,
    added: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> tuple[Identification | None, list[str], int]:
    """Add effects in one fit, one step each: the steps before the last have its leading columns.

    These are solved when somebody looks at them.

    Returns
    -------
    Identification or None, list of str, int
        The largest model, None where nothing was added; effects that add nothing; and how many effects were looked at.
        Those that would take other instants out of the rows are left for another fit.
    """
    tolerance = identification.choices.tolerance
    steps: list[tuple[EffectChoice, Model]] = []
    idle, count = [], 0
    for choice in added:
        before = steps[-1][1] if steps else identification.model
        model = extend_model(before, (choice,), tolerance=tolerance)
        if model.n_parameters == before.n_parameters:
            idle.append(choice.effect)
        elif steps and not have_same_instants(before.observation, model.observation):
            break
        else:
            steps.append((choice, model))
        count += 1
    if not steps:
        return None, idle, count
    effects = [*accumulate(((choice,) for choice, _ in steps), initial=identification.choices.effects)][1:]
    choices = [
        replace(identification.choices, effects=each).move_known(identification.model, model)
        for each, (_, model) in zip(effects, steps, strict=True)
    ]
    largest = steps[-1][1]
    share = 0.5 * count / len(added) if largest.needs_load else 0.0
    predicted = identification.estimate.reference
    if largest.needs_load:
        new = tuple(choice for choice, _ in steps)
        predicted = _predict_loads(identification, new, recordings, scale_progress(progress, 0.0, share))
    grown = identify_model(
        largest,
        recordings,
        validation,
        choices[-1][0],
        identification.preprocessing,
        predicted,
        scale_progress(progress, share, count / len(added)),
        identification.in_memory,
    )
    inputs = RegressorInputs(split_friction_tests(recordings)[0], identification.preprocessing, predicted)

    def solve_step(number: int) -> Identification:
        """Return the model of a step, with all models below it."""
        choice, model = steps[number]
        if model is largest:
            larger = grown
        else:
            leading = np.eye(largest.n_parameters, model.n_parameters)
            # Shape constants are linearised about the step's own parameters.
            shaped = partial(reduce_with_shapes, model, inputs=inputs, known=identification.in_memory.training)
            larger = solve_submodel(grown, model, choices[number][0], leading, shaped)
        below = defer(partial(solve_step, number - 1)) if number else identification
        step = _add_step(larger.with_warnings(choices[number][1]), LadderStep(below, added=(choice,)))
        # Without shape constants no step reads a recording, and neither does one below it.
        if list_shape_variables(model.effects) and is_read_again(recordings, grown.in_memory.training):
            _ = step.step.parent, step.data.shaped
        return step

    return solve_step(len(steps) - 1), idle, count


def _predict_loads(
    identification: Identification, added: Sequence[EffectChoice], recordings: Sequence[Recording], progress: Progress
) -> ReferenceParameters:
    """Return what loads are predicted with, as in an identification from scratch.

    These are least squares of the model with all added effects but those that need a load.
    """
    choices, model, equations = identification.choices, identification.model, identification.data.equations
    plain = tuple(choice for choice in added if not get_effect(choice.effect).needs_load)
    if plain:
        model = extend_model(model, plain, tolerance=choices.tolerance)
        ordinary, _ = split_friction_tests(recordings)
        inputs = RegressorInputs(ordinary, identification.preprocessing, identification.estimate.reference)
        equations = reduce_without_rest(model.observation, inputs, progress, identification.in_memory.training)
    return solve_for_reference(model, choices, equations)


def _add_effect(
    identification: Identification,
    added: EffectChoice,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> Identification | None:
    """Add one effect; None where its columns are combinations of those that the model has."""
    new = complete_shapes(
        identification.model,
        (added,),
        RegressorInputs(
            split_friction_tests(recordings)[0], identification.preprocessing, identification.estimate.next_reference()
        ),
        scale_progress(progress, 0.0, 0.5),
        identification.in_memory.training,
    )
    looked_for = any(needs_search_in_held_out_runs(choice, validation) for choice in new)
    fit_progress = scale_progress(progress, 0.5, 0.75 if looked_for else 1.0)
    grown = _identify_with_effects(identification, new, recordings, validation, fit_progress)
    if grown is None or not looked_for:
        return grown
    # A first fit leaves the effect out of the held-out runs. Where it shows in some of them it is fitted once more,
    # so that the held-out error is not that of a missing load.
    findings = find_runs_with_effects(grown, identification.model, new, validation)
    if not findings:
        return grown
    more = tuple(finding.run for finding in findings)
    carried = tuple(replace(choice, runs=choice.runs + more) if choice.runs else choice for choice in new)
    last_progress = scale_progress(progress, 0.75, 1.0)
    carried_by = _identify_with_effects(identification, carried, recordings, validation, last_progress)
    if carried_by is None:
        return None
    sentence = describe_runs_with_effects(new, findings)
    return carried_by.with_changes(warnings=defer(lambda: (sentence, *carried_by.warnings)))


def _identify_with_effects(
    identification: Identification,
    new: tuple[EffectChoice, ...],
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> Identification | None:
    choices = replace(identification.choices, effects=identification.choices.effects + new)
    model = extend_model(identification.model, new, tolerance=choices.tolerance)
    # All new columns were absorbed, so there is nothing to estimate.
    if model.n_parameters == identification.model.n_parameters:
        return None
    choices, lost = choices.move_known(identification.model, model)
    reference = identification.estimate.reference
    if model.needs_load:
        reference = identification.estimate.next_reference()
    # The plain model's parameters made up for what was missing; columns of the predicted torque, and of the load that
    # others change, are better about the new ones.
    loads_change = model.needs_load and (len(new) > 1 or identification.model.needs_load)
    again = loads_change or any(get_effect(choice.effect).first_order for choice in new)
    passes = 2 if again else 1
    for number in range(passes):
        grown = identify_model(
            model,
            recordings,
            validation,
            choices,
            identification.preprocessing,
            reference,
            scale_progress(progress, number / passes, (number + 1) / passes),
            identification.in_memory,
        )
        # The second pass predicts loads with the parameters of the first.
        reference = grown.estimate.next_reference()
    return _add_step(grown.with_warnings(lost), LadderStep(identification, added=new))


def _add_step(identified: Identification, step: LadderStep) -> Identification:
    """Return a larger model as a step of a ladder, with what is said of the step."""
    larger = identified.with_changes(step=step)
    return larger.with_changes(warnings=defer(lambda: list_addition_warnings(larger) + larger.warnings))
