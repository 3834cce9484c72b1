"""Verdicts of models between the contract and the science."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dynident.recordings import Recording
from dynident.recordings.revisions import after
from dynident.verdict import ModelVerdict, Stop
from dynident_service.adapters.answers import shown
from dynident_service.adapters.revisions import metadata_of, show_revision
from dynident_service.models import verdicts as wire
from dynident_service.models.measurements import MeasurementMetadata


@dataclass(frozen=True, eq=False)
class SeenMeasurement:
    """A stored measurement that a model was made from or tried on."""

    id: str
    recording: Recording
    said: MeasurementMetadata


def show_verdict(verdict: ModelVerdict, measurements: Sequence[SeenMeasurement] = ()) -> wire.VerdictView:
    """Show a verdict; recordings that are not `seen` are told by name."""
    by_name = {measurement.recording.name: measurement for measurement in measurements}
    stop = None if verdict.stop is None else _stop(verdict.stop, by_name.get(verdict.stop.recording or ""))
    common = [
        shown(
            wire.CommonView,
            overlap,
            held_out_id=_id(by_name, overlap.held_out),
            fitted_id=_id(by_name, overlap.fitted),
            detail=str(overlap),
        )
        for overlap in verdict.common
    ]
    return shown(wire.VerdictView, verdict, stop=stop, common=common)


def _id(measurements: Mapping[str, SeenMeasurement], name: str) -> str:
    return measurements[name].id if name in measurements else name


def _stop(stop: Stop, measurement: SeenMeasurement | None) -> wire.StopView:
    cure = stop.apply
    if cure is not None and measurement is not None:
        cure = after(cure, metadata_of(measurement.said), measurement.recording.joint_names)
    return wire.StopView(
        cause=stop.cause,
        measurement_id=stop.recording if measurement is None else measurement.id,
        apply=None if cure is None else show_revision(cure),
    )
