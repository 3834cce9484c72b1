"""`identify`: from recordings and choices to a model; narrows filters where the fit is poor.

Holds from which error on (20 %), and when a motion is too slow.

A soft joint or a belt between encoder and link, and a clock with jitter, spoil accelerations above some frequency. A
spectrum cannot tell that from motion. A model can: it explains the torque below that frequency and not above it.

Later steps check here that the recordings are those that the model was identified from.

Motions that are too slow to show inertia are recognised here: slow sweeps identify gravity and friction.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor, log10

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import LINKS, EffectChoice, ReferenceParameters, get_effect
from dynident.errors import DynidentError
from dynident.estimation import EstimationError, Reduction, estimate_group_weights, solve_weighted
from dynident.estimation.residual_errors import compute_fitted_errors
from dynident.identification.description_prior import build_prior, check_known
from dynident.identification.equations.filtered_energy_power_wrench import find_constants
from dynident.identification.equations.model_and_data_checks import (
    check_joint_torques,
    check_recordings,
    check_reduction,
    check_runs,
    check_temperature,
    describe_other_masses,
)
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.identification.identification_choices import IdentificationChoices
from dynident.identification.identified_models.fit_model import FIRST_MOMENT, identify_model
from dynident.identification.identified_models.gravity_from_poses import are_poses, identify_poses
from dynident.identification.identified_models.identification_result import Identification
from dynident.identification.identified_models.other_conditions import describe_temperatures
from dynident.identification.shape_search import check_choices, complete_shapes, lacks_shape
from dynident.number_format import format_percent
from dynident.parallel import defer, single_threaded
from dynident.progress import Progress, ignore_progress, make_monotonic, scale_progress
from dynident.recordings import Preprocessing, Recording, choose_preprocessing
from dynident.recordings.preprocessing import OVERSAMPLING
from dynident.recordings.raw_signals import SampleHashes, find_copied_recordings
from dynident.recordings.signal_spectra import estimate_spectra
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import Model, get_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot.robot_model import Robot


def add_digests(
    identification: Identification, recordings: Sequence[Recording], validation: Sequence[Recording]
) -> Identification:
    """Return the model with the digests of its samples, and with the names of validation data that hold some of them.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings, validation : sequence of Recording
        Data of the fit, and held-out data.

    Returns
    -------
    Identification
        The same model, whose data know their samples.
    """
    hashes = [SampleHashes.from_recording(recording) for recording in recordings]
    digests = tuple(own.digest for own in hashes)
    copied = find_copied_recordings(hashes, validation)
    known = identification.with_changes(data=identification.data.with_changes(digests=digests, copied=copied))
    if not copied:
        return known
    sentence = f"The held-out error says nothing: {', '.join(copied)} has samples of the fit. Hold out another motion."
    return known.with_changes(warnings=defer(lambda: (sentence, *identification.warnings)))


def check_same_recordings(identification: Identification, recordings: Sequence[Recording]) -> None:
    """Raise where recordings hold other samples than those that a model was identified from, as far as it knows.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Recordings that are said to be those of the fit.

    Raises
    ------
    DynidentError
        Names the recordings that are others, and those of the model.
    """
    # Samples are compared by their hashes, so that a renamed or copied file still counts as the same recording.
    known = Counter(identification.data.digests)
    if not known:
        return  # identified by a version that did not note them, or from poses
    digests = [(recording.name, SampleHashes.from_recording(recording).digest) for recording in recordings]
    others = [name for name, digest in digests if digest not in known]
    # As often as in the fit: one recording twice would count double.
    if not others and Counter(digest for _, digest in digests) == known:
        return
    names = ", ".join(identification.data.measurement_names)
    difference = (
        f"{', '.join(others)} {'holds' if len(others) == 1 else 'hold'} other samples" if others else "some are missing"
    )
    raise DynidentError(
        f"these are not the recordings that the model was identified from ({names}): {difference}. Give the same "
        "files, read in the same way: the same windows, columns, units, gains and skipped steps. For other or more "
        "data identify a new model with the same choices.",
        pointer="/recordings",
        title="Other recordings",
    )


POOR_FIT = 0.2
"""Share of the torque left by the fit from which on a narrower band is looked for: rigid arms with all their friction
leave 3 to 15 %, so that their filters stay as their motion and noise ask for."""

_FREQUENCIES = 4001

_NARROWEST = 4.0
"""Hz, at least: a filter below it smears a quarter of a second to either side of a reversal, so that of a joint that
swings at 1 Hz hardly a row is left where it moves."""

_BETTER = 0.7
"""Share of the error that may be left: a band in which the model is wrong as well is no better one."""


def find_narrower_band(
    identification: Identification, recordings: Sequence[Recording]
) -> tuple[Preprocessing, str] | None:
    """Find narrower filters where the model explains the torque below some frequency and not above it.

    Parameters
    ----------
    identification : Identification
        With the filters that were chosen from the motion and its noise.
    recordings : sequence of Recording
        What it was identified from.

    Returns
    -------
    tuple of Preprocessing and str, or None
        The filters and a sentence about them; None where the fit is good enough, or no better in a narrower band.
    """
    chosen = identification.preprocessing
    if (
        identification.fit.relative_total <= POOR_FIT
        or chosen.torque_cutoff is None
        or not identification.choices.rows.by_joint
    ):
        return None
    reference = identification.estimate.reference
    # Halve the cut-off until nothing narrower is sensible: about five candidates, a few passes over the data each.
    bands = [chosen]
    while (bands[-1].torque_cutoff or 0.0) / 2.0 >= _NARROWEST:
        bands.append(_lower_cutoffs(chosen, (bands[-1].torque_cutoff or 0.0) / 2.0, recordings))
    torque = _TorqueSpectrum.from_recordings(recordings)
    errors = {band: _compute_error(identification, recordings, band, reference) for band in bands}
    # A lower cut-off always leaves a smaller share of the torque below it. So the torque above the cut-off counts as
    # missed, which makes errors at different cut-offs comparable.
    best = min(errors, key=lambda band: torque.measure_missed(band, errors[band]))
    # Refine by half an octave to both sides of the best octave.
    for factor in (2.0**0.5, 0.5**0.5):
        cutoff = (best.torque_cutoff or 0.0) * factor
        if _NARROWEST <= cutoff < chosen.torque_cutoff:
            near = _lower_cutoffs(chosen, cutoff, recordings)
            errors[near] = _compute_error(identification, recordings, near, reference)
    narrow = min(errors, key=lambda band: torque.measure_missed(band, errors[band]))
    share_left, before = errors[narrow], errors[chosen]
    if narrow == chosen or share_left > _BETTER * before:
        return None
    why = (
        f"Below {narrow.torque_cutoff:g} Hz the model leaves {format_percent(share_left, decimals=0)} of the torque "
        f"unexplained, but {format_percent(before, decimals=0)} up to {chosen.torque_cutoff:g} Hz: a joint or a belt "
        f"is flexible, or the clock has jitter. The model is identified below {narrow.torque_cutoff:g} Hz."
    )
    return replace(narrow, reasons=(why, *narrow.reasons)), why


def _lower_cutoffs(chosen: Preprocessing, cutoff: float, recordings: Sequence[Recording]) -> Preprocessing:
    """Return the filters with lower cut-offs, rounded to two digits, and the decimation that goes with them."""
    # Two digits: the error hardly differs between neighbouring cut-offs.
    digits = 1 - floor(log10(cutoff))
    cutoff = round(cutoff, digits)
    rate = min(recording.sampling_rate for recording in recordings)
    decimation = max(1, floor(rate / (OVERSAMPLING * cutoff)))
    return Preprocessing(cutoff, cutoff, decimation, chosen.filter_order)


def _compute_error(
    identification: Identification, recordings: Sequence[Recording], band: Preprocessing, reference: ReferenceParameters
) -> float:
    """Return the share of the torque below the cut-off that the model leaves; 1 where it is not determined."""
    reduction = reduce_recordings(identification.model.observation, RegressorInputs(recordings, band, reference))
    try:
        return compute_fitted_errors(reduction, solve_weighted(reduction).values).relative_total
    # In a band without motion the parameters are not determined: nothing is explained.
    except EstimationError:
        return 1.0


@dataclass(frozen=True, eq=False)
class _TorqueSpectrum:
    """Spectrum of the squared torque of all joints.

    `total` is its mean over the recordings, `power` (k,) the part of it at each `frequency` (k,).
    """

    frequency: FloatArray
    power: FloatArray
    total: float

    @classmethod
    def from_recordings(cls, recordings: Sequence[Recording]) -> _TorqueSpectrum:
        """Return the mean spectrum of all recordings, each weighted by its number of samples."""
        frequency = np.linspace(0.0, 0.5 * max(recording.sampling_rate for recording in recordings), _FREQUENCIES)
        power, total, count = np.zeros(_FREQUENCIES), 0.0, sum(recording.n_samples for recording in recordings)
        for recording in recordings:
            share, spectrum = recording.n_samples / count, estimate_spectra(recording)
            power += share * np.interp(frequency, spectrum.frequency, spectrum.torque.sum(axis=1), right=0.0)
            total += share * spectrum.torque_squared
        return cls(frequency, power * float(frequency[1]), total)

    def measure_missed(self, band: Preprocessing, error: float) -> float:
        """Return the mean squared torque that a model misses: what it leaves below the cut-off, and all above it."""
        # What is above the cut-off is not fitted at all, and counts as missed in full.
        above = float(self.power[self.frequency > (band.torque_cutoff or np.inf)].sum())
        return error**2 * max(self.total - above, 0.0) + above


def prepare_effects(
    robot: Robot,
    choices: IdentificationChoices,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    progress: Progress,
) -> tuple[tuple[EffectChoice, ...], ReferenceParameters]:
    """Return the effects with every shape constant found, and what torque is predicted with.

    Both come from a first fit without the effects that need them.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    choices : IdentificationChoices
        Options of the identification; their effects are completed.
    recordings : sequence of Recording
        Data of the fit, without tests of single joints' friction.
    preprocessing : Preprocessing
        Filters of the recordings.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    tuple of effects and ReferenceParameters
        The effects, and the parameters that loads are predicted with.

    Raises
    ------
    DynidentError
        Where such effects stand alone, or the data do not determine the first fit.
    """
    effects = choices.effects
    plain = tuple(c for c in effects if not get_effect(c.effect).needs_load and not lacks_shape(c))
    if len(plain) == len(effects):
        return effects, ReferenceParameters.massless(robot)
    if not any(choice.effect == LINKS.effect for choice in plain):
        raise DynidentError(
            "effects that depend on the load, or whose shape constants are searched for, also need rigid_body",
            pointer="/effects",
        )
    # The first model leaves out what it cannot know yet. Its parameters absorb part of that, which is good enough to
    # predict loads and to compare shape constants.
    first = get_model(robot, plain, tolerance=choices.tolerance)
    nothing = ReferenceParameters.massless(robot)
    reduction = reduce_recordings(
        first.observation,
        RegressorInputs(recordings, preprocessing, nothing),
        scale_progress(progress, 0.0, 0.5),
        by_phase=True,
    )
    reference = solve_for_reference(first, choices, reduction)
    # Their constants are searched beside the first model, with loads that it predicts.
    others = tuple(choice for choice in effects if choice not in plain)
    completed = complete_shapes(
        first, others, RegressorInputs(recordings, preprocessing, reference), scale_progress(progress, 0.5, 1.0)
    )
    return plain + completed, reference


def solve_for_reference(model: Model, choices: IdentificationChoices, reduction: Reduction) -> ReferenceParameters:
    """Solve for what loads are predicted with, by least squares of a model without the effects that need loads.

    Parameters
    ----------
    model : Model
        The model without these effects.
    choices : IdentificationChoices
        Options of the identification.
    reduction : Reduction
        The joints' torques in the model's columns.

    Returns
    -------
    ReferenceParameters
        The parameters, as those of robot and motors.

    Raises
    ------
    DynidentError
        Where the data do not determine them.
    """
    prior = build_prior(model, choices.trust)
    check_reduction(model, reduction, prior)
    if choices.weighs_turns:
        reduction = reduction.weight_groups(estimate_group_weights(reduction, prior))
    return model.build_reference(solve_weighted(reduction, prior).values)


def mark_unrecorded_torques(robot: Robot, recordings: Sequence[Recording]) -> Robot:
    """Return the robot with the joints marked for which no recording has the torque.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    recordings : sequence of Recording
        Data of the fit.

    Returns
    -------
    Robot
        The robot itself where all torques were recorded.
    """
    recorded = np.any([recording.has_torque for recording in recordings], axis=0)
    names = tuple(name for name, known in zip(robot.joint_names, recorded, strict=True) if not known)
    return replace(robot, joints_without_torque=names) if names != robot.joints_without_torque else robot


@single_threaded
def identify(
    robot: Robot,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    choices: IdentificationChoices | None = None,
    progress: Progress = ignore_progress,
) -> Identification:
    """Identify the base parameters of a robot from recordings.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    recordings : sequence of Recording
        The data that parameters are fitted to; those with the role "friction" are tests of single joints, which the
        strategy separate_friction alone uses.
    validation : sequence of Recording
        Data that no parameter sees; the held-out errors come from them.
    choices : IdentificationChoices, optional
        Equation type, strategy, estimator, prior, filters and effects; the usual ones by default.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    Identification
        The identified model, with warnings about what is doubtful in it.

    Raises
    ------
    DynidentError
        Where the choices do not fit the robot or the data do not determine the parameters.
    """
    progress = make_monotonic(progress)  # a narrower band is identified in once more
    requested = choices = choices or IdentificationChoices()
    # All checks that need no numerics come first, so that a mistake shows at once.
    check_recordings(robot, recordings, validation)
    check_choices(choices.effects, robot)
    if are_poses(recordings, validation):
        return identify_poses(robot, recordings, validation, requested)
    check_temperature(choices.effects, recordings, validation)
    check_runs(choices.effects, recordings, validation)
    ordinary, _ = split_friction_tests(recordings)
    check_joint_torques(robot, choices.model, ordinary)
    # Equations of joints without a torque are left out; their motion is still used.
    robot = mark_unrecorded_torques(robot, ordinary)
    preprocessing = choices.preprocessing or choose_preprocessing(ordinary)
    rows, preprocessing = find_constants(choices.row_options, ordinary, preprocessing)
    effects, reference = prepare_effects(robot, choices, ordinary, preprocessing, scale_progress(progress, 0.0, 0.5))
    choices = replace(choices, effects=effects, pole=rows.pole, interval=rows.interval)
    model = get_model(robot, choices.effects, tolerance=choices.tolerance)
    check_known(model, choices.known)
    fit_progress = scale_progress(progress, 0.5, 1.0)
    identified = identify_model(model, recordings, validation, choices, preprocessing, reference, fit_progress)
    return complete_identification(robot, recordings, validation, requested, identified, progress)


def complete_identification(
    robot: Robot,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    requested: IdentificationChoices,
    identified: Identification,
    progress: Progress = ignore_progress,
) -> Identification:
    """Narrow the filters of a fit where that is needed, and add what is said of slow motions and of the samples.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    recordings, validation : sequence of Recording
        Data of the fit, and held-out data.
    requested : IdentificationChoices
        The choices as they were made, with what was left open.
    identified : Identification
        The model with the filters that were chosen from the data.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    Identification
        The final model.
    """
    ordinary, _ = split_friction_tests(recordings)
    # Whether the filters let in torque that no rigid model explains shows only after a fit. Filters that the user
    # gave are not changed.
    narrow = None if requested.preprocessing else find_narrower_band(identified, ordinary)
    if narrow is not None:
        band, why = narrow
        narrowed = identify(robot, recordings, validation, replace(requested, preprocessing=band), progress)
        return narrowed.with_changes(warnings=defer(lambda: (why, *narrowed.warnings)))
    warmth = describe_temperatures(ordinary, validation)
    warnings = defer(lambda: (*warmth, *identified.warnings, *_warn_of_masses(identified)))
    return add_digests(identified.with_changes(warnings=warnings), recordings, validation)


def _warn_of_masses(identified: Identification) -> tuple[str, ...]:
    shown = [one.unit == FIRST_MOMENT and one.judgement == "determined" for one in identified.parameters]
    return describe_other_masses(identified.model, identified.values, np.array(shown))
