"""Whether recordings are those that a model was identified from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from dynident.errors import DynidentError
from dynident.identification.study.result import Identification
from dynident.recordings import Recording
from dynident.recordings.sample_hashes import SampleHashes, copied_recordings


def with_samples(
    found: Identification, recordings: Sequence[Recording], validation: Sequence[Recording]
) -> Identification:
    """Note by which samples a model was identified, and which validation data hold some of them."""
    hashes = [SampleHashes.of(recording) for recording in recordings]
    digests = tuple(own.digest for own in hashes)
    return replace(found, data=replace(found.data, digests=digests, copied=copied_recordings(hashes, validation)))


def check_same_recordings(identification: Identification, recordings: Sequence[Recording]) -> None:
    """Raise where recordings hold other samples than those that a model was identified from, as far as it knows.

    Raises
    ------
    DynidentError
        Names the recordings that are others, and those of the model.
    """
    wanted = Counter(identification.data.digests)
    if not wanted:
        return  # identified by a version that did not note them, or from poses
    given = [(recording.name, SampleHashes.of(recording).digest) for recording in recordings]
    others = [name for name, digest in given if digest not in wanted]
    if not others and Counter(digest for _, digest in given) == wanted:
        return
    names = ", ".join(identification.data.measurement_names)
    said = (
        f"{', '.join(others)} {'holds' if len(others) == 1 else 'hold'} other samples" if others else "some are missing"
    )
    raise DynidentError(
        f"these are not the recordings that the model was identified from ({names}): {said}. Give those files, read as "
        "they were then: the same windows, columns, units, gains and steps that were skipped. From other data identify "
        "a model anew.",
        pointer="/measurement_ids",
        title="Other recordings",
    )
