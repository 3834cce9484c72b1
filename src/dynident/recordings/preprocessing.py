"""Choose cut-offs, filter order and decimation from the data, or take them from a request.

Holds the rules of the automatic choice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from math import floor, log10
from weakref import WeakKeyDictionary

import numpy as np
from scipy import special

from dynident.array_types import BoolArray, FloatArray
from dynident.recordings.pose_recordings import has_poses
from dynident.recordings.recording import Recording, count_base_coordinates
from dynident.recordings.recording_metadata import Filters, RecordingError
from dynident.recordings.signal_spectra import Spectra, estimate_spectra

MOTION_SHARE = 0.99
"""The band of the motion holds so much of the velocity's power."""

HARMONICS = 15.0
"""Cut-off over the band of the motion: products of joint motions and the corners of friction are its harmonics."""

NOISE_SHARE = 0.05
"""Position noise may be so large in the acceleration, beside the motion's own."""

LEAST_HARMONICS = 4.0
"""However large the noise, so many harmonics of the motion are kept."""

WIDER, WIDER_NOISE_SHARE = 1.4, 0.01
"""The position cut-off over the torque's, where noise is so small a share of the acceleration even there. What the
filter of the positions takes away below the torque's cut-off lacks in velocities, while the torque has it: half of it
at the cut-off itself, or 6 % where theirs lies half an octave higher."""

ACCELERATION = 3.0
"""Cut-off of the acceleration over the torque's, unless the sampling rate allows less. The parallel filter stops at 1.5
times its cut-off, where one of three times takes away 0.4 %. With the filter of the positions, inertias of a virtual
SCARA come out 0.4 % too large."""

NYQUIST_SHARE = 0.7
"""A cut-off nearer to the Nyquist frequency filters nothing."""

OVERSAMPLING = 4.0
"""Rows are decimated to no less than so many times the torque cut-off."""

SUNK = 3.0
"""Times the noise below which nothing of the motion is left at a frequency."""

LINES_APART = 3.0
"""Two harmonics of a periodic motion may be missing between two that are there."""

CREEPING = 1e-2
"""A joint whose velocity is below this share of the fastest joint's may vibrate more than it moves: what lies beyond a
gap in its spectrum is no line of the motion."""

MOVING = 1e-3
"""A joint whose velocity is below this share of the fastest joint's does not count."""


@dataclass(frozen=True)
class _Bands:
    """What one recording says, in Hz: the band of its motion, the cut-off at which noise takes over."""

    motion: float
    noise: float
    noise_rms: float
    little_noise: float
    """Up to here noise is a small share yet."""
    power: float
    """Mean square of the velocity of all of them that move, in their bands."""
    of_base: bool = False


def choose_preprocessing(recordings: Sequence[Recording]) -> Preprocessing:
    """Choose cut-off frequencies and decimation for recordings that are identified together ("auto").

    The torque cut-off is 15 times the band that holds 99 % of the velocity's power (the median over the joints that
    move, the widest of the recordings), but no more than the frequency up to which differentiating the position noise
    (encoder quantisation, mostly) twice stays below 5 % of the motion's own acceleration: what is above it cannot be
    explained by filtered positions. Theirs lies half an octave higher, as far as that share stays below 1 % there. Rows
    are decimated to no less than 4 times the torque cut-off. For a base that moves at 5 % of the joints' speed or more
    the same is chosen from its own coordinates. The lower cut-offs count, but none below the joints' motion.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings that are identified together.

    Returns
    -------
    Preprocessing
        With the reasons for its values.

    Raises
    ------
    DynidentError
        If a recording is too short to have a spectrum.
    """
    if not recordings:
        raise ValueError("give recordings: the filters are chosen from them")
    if all(has_poses(recording) for recording in recordings):
        return Preprocessing(None, None, 1, reasons=("The recordings are poses at rest: no filter is used.",))
    rate = min(recording.sampling_rate for recording in recordings)
    all_bands = [bands for recording in recordings for bands in _load_bands(recording)]
    by_kind = ([bands for bands in all_bands if bands.of_base == of_base] for of_base in (False, True))
    groups = [group for group in by_kind if group]
    # The noise of a base that moves is in the equations of all joints, times the mass of the robot.
    choices = [_choose_cutoffs(group, rate) for group in groups]
    widest = min(choice.position_cutoff or np.inf for choice in choices)
    group = groups[int(np.argmin([choice.torque_cutoff or 0.0 for choice in choices]))]
    return _choose_cutoffs(group, rate, widest)


def _choose_cutoffs(all_bands: Sequence[_Bands], rate: float, widest: float = np.inf) -> Preprocessing:
    """Choose the filters for the bands of several recordings, of their joints or of the base.

    The position cut-off is at most `widest` Hz, unless the torque's is higher.
    """
    motion = max(bands.motion for bands in all_bands)
    noisiest = min(all_bands, key=lambda bands: bands.noise)
    needed, ceiling = HARMONICS * motion, NYQUIST_SHARE * 0.5 * rate
    # In this order: what the motion needs, but no more than noise allows, except for the least number of harmonics,
    # and never beyond the Nyquist frequency. The pose of a base has far more noise than encoders: of it, the band of
    # its own motion is enough.
    least = motion if noisiest.of_base else LEAST_HARMONICS * motion
    cutoff = _round_down(min(needed, max(noisiest.noise, least), ceiling))
    wider = min(WIDER * needed, min(bands.little_noise for bands in all_bands), ceiling, widest)
    position = max(cutoff, _round_down(wider))
    first = "Torque" if position > cutoff else "Position"
    of_base = " of the base" if noisiest.of_base else ""
    because = (
        f"{first} cut-off {cutoff:g} Hz: the motion{of_base} lies below {motion:.2g} Hz (99 % of the velocity's power)"
    )
    if needed <= min(noisiest.noise, ceiling):
        because += f"; {HARMONICS:g} times this frequency keeps products of velocities and the steps of friction."
    elif noisiest.noise < ceiling:
        unit = "m or rad" if noisiest.of_base else "rad"
        because += (
            f"; above {noisiest.noise:.2g} Hz the position noise of {noisiest.noise_rms:.2g} {unit} rms, "
            "differentiated twice, would exceed 5 % of the acceleration."
        )
    else:
        because += f"; the sampling rate of {rate:.4g} Hz has no useful signal above {ceiling:.3g} Hz."
    # The reason for the position's cut-off stands first, that for the torque's second.
    if position > cutoff:
        reasons = (_explain_position_cutoff(position), because)
    else:
        reasons = (because, _explain_torque_cutoff(cutoff))
    return _add_decimation(Preprocessing(position, cutoff, 1, 4, reasons), rate)


def find_motion_band(recordings: Sequence[Recording]) -> float:
    """Return the frequency below which 99 % of the velocity's power lies, as `choose_preprocessing` finds it.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings that are identified together.

    Returns
    -------
    float
        Hz, the highest of the recordings.

    Raises
    ------
    DynidentError
        If a recording is too short to have a spectrum.
    """
    return max(bands.motion for recording in recordings for bands in _load_bands(recording))


def preprocessing_from_request(
    request: Filters | Mapping[str, object] | str | None, recordings: Sequence[Recording]
) -> Preprocessing:
    """Return the preprocessing that a user asked for; what the user left open is chosen from the data.

    Parameters
    ----------
    request : Filters, mapping, "auto" or None
        Any of position_cutoff, torque_cutoff, decimation, filter_order; "auto" or None leave all open.
    recordings : sequence of Recording
        Recordings that are identified together.

    Returns
    -------
    Preprocessing
        All four values, with the reasons for those that were chosen.

    Raises
    ------
    RecordingError
        For a value that is impossible: names the Nyquist frequency, and points to "/preprocessing/…".
    """
    rate = min(recording.sampling_rate for recording in recordings)
    stated = asdict(request) if isinstance(request, Filters) else request
    fields = {} if stated is None or stated == "auto" else values_from_request(stated)
    if not fields:
        return choose_preprocessing(recordings)
    if "position_cutoff" in fields and "torque_cutoff" in fields:
        preprocessing = Preprocessing(_read_cutoff(fields, "position_cutoff"), _read_cutoff(fields, "torque_cutoff"))
    else:
        automatic = choose_preprocessing(recordings)
        position = _read_cutoff(fields, "position_cutoff") if "position_cutoff" in fields else automatic.position_cutoff
        if "torque_cutoff" in fields:
            torque = _read_cutoff(fields, "torque_cutoff")
        else:
            # Torque is worth no more than the positions that have to explain it.
            torque = automatic.torque_cutoff if position is None else min(position, NYQUIST_SHARE * 0.5 * rate)
        # Only what was left open was chosen for these reasons; that of the decimation is found anew below.
        chosen = automatic.reasons[: 1 if "torque_cutoff" in fields else 2]
        reasons = (_explain_torque_cutoff(torque),) if "position_cutoff" in fields else chosen
        preprocessing = Preprocessing(position, torque, reasons=reasons)
    preprocessing = replace(
        preprocessing, filter_order=int(fields.get("filter_order", preprocessing.filter_order) or 0)
    )
    if "decimation" in fields:
        preprocessing = replace(preprocessing, decimation=int(fields["decimation"] or 0))
    else:
        # The cut-offs have to be possible at this rate before a decimation is computed from them.
        preprocessing.check_against(rate)
        preprocessing = _add_decimation(preprocessing, rate)
    named = ", ".join(f"{name} {value:g}" if value is not None else f"no {name}" for name, value in fields.items())
    preprocessing = replace(preprocessing, reasons=(*preprocessing.reasons, f"Given by the request: {named}."))
    preprocessing.check_against(rate)
    return preprocessing


def _read_cutoff(fields: Mapping[str, float | int | None], name: str) -> float | None:
    value = fields[name]
    return None if value is None else float(value)


def _add_decimation(preprocessing: Preprocessing, rate: float) -> Preprocessing:
    if preprocessing.torque_cutoff is None:
        return preprocessing
    decimation = max(1, floor(rate / (OVERSAMPLING * preprocessing.torque_cutoff)))
    ratio = rate / decimation / preprocessing.torque_cutoff
    because = (
        f"Decimation by {decimation}, to {rate / decimation:.3g} Hz, {ratio:.2g} times the torque cut-off: rows that "
        "are closer together add no information."
    )
    return replace(preprocessing, decimation=decimation, reasons=(*preprocessing.reasons, because))


def _explain_position_cutoff(cutoff: float) -> str:
    return (
        f"Position cut-off {cutoff:g} Hz: higher than the torque cut-off, so that this filter removes little of the "
        "motion that explains the torque."
    )


def _explain_torque_cutoff(cutoff: float | None) -> str:
    if cutoff is None:
        return "No parallel filter, as requested."
    return f"Torque cut-off {cutoff:g} Hz, the same as for the positions: they cannot explain torque above it."


_known: WeakKeyDictionary[Recording, list[_Bands]] = WeakKeyDictionary()


def _load_bands(recording: Recording) -> list[_Bands]:
    """Return the bands of a recording's joints, and those of a base that moves, computed once.

    Its spectra take as long as reading it.
    """
    if recording not in _known:
        averages = estimate_spectra(recording)
        is_base = np.arange(recording.n) < count_base_coordinates(recording.joint_names)
        joints, base = (_find_bands(averages, is_base == of_base, of_base) for of_base in (False, True))
        if joints is not None and base is not None:
            # A base that moves less than noise may says nothing. The filter of any other leaves the joints' motion.
            is_negligible = base.power < NOISE_SHARE**2 * joints.power
            base = None if is_negligible else replace(base, motion=max(base.motion, joints.motion))
        _known[recording] = [own for own in (joints, base) if own is not None]
        if not _known[recording]:
            raise RecordingError(
                "No joint moves in the windows of the recording, so the filters cannot be chosen. Choose windows with "
                "motion, or give the cut-off frequencies.",
                pointer="/preprocessing",
                title="No motion",
            )
    return _known[recording]


def _find_bands(averages: Spectra, group: BoolArray, of_base: bool) -> _Bands | None:
    """Return the bands of a group of joints (n,), or None where none of them moves."""
    if not group.any():
        return None
    averages = replace(averages, velocity=averages.velocity[:, group], noise=averages.noise[group])
    step = averages.frequency[1]
    gain = averages.velocity_gain[:, None]
    noise = averages.noise * gain
    motion: list[float] = []
    limit: list[float] = []
    little: list[float] = []
    squared = 0.0
    # The motion's own power, without that of the noise.
    power = np.maximum(averages.velocity - noise, 0.0)
    moving = np.flatnonzero(power.sum(axis=0) > MOVING**2 * power.sum(axis=0).max())
    # The strongest frequency of all joints stands in for the base frequency of a periodic motion. The lowest three hold
    # what the taper leaks from zero.
    reach = LINES_APART * float(averages.frequency[3:][int(np.argmax(power[3:].sum(axis=1)))])
    slow = power[averages.frequency <= reach].sum(axis=0)
    for joint in moving:
        # Of a joint that hardly moves, lines beyond a gap may be those of vibration.
        own_reach = reach if slow[joint] > CREEPING**2 * slow.max() else 0.0
        band = _find_band_end(
            averages.frequency, averages.velocity[:, joint], noise[:, joint], averages.windows, own_reach
        )
        inside = float(power[:band, joint].sum())
        # The pose of a base that stands is noise.
        if inside <= (SUNK * float(noise[:band, joint].sum()) if of_base else 0.0):
            continue
        squared += step * inside
        below = np.cumsum(power[:band, joint]) / inside
        motion.append(averages.frequency[int(np.searchsorted(below, MOTION_SHARE))])
        # The motion's own acceleration, inside its band: the measure of the noise that follows.
        own = float((power[:band, joint] * gain[:band, 0]).sum())
        # Noise in the acceleration, up to each frequency: its density grows with the fourth power of the frequency.
        spoiled = np.cumsum(noise[:, joint] * gain[:, 0])
        for share, limits in ((NOISE_SHARE, limit), (WIDER_NOISE_SHARE, little)):
            limits.append(averages.frequency[min(int(np.searchsorted(spoiled, share**2 * own)), len(gain) - 1)])
    rms = np.sqrt(averages.noise[moving] * 0.5 * averages.rate)
    if not motion:
        return None
    # The median over the joints: one joint that vibrates, or one coarse encoder, does not decide for all.
    band, noise_at, little_at = (max(float(np.median(frequencies)), step) for frequencies in (motion, limit, little))
    return _Bands(band, noise_at, float(np.median(rms)), little_at, squared, of_base)


def _find_band_end(frequency: FloatArray, power: FloatArray, noise: FloatArray, windows: int, reach: float) -> int:
    """Return the number of frequencies, from 0 on, below which the motion is above the noise.

    A periodic motion is a row of lines a base frequency apart, with noise between them and below the first. A gap is
    therefore crossed where the lines within `reach` (Hz), `LINES_APART` times the frequency of the strongest one, which
    is the base frequency or a multiple of it, hold a share of the power that counts. Vibrations and mains hum lie
    farther from the motion, or hold less.
    """
    first = 3
    # The lowest frequencies hold what the taper leaks from zero.
    sunk = first + np.flatnonzero(power[first:] < SUNK * noise[first:])
    # A mean of so many squared normal pairs exceeds this in one of 10⁵ frequencies of noise alone.
    bar = max(SUNK, float(special.gammainccinv(windows, 1e-5)) / windows)
    risen = first + np.flatnonzero(power[first:] > bar * noise[first:])
    if not len(sunk) or not len(risen):
        return int(sunk[0]) if len(sunk) else len(power)
    own = power - noise
    end = int(sunk[0])
    while True:
        # Cross one gap after another, as long as what lies behind it holds a share of the power that counts.
        lines = risen[(risen > end) & (frequency[risen] <= frequency[end] + reach)]
        if own[lines].sum() <= (1.0 - MOTION_SHARE) * max(own[:end].sum(), 0.0) or not len(lines):
            return end
        after = int(np.searchsorted(sunk, lines[0]))
        if after == len(sunk):
            return len(power)
        end = int(sunk[after])


def _round_down(value: float) -> float:
    """Round down to two significant digits."""
    digits = 1 - floor(log10(value))
    return floor(value * 10**digits + 1e-9) / 10**digits if digits > 0 else float(floor(value))


@dataclass(frozen=True)
class Preprocessing:
    """How positions are filtered and how Y and the columns of W are filtered and decimated together (§12.4).

    Parameters
    ----------
    position_cutoff : float or None
        Cut-off of the zero-phase Butterworth filter on q in Hz; None: no filter. Where it is `WIDER` times
        `torque_cutoff`, the acceleration passes a wider one instead (`find_acceleration_cutoff`).
    torque_cutoff : float or None
        Cut-off of the parallel filter in Hz; None: no filter.
    decimation : int
        Every how many-th row the parallel filter gives.
    filter_order : int
        Order of one pass of the Butterworth filter.
    reasons : tuple of str
        Why these values, a sentence each.
    """

    position_cutoff: float | None
    torque_cutoff: float | None
    decimation: int = 1
    filter_order: int = 4
    reasons: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # Filters that were chosen keep to the ranges of those that are asked for.
        Filters(**{name: getattr(self, name) for name in FIELDS})

    def find_acceleration_cutoff(self, rate: float) -> float | None:
        """Return the cut-off of the acceleration's own filter, Hz; None where it passes that of the positions.

        It has one of its own where the cut-off of the positions is `WIDER` times that of the torque. The automatic
        choice stays below that where noise is more than a small share of the acceleration. A wider filter would let it
        in.

        Parameters
        ----------
        rate : float
            Sampling rate in Hz.
        """
        if self.position_cutoff is None or self.torque_cutoff is None:
            return None
        # Chosen cut-offs are rounded down.
        if self.position_cutoff < _round_down(WIDER * self.torque_cutoff):
            return None
        cutoff = min(ACCELERATION * self.torque_cutoff, NYQUIST_SHARE * 0.5 * rate)
        return cutoff if cutoff > self.position_cutoff else None

    def check_against(self, rate: float) -> None:
        """Raise `RecordingError` where a value is impossible at this sampling rate (Hz)."""
        for name in ("position_cutoff", "torque_cutoff"):
            value = getattr(self, name)
            if value is not None and value >= 0.5 * rate:
                raise _impossible_value_error(
                    name,
                    f"{name} is {value:g} Hz, but the recording is sampled at {rate:.6g} Hz. Give a frequency below "
                    f"{0.5 * rate:.6g} Hz (Nyquist).",
                )
        # What the filter passes has to lie below half of the rate that decimation leaves.
        decimated = rate / self.decimation
        if self.torque_cutoff is not None and self.decimation > 1 and decimated < 2.0 * self.torque_cutoff:
            raise _impossible_value_error(
                "decimation",
                f"Decimation by {self.decimation} leaves {decimated:.4g} Hz, less than twice the torque cut-off of "
                f"{self.torque_cutoff:g} Hz: the rows would be aliased. Decimate by at most "
                f"{max(1, int(rate / (2.0 * self.torque_cutoff)))}.",
            )


FIELDS = tuple(field.name for field in fields(Filters))


def values_from_request(request: object) -> dict[str, float | int | None]:
    """Return the fields that a user has set, checked for their kind; "auto" counts as not set.

    Parameters
    ----------
    request : mapping
        As it came from the user.

    Returns
    -------
    dict
        Values by field, None for no filter.

    Raises
    ------
    RecordingError
        With a pointer to an unknown field or to a value that is no number.
    """
    if not isinstance(request, Mapping):
        raise RecordingError(
            f'preprocessing is {request!r}; give "auto", or an object with fields from {", ".join(FIELDS)}.',
            pointer="/preprocessing",
            title="Impossible preprocessing",
        )
    for name in request:
        if name not in FIELDS:
            raise _impossible_value_error(
                name, f"There is no preprocessing field {name!r}; the fields are {', '.join(FIELDS)}."
            )
    Filters(**request)
    return {
        name: float(value) if name.endswith("cutoff") and value is not None else value
        for name, value in request.items()
        if value != "auto"
    }


def _impossible_value_error(name: str, detail: str) -> RecordingError:
    return RecordingError(detail, pointer=f"/preprocessing/{name}", title="Impossible preprocessing")
