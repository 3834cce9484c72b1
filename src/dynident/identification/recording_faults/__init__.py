"""Gross faults of a recording, found by the robot's dynamics: exchanged columns, wrong signs, units or delays."""

from dynident.identification.recording_faults.column_faults import ColumnFault
from dynident.identification.recording_faults.fault_checks import (
    CAUSES,
    VETOES,
    DynamicsCheck,
    build_dynamics_checks,
    check_recording_faults,
)
from dynident.identification.recording_faults.fault_search import DetectedFault, find_recording_faults

__all__ = [
    "CAUSES",
    "VETOES",
    "ColumnFault",
    "DetectedFault",
    "DynamicsCheck",
    "build_dynamics_checks",
    "check_recording_faults",
    "find_recording_faults",
]
