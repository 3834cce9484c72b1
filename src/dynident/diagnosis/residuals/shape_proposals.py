"""Collect shape constants and groups of runs to try that no grid offers: spectral peaks, bursts, attached payloads.

Holds how many groups of runs are tried (16); the peaks are found in `spectral_peaks`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.residuals.failure_map_and_unknown_patterns import find_bursts
from dynident.diagnosis.residuals.spectral_peaks import (
    AngleLines,
    compute_line_share,
    find_angle_lines,
    find_base_vibration,
    find_motion_lines,
)
from dynident.effects import CATALOGUE
from dynident.identification import Identification
from dynident.recordings import Recording
from dynident.robot.contacts import find_largest_zero_errors
from dynident.robot.robot_model import Robot

# Groups that are tried: each is a candidate in every round.
_MOST_GROUPS = 16


@dataclass(frozen=True)
class ShapeProposals:
    """Where to look for effects that a grid cannot offer, from the recordings and their residual.

    Parameters
    ----------
    angle_lines : AngleLines
        Lines in the residual over a joint's angle.
    time_lines : tuple of float
        Frequencies of lines over time, Hz.
    bursts : tuple of (str, float, float)
        Run label, start and end (s) of intervals far above the rest.
    run_groups : tuple of tuple of str
        Sets of runs that an effect may be limited to.
    carriers : mapping of tuple of str to list of str
        Links on which a load would explain most, by the runs that it is limited to.
    has_temperature : bool
        Whether all recordings have a temperature.
    session : float
        Time that the clock of all recordings has run, s; where it starts anew in each, that of the shortest.
    since : tuple of str
        Labels of the later runs, where changes between them and the others are looked for.
    largest : mapping of (str, str) to float
        Largest size that the positions alone allow an effect on a joint, by effect and joint.
    """

    angle_lines: AngleLines = field(default_factory=AngleLines)
    time_lines: tuple[float, ...] = ()
    bursts: tuple[tuple[str, float, float], ...] = ()
    run_groups: tuple[tuple[str, ...], ...] = ()
    carriers: Mapping[tuple[str, ...], Sequence[str]] = field(default_factory=dict)
    has_temperature: bool = False
    session: float = 0.0
    since: tuple[str, ...] = ()
    largest: Mapping[tuple[str, str], float] = field(default_factory=dict)

    @property
    def single_runs(self) -> list[tuple[str, ...]]:
        """Groups of one run each."""
        return [group for group in self.run_groups if len(group) == 1]

    def add_lines(self, comparisons: Sequence[Comparison], robot: Robot) -> ShapeProposals:
        """Return the same with further lines of what a better model leaves, where they can pass as findings."""
        known = self.angle_lines
        later = [
            line
            for line in find_angle_lines(comparisons, robot).clear
            if line[0] not in known.joints and compute_line_share(comparisons, *line) >= RULES.least_drop
        ]
        return replace(self, angle_lines=replace(known, clear=(*known.clear, *later))) if later else self


def propose_shapes(
    comparisons: Sequence[Comparison],
    recordings: Sequence[Recording],
    identification: Identification,
    since: tuple[str, ...] = (),
) -> ShapeProposals:
    """Propose shape constants and runs from the residual of the model and from the recordings."""
    # Without a filter of the torque: half of the Nyquist frequency.
    highest = identification.preprocessing.torque_cutoff or 0.25 / float(np.median(np.diff(comparisons[0].t)))
    motion = find_motion_lines(comparisons, highest)
    signals, reference = identification.model.signals, identification.estimate.next_reference()
    return ShapeProposals(
        angle_lines=find_angle_lines(comparisons, identification.model.robot),
        time_lines=tuple(find_base_vibration(comparisons, signals, reference, highest, motion)),
        bursts=tuple(
            (recording.name_segment(segment), start, end)
            for comparison, recording in zip(comparisons, recordings, strict=True)
            for segment, start, end in find_bursts(comparison)
        ),
        # What the later runs have is asked of each link by itself.
        run_groups=() if since else tuple(list_run_groups(recordings)),
        has_temperature=all(recording.has_temperature for recording in recordings),
        session=compute_session_length(recordings),
        since=since,
        largest=_find_largest_sizes(comparisons, recordings, identification.model.robot, since),
    )


def _find_largest_sizes(
    comparisons: Sequence[Comparison], recordings: Sequence[Recording], robot: Robot, since: tuple[str, ...]
) -> dict[tuple[str, str], float]:
    """Return how large errors of joints' zero positions may be by what feet that stand show, on either day."""
    is_later = [bool(set(recording.segment_names) & set(since)) for recording in recordings]
    largest: dict[tuple[str, str], float] = {}
    for day in sorted(set(is_later)):
        pairs = zip(comparisons, is_later, strict=True)
        motions = [(comparison.q, comparison.dq) for comparison, later in pairs if later == day]
        for joint, most in find_largest_zero_errors(robot, motions).items():
            for key in ((effect.id, joint) for effect in CATALOGUE.values() if effect.shifts_zero):
                largest[key] = max(most, largest.get(key, 0.0))
    return largest


def compute_session_length(recordings: Sequence[Recording]) -> float:
    """Return the seconds from the first to the last sample; of the shortest recording if their clocks start anew."""
    spans = [
        sorted((part.start_time, part.start_time + part.length * recording.period) for part in recording.segments)
        for recording in recordings
    ]
    together = sorted(span for own in spans for span in own)
    # Recordings that overlap in time have clocks of their own, and each is a session.
    if any(after[0] < before[1] - 1e-6 for before, after in pairwise(together)):
        return min(max(end for _, end in own) - own[0][0] for own in spans)
    return together[-1][1] - together[0][0]


def list_run_groups(recordings: Sequence[Recording]) -> list[tuple[str, ...]]:
    """List sets of runs in which something may have been attached: as stated, single ones, the first or last few."""
    labels = list(dict.fromkeys(label for recording in recordings for label in recording.segment_names))
    groups: list[tuple[str, ...]] = []
    if any(recording.payload is not None for recording in recordings):
        groups.append(())
    count = len(labels)
    proposals: list[tuple[str, ...]] = [(label,) for label in labels]
    # Something is attached or taken off once: the runs before it, or those after it, belong together.
    proposals += [tuple(labels[:k]) for k in range(2, count)] + [tuple(labels[k:]) for k in range(1, count - 1)]
    for group in proposals if count > 1 else []:
        if group not in groups and len(group) < count:
            groups.append(group)
    return groups[:_MOST_GROUPS]
