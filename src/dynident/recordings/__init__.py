"""Measured data: read, repair, check, filter, differentiate, decimate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.recordings.all_checks import StopReason, find_stop_reasons, list_fatal_findings
    from dynident.recordings.joint_phases import PhaseShares, phase_shares
    from dynident.recordings.low_pass_decimation import FilteredRows, ParallelFilter, low_pass
    from dynident.recordings.position_filter import compute_edge_margin, filtered_blocks
    from dynident.recordings.preprocessing import (
        Preprocessing,
        choose_preprocessing,
        find_motion_band,
        preprocessing_from_request,
    )
    from dynident.recordings.recording import JointLimits, RecordedJoints, Recording, SampleBlock, Segment
    from dynident.recordings.recording_import import FurtherColumns, import_recording, recording_from_arrays
    from dynident.recordings.recording_metadata import Check, Filters, RecordingError, RecordingMetadata, Revision
    from dynident.recordings.row_storage import open_recording

__all__ = [
    "Check",
    "FilteredRows",
    "Filters",
    "FurtherColumns",
    "JointLimits",
    "ParallelFilter",
    "PhaseShares",
    "Preprocessing",
    "RecordedJoints",
    "Recording",
    "RecordingError",
    "RecordingMetadata",
    "Revision",
    "SampleBlock",
    "Segment",
    "StopReason",
    "choose_preprocessing",
    "compute_edge_margin",
    "filtered_blocks",
    "find_motion_band",
    "find_stop_reasons",
    "import_recording",
    "list_fatal_findings",
    "low_pass",
    "open_recording",
    "phase_shares",
    "preprocessing_from_request",
    "recording_from_arrays",
]

if not TYPE_CHECKING:
    # Requests are declared in this package, too. Loading names lazily lets code that only reads requests start fast.
    __getattr__, __dir__ = make_lazy_exports(__name__)
