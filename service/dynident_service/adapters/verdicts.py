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


def show_verdict(found: ModelVerdict, seen: Sequence[SeenMeasurement] = ()) -> wire.VerdictView:
    """Show a verdict; recordings that are not `seen` are told by name."""
    by_name = {one.recording.name: one for one in seen}
    stop = None if found.stop is None else _stop(found.stop, by_name.get(found.stop.recording or ""))
    common = [
        shown(
            wire.CommonView,
            one,
            held_out_id=_id(by_name, one.held_out),
            fitted_id=_id(by_name, one.fitted),
            detail=str(one),
        )
        for one in found.common
    ]
    return shown(wire.VerdictView, found, stop=stop, common=common)


def _id(seen: Mapping[str, SeenMeasurement], name: str) -> str:
    return seen[name].id if name in seen else name


def _stop(found: Stop, where: SeenMeasurement | None) -> wire.StopView:
    cure = found.apply
    if cure is not None and where is not None:
        cure = after(cure, metadata_of(where.said), where.recording.joint_names)
    return wire.StopView(
        cause=found.cause,
        measurement_id=found.recording if where is None else where.id,
        apply=None if cure is None else show_revision(cure),
    )
