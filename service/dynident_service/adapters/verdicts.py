"""Verdicts on the fitness of a model as views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dynident.recordings import Recording
from dynident.recordings.revisions import adapt_revision
from dynident.verdict import ModelVerdict, Stop
from dynident_service.adapters.conversion import to_view
from dynident_service.adapters.measurements import show_revision, to_recording_metadata
from dynident_service.wire_types import verdicts as wire
from dynident_service.wire_types.measurements import MeasurementMetadata


@dataclass(frozen=True, eq=False)
class SeenMeasurement:
    """A stored recording that a model was identified from or held against."""

    id: str
    recording: Recording
    metadata: MeasurementMetadata


def show_verdict(verdict: ModelVerdict, measurements: Sequence[SeenMeasurement] = ()) -> wire.VerdictView:
    """Build the view of a verdict.

    Parameters
    ----------
    verdict : ModelVerdict
        The verdict, which names recordings by name.
    measurements : sequence of SeenMeasurement
        Stored recordings; those among them are named by id in the view.

    Returns
    -------
    VerdictView
        The view.
    """
    by_name = {measurement.recording.name: measurement for measurement in measurements}
    stop = None if verdict.stop is None else _show_stop(verdict.stop, by_name.get(verdict.stop.recording or ""))
    common = [
        to_view(
            wire.CommonView,
            overlap,
            held_out_id=_measurement_id(by_name, overlap.held_out),
            fitted_id=_measurement_id(by_name, overlap.fitted),
            detail=str(overlap),
        )
        for overlap in verdict.common
    ]
    return to_view(wire.VerdictView, verdict, stop=stop, common=common)


def _measurement_id(measurements: Mapping[str, SeenMeasurement], name: str) -> str:
    return measurements[name].id if name in measurements else name


def _show_stop(stop: Stop, measurement: SeenMeasurement | None) -> wire.StopView:
    cure = stop.apply
    if cure is not None and measurement is not None:
        # The cure refers to the recording as it was read. The revision has to change what was stated about the file.
        cure = adapt_revision(cure, to_recording_metadata(measurement.metadata), measurement.recording.joint_names)
    return wire.StopView(
        cause=stop.cause,
        measurement_id=stop.recording if measurement is None else measurement.id,
        apply=None if cure is None else show_revision(cure),
    )
