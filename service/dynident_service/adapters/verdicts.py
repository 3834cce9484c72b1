"""Verdicts of models between the contract and the science."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynident.recordings import Recording
from dynident.recordings.revisions import after
from dynident.verdict import ModelVerdict, Stop
from dynident_service.adapters.identifications import show_errors
from dynident_service.adapters.revisions import metadata_of, show_revision
from dynident_service.models import verdicts as wire
from dynident_service.models.measurements import MeasurementMetadata


@dataclass(frozen=True, eq=False)
class Judged:
    """A stored measurement that a model was made from or tried on."""

    id: str
    recording: Recording
    said: MeasurementMetadata


def show_verdict(found: ModelVerdict, seen: Sequence[Judged] = ()) -> wire.VerdictView:
    """Show a verdict; recordings that are not `seen` are told by name."""
    by_name = {one.recording.name: one for one in seen}
    return wire.VerdictView(
        uses=[wire.UseView(use=one.use, fit=one.fit, reason=one.reason) for one in found.uses],
        held_out=None if found.held_out is None else show_errors(found.held_out, found.held_out_moving),
        stop=None if found.stop is None else _stop(found.stop, by_name.get(found.stop.recording or "")),
        summary=found.summary,
        common=[
            wire.CommonView(
                held_out_id=by_name[one.held_out].id if one.held_out in by_name else one.held_out,
                fitted_id=by_name[one.fitted].id if one.fitted in by_name else one.fitted,
                kind=one.kind,
                share=one.share,
                detail=str(one),
            )
            for one in found.common
        ],
        next_steps=list(found.next_steps),
    )


def _stop(found: Stop, where: Judged | None) -> wire.StopView:
    cure = found.apply
    if cure is not None and where is not None:
        cure = after(cure, metadata_of(where.said), where.recording.joint_names)
    return wire.StopView(
        cause=found.cause,
        measurement_id=found.recording if where is None else where.id,
        apply=None if cure is None else show_revision(cure),
    )
