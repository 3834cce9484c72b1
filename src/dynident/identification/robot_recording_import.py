"""Import a file for a robot: columns, conditioning, all checks and faults by dynamics; import it with cures.

Holds how many faults are cured one after the other (5).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from dynident.array_types import FloatArray
from dynident.expressions.code_cache import code_folder, load_or_compute, pickle_with_library, read_pairs
from dynident.identification.recording_faults import build_dynamics_checks
from dynident.identification.recording_faults.column_faults import ColumnFault
from dynident.identification.recording_faults.description_fit import DescriptionFit, measure_left_by_description
from dynident.identification.recording_faults.fault_search import ALIKE
from dynident.identification.recording_faults.joint_angle_faults import ZERO
from dynident.identification.recording_faults.rows_for_fault_search import filter_motion
from dynident.identification.recording_faults.unexplained_torque import HeldOutFit
from dynident.number_format import format_percent
from dynident.progress import Progress, ignore_progress
from dynident.recordings import (
    Check,
    JointLimits,
    RecordedJoints,
    Recording,
    RecordingError,
    RecordingMetadata,
    Revision,
    import_recording,
)
from dynident.recordings.metadata_revisions import ColumnArrangement
from dynident.recordings.recording import ModelChecks
from dynident.robot import Robot, coupling_matrix
from dynident.robot.contacts import compute_contact_projection
from dynident.robot.forward_kinematics import project_wrench
from dynident.robot.pseudo_inertia import find_description_units

_HASHED_AT_ONCE = 1 << 16  # rows


def build_recorded_joints(robot: Robot) -> RecordedJoints:
    """Return what the columns of a robot's recordings stand for: its joints with their limits, gains and coupling.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    RecordedJoints
        The joints with their limits, gains and coupling.
    """
    joints = RecordedJoints(
        robot.joint_names,
        limits=[JointLimits(j.kind, j.reach, j.limits.velocity, j.limits.effort) for j in robot.joints],
        gains=[drive.gain for drive in robot.drives],
        coupling=coupling_matrix(robot),
    )
    if robot.base == "fixed":
        return joints
    carriers = range(robot.n_massless, robot.tree.n)
    links = {robot.tree.joints[k].link or robot.tree.joints[k].name: k for k in carriers}

    def project(link: str, q: FloatArray, wrench: FloatArray, in_world: bool) -> FloatArray:
        return project_wrench(robot, q, links[link], wrench, in_world=in_world)

    joints = replace(joints, n_base=robot.n_base, links=tuple(links), project_wrench=project)
    if not robot.contacts:
        return joints

    def project_contacts(q: FloatArray, tau: FloatArray) -> FloatArray:
        out = np.full(tau.shape, np.nan)
        # Rows without a number, as before an estimator runs, stay without one.
        finite = np.isfinite(q).all(axis=1) & np.isfinite(tau).all(axis=1)
        out[finite] = np.einsum("mij,mj->mi", compute_contact_projection(robot, q[finite]), tau[finite])
        return out

    return replace(joints, project_contacts=project_contacts)


def import_for_robot(
    robot: Robot, source: Path, destination: Path, metadata: RecordingMetadata, progress: Progress = ignore_progress
) -> tuple[Recording, tuple[Check, ...]]:
    """Check a file and store it as a canonical Parquet file.

    Parameters
    ----------
    robot : Robot
        The robot.
    source, destination : Path
        The user's file, and the Parquet file to write.
    metadata : RecordingMetadata
        How the file is to be read.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    tuple of Recording and its checks

    Raises
    ------
    RecordingError
        For a file that cannot be used, as `import_recording` says.
    """
    recording, checks = import_recording(
        source,
        destination,
        build_recorded_joints(robot),
        metadata=metadata,
        against=skip_passed_checks(robot) if robot.base == "fixed" else build_support_check(robot),
        progress=progress,
    )
    return recording, refute_clocks(robot, recording, checks)


def skip_passed_checks(robot: Robot) -> ModelChecks:
    """Return the checks against a robot's dynamics, which a recording that has passed them all does not have again.

    What passed lies beside the compiled code, under a hash of the robot, the rows and this library. What did not pass
    is checked each time.

    Parameters
    ----------
    robot : Robot
        The robot.
    """
    check = build_dynamics_checks(robot)

    def check_unless_passed(recording: Recording, q: Sequence[str], tau: Sequence[str]) -> tuple[Check, ...] | None:
        checked: list[tuple[Check, ...] | None] = []

        def find_passed() -> bytes:
            checked.append(check(recording, q, tau))
            items = checked[0] or ()
            has_passed = items and all(item == Check(item.name, "ok", item.detail) for item in items)
            return json.dumps([(item.name, item.detail) for item in items]).encode() if has_passed else b""

        key = None if code_folder() is None else _hash_checked(robot, recording, q, tau)
        pairs = [] if key is None else read_pairs(load_or_compute(key, find_passed))
        if checked or not pairs:
            return checked[0] if checked else check(recording, q, tau)
        return tuple(Check(name, "ok", detail) for name, detail in pairs)

    return check_unless_passed


def _hash_checked(robot: Robot, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> str | None:
    """Return a hash of all that the checks depend on; None where a part of it cannot be pickled."""
    described = [getattr(recording, field.name) for field in fields(recording) if field.name not in ("source", "path")]
    if (start := pickle_with_library((robot, described, list(q), list(tau)))) is None:
        return None
    digest = sha256(start)
    for rows in recording.source.rows(0, recording.n_samples, _HASHED_AT_ONCE):
        for values in rows:
            digest.update(b"" if values is None else values.tobytes())
    return digest.hexdigest()


def refute_clocks(robot: Robot, recording: Recording, checks: Sequence[Check]) -> tuple[Check, ...]:
    """Return checks without a wrong clock where the masses of the description fit the time as it is better.

    Velocities that are scaled alike look like it: inertia goes with the square of the rate, gravity does not.

    Parameters
    ----------
    robot : Robot
        The robot.
    recording : Recording
        The recording.
    checks : sequence of Check
        Its checks.
    """
    if robot.base != "fixed" or not any(check.name == "clock_rate" for check in checks):
        return tuple(checks)
    units, motion = find_description_units(robot), filter_motion(recording)
    machine = robot if units is None else units.to_si(robot)
    left = None if motion is None else measure_left_by_description(machine, motion)
    if motion is None or left is None:
        return tuple(checks)

    def judge(check: Check) -> Check:
        if check.name != "clock_rate":
            return check
        (remedy,) = check.remedies
        assert isinstance(remedy.value, float)
        factor = remedy.value * recording.period
        faster = replace(motion, dq=factor * motion.dq, ddq=factor**2 * motion.ddq)
        left_by_faster = measure_left_by_description(machine, faster)
        if left_by_faster is None or left_by_faster <= left:
            return check
        detail = (
            f"The velocities of all joints are {factor:.3g} times the derivatives of the positions, and the torques "
            "agree with the time as it is: these velocities are not used."
        )
        return Check("velocity_unit", "warning", detail)

    return tuple(map(judge, checks))


def refute_zeros(
    robot: Robot,
    recordings: Sequence[Recording],
    checks: Sequence[tuple[Check, ...]],
    metadata: Sequence[RecordingMetadata],
) -> list[tuple[Check, ...]]:
    """Return the checks of recordings where another recording does not have a zero of a joint that one of them shows.

    A robot may have been homed anew in between: then the zero is one of that recording alone. Where a fit of all
    parameters does not fall with it, as of the last joint, a load that is not stated may as well be the cause.

    Parameters
    ----------
    robot : Robot
        The robot.
    recordings : sequence of Recording
        All of them.
    checks : sequence of tuple of Check
        Those of each.
    metadata : sequence of RecordingMetadata
        How each was read: zeros that are stated already are corrected.
    """
    proposed = [check for own in checks for check in own if check.name == ZERO and check.status == "warning"]
    if robot.base != "fixed" or not proposed or len(recordings) < 2:
        return list(checks)
    units = find_description_units(robot)
    machine = robot if units is None else units.to_si(robot)
    fit = HeldOutFit(machine)

    @cache
    def describe(number: int) -> DescriptionFit | None:
        motion = filter_motion(recordings[number])
        return None if motion is None else DescriptionFit(machine, motion, fit.measure_unexplained(motion))

    def judge(check: Check, own: int) -> Check:
        if check not in proposed or check.apply is None:
            return check
        stated = ColumnArrangement(metadata[own], robot.joint_names)
        joints = {int(key.removeprefix("q")) - 1: zero for key, zero in check.apply.zeros.items()}
        zeros = {joint: zero - stated.zero("q", joint) for joint, zero in joints.items()}
        fault = ColumnFault("joint zero", tuple(zeros), next(iter(zeros.values())))
        described, others = describe(own), [other for other in range(len(recordings)) if other != own]
        lacking = (recordings[k].name for k in others if (seen := describe(k)) is not None and seen.refutes(fault))
        if described is None or (name := next(lacking, None)) is None:
            return check
        who = name if len(others) == 1 else f"{name} (one of {len(others)} other recordings)"
        mended = fit.measure_unexplained(fault.mend(described.motion))
        # The parameters of a load are among those that are fitted: it leaves no more as it is.
        is_explained = described.now.fine.mean() - mended.fine.mean() < ALIKE
        if not (is_explained and described.surely_demands(fault)):
            not_there = (
                f"By its torques, {who} does not have this zero: correct this recording and not the description."
            )
            return replace(check, detail=f"{check.detail} {not_there}")
        shares = described.compute_shares(fault)
        assert shares is not None
        left = [format_percent(share, decimals=0) for share in shares]
        names = " and ".join(f"{robot.joint_names[joint]} ({zero:.3g} rad)" for joint, zero in joints.items())
        detail = (
            f"The masses of the description leave {left[0]} of an average joint's torque unexplained, and {left[1]} "
            f"with another zero of {names}; a fit of all parameters leaves as much without it, and {who} does not have "
            "it. Either a load was not in all recordings: identify from recordings with the same load. Or the joint "
            "was homed anew in between: state this zero for this recording alone."
        )
        return Check("other_load", "warning", detail, check.column)

    return [tuple(judge(check, own) for check in several) for own, several in enumerate(checks)]


_LEAST_FALL = 0.3
"""Share of the fall in half the time of a recording that a robot in flight has at least."""


def build_support_check(robot: Robot) -> ModelChecks:
    """Return the check that something holds a robot whose base moves, unless it falls.

    In flight for T seconds the centre of mass rises and falls by g T² / 8 at least.
    """

    def check(recording: Recording, q: Sequence[str], _: Sequence[str], /) -> tuple[Check, ...]:
        if robot.contacts:
            return ()
        gravity = float(np.linalg.norm(robot.gravity))
        for segment in recording.segments:
            fall = gravity * (segment.length * recording.period) ** 2 / 8.0
            height, acting = [], False
            for rows in recording.source.rows(segment.first_row, segment.length, segment.length):
                height.append(rows.q[:, :3] @ (robot.gravity / max(gravity, 1e-9)))
                acting = acting or bool(rows.tau[:, : robot.n_base].any())
            if not acting and robot.base == "floating" and float(np.ptp(np.concatenate(height))) < _LEAST_FALL * fall:
                return (
                    Check(
                        "base_forces",
                        "error",
                        f"Nothing holds the robot by these columns, but its base does not fall: in "
                        f"{segment.length * recording.period:.3g} s it would, by {fall:.3g} m. Give the wrenches that "
                        "act on its links, as columns <link>_fx … <link>_mz.",
                        q[0],
                    ),
                )
        return ()

    return check


MOST_CURES = 5
"""Faults that are mended one after the other; a file with more of them is not what it is said to be."""


@dataclass(frozen=True, eq=False)
class CuredRecording:
    """A recording that may have been refused at first, and the cures that made it usable.

    Parameters
    ----------
    recording : Recording
        The recording as it was read at last.
    checks : tuple of Check
        Its checks, with a note for each cure.
    revisions : tuple of Revision
        The cures, in the order in which they were applied.
    metadata : RecordingMetadata
        How the file was read at last.
    """

    recording: Recording
    checks: tuple[Check, ...]
    revisions: tuple[Revision, ...]
    metadata: RecordingMetadata


def import_cured(
    robot: Robot,
    source: Path,
    destination: Path,
    metadata: RecordingMetadata,
    progress: Progress = ignore_progress,
    *,
    most: int = MOST_CURES,
    known: Sequence[Revision] = (),
) -> CuredRecording:
    """Import a file; where it is refused with a cure, read it again with that cure.

    A warning stays one: nothing is changed that could be used as it is. What other recordings of the robot were cured
    of is tried first: several cures may fit one file, and the same one fits all.

    Parameters
    ----------
    robot : Robot
        The robot.
    source, destination : Path
        The user's file, and the Parquet file to write.
    metadata : RecordingMetadata
        How the file is to be read.
    progress : Progress
        Called with the fraction done and a message.
    most : int
        Largest number of cures, one after the other; none with 0.
    known : sequence of Revision
        Cures of other recordings of the robot.

    Returns
    -------
    CuredRecording
        The recording, its checks, and the cures.

    Raises
    ------
    RecordingError
        For a file that cannot be used and whose checks know no cure, or too many.
    """
    done: list[Revision] = []
    while True:
        try:
            recording, checks = import_for_robot(robot, source, destination, metadata, progress)
        except RecordingError as error:
            # One cure at a time: the next reading tells whether the other errors were only its consequence.
            cure = next(
                (check.apply for check in error.checks if check.status == "error" and check.apply is not None), None
            )
            # Without a cure, or after too many, the user has to see the error itself.
            if (cure is None and not known) or len(done) == most:
                raise
            if known and not done:
                try:
                    shared = import_cured(robot, source, destination, _apply_all(known, metadata), progress, most=0)
                except RecordingError:
                    pass
                else:
                    notes = tuple(note_cure(revision) for revision in known)
                    return CuredRecording(shared.recording, (*shared.checks, *notes), tuple(known), shared.metadata)
            if cure is None:
                raise
            done.append(cure)
            metadata = cure.apply_to(metadata)
            continue
        notes = tuple(note_cure(revision) for revision in done)
        left = tuple(_note_left(check) if most and check.apply is not None else check for check in checks)
        return CuredRecording(recording, (*left, *notes), tuple(done), metadata)


def _apply_all(revisions: Sequence[Revision], metadata: RecordingMetadata) -> RecordingMetadata:
    for revision in revisions:
        metadata = revision.apply_to(metadata)
    return metadata


def note_cure(revision: Revision) -> Check:
    """Return the check that says with which cure a recording was read."""
    return Check("cure", "warning", f"Read with this correction: {revision}.")


def _note_left(check: Check) -> Check:
    """Say of a warning whose cure is known that it was not applied."""
    why = (
        "Not corrected: only what would be refused is corrected without asking; state this one yourself if it is right."
    )
    return replace(check, detail=f"{check.detail} {why}") if check.status == "warning" else check


def list_shared_cures(outcomes: Mapping[str, Sequence[Revision] | RecordingError]) -> tuple[Revision, ...]:
    """List the cures of recordings that are facts of their robot, each once: the next recording needs them, too.

    Parameters
    ----------
    outcomes : mapping of str to sequence of Revision, or RecordingError
        By name of the recording, its cures, or why it was refused.
    """
    cures = [revision for own in outcomes.values() if not isinstance(own, RecordingError) for revision in own]
    facts = [revision for revision in cures if any(getattr(revision, field) for field in _FACTS)]
    return tuple(revision for k, revision in enumerate(facts) if revision not in facts[:k])


def contains_fact(error: RecordingError) -> bool:
    """Tell whether a recording is refused for what is a fact of its robot, such as a sign."""
    return any(remedy.field in _FACTS for remedy in error.remedies)


def word_contradiction(robot: Robot, outcomes: Mapping[str, Sequence[Revision] | RecordingError]) -> str:
    """Word what recordings say of the robot that cannot be true of one robot: signs and orders of columns.

    Recordings that need no correction, and those that need the same one, contradict none.

    Parameters
    ----------
    robot : Robot
        The robot.
    outcomes : mapping of str to sequence of Revision, or RecordingError
        By name of the recording, its cures, or why it was refused.

    Returns
    -------
    str
        A sentence; empty where nothing contradicts.
    """
    names_by_cure: dict[tuple[str, ...], list[str]] = {}
    for name, outcome in outcomes.items():
        if cures := tuple(sorted(set(_list_cures(robot, outcome)))):
            names_by_cure.setdefault(cures, []).append(name)
    if len(names_by_cure) < 2:
        return ""
    parts = (f"{' and '.join(cures)} in {' and '.join(names)}" for cures, names in names_by_cure.items())
    return (
        "No one correction fits all of these recordings of one robot: they ask for "
        f"{'; '.join(parts)}. Look at what these joints have in common, such as a coupled wrist, or whether the "
        "recordings were made in different ways."
    )


def _list_cures(robot: Robot, outcome: Sequence[Revision] | RecordingError) -> Iterator[str]:
    """Yield the facts of the robot that a recording was cured of, or is refused for, in words."""
    if isinstance(outcome, RecordingError):
        # The first remedy is the one that is proposed, others fit as well.
        facts = [(remedy.field, remedy.value) for remedy in outcome.remedies if remedy.field in _FACTS][:1]
    else:
        facts = [(field, getattr(revision, field)) for revision in outcome for field in _FACTS]
    for field, value in facts:
        for key, own in value.items() if isinstance(value, Mapping) else ():
            if field == "signs":
                # The column of a joint, or "q" or "tau" for all joints.
                number = re.search(r"\d+$", key)
                yield f"another sign of {robot.joint_names[int(number[0]) - 1] if number else key}"
            else:
                yield f"another order of {key} ({' '.join(map(str, own))})"


CONTRADICTION = "Recordings contradict each other"
"""Title of the error where no one cure fits all recordings of a robot."""

_FACTS = ("signs", "permutation")
"""Fields of a revision that are facts of the robot: units and columns are those of a file."""
