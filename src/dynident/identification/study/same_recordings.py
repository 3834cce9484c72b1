"""Check whether recordings are those that a model was identified from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from dynident.errors import DynidentError
from dynident.identification.study.result import Identification
from dynident.recordings import Recording
from dynident.recordings.sample_hashes import SampleHashes, find_copied_recordings


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
    return replace(identification, data=replace(identification.data, digests=digests, copied=copied))


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
        f"these are not the recordings that the model was identified from ({names}): {difference}. Give those files, "
        "read as they were then: the same windows, columns, units, gains and steps that were skipped. From other data "
        "identify a model anew.",
        pointer="/measurement_ids",
        title="Other recordings",
    )
