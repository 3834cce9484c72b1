"""What is said of a file can be changed afterwards; checks carry the change that would cure what they found."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque

from dynident.api.recording_files import read_recordings
from dynident.identification.robot_recording_import import import_cured, import_for_robot
from dynident.recordings import Check, Recording, RecordingError, RecordingMetadata, Revision
from dynident.recordings.metadata_revisions import adapt_revision

ROBOT = arm("ur10")
EFFORT = np.array([joint.limits.effort for joint in ROBOT.joints])
Q, TAU = ([f"{name}{k + 1}" for k in range(6)] for name in ("q", "tau"))


def written(path: Path, *, order: tuple[int, ...] = (0, 1, 2, 3, 4, 5), signs: tuple[int, ...] = (1,) * 6) -> Path:
    motion = fourier_motion(ROBOT, 20.0, 200.0, 3)
    friction = 0.04 * EFFORT * np.sign(motion.dq) + 0.03 * EFFORT * motion.dq
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + friction
    tau += 0.005 * EFFORT * np.random.default_rng(3).normal(size=tau.shape)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *Q, *TAU])
        writer.writerows(np.column_stack([motion.t, motion.q, (tau * signs)[:, order]]))
    return path


def brought_in(path: Path, metadata: RecordingMetadata) -> tuple[Recording, tuple[Check, ...]]:
    return import_for_robot(ROBOT, path, path.with_suffix(".checked.parquet"), metadata)


def torque(recording: Recording) -> np.ndarray:
    segment = recording.segments[0]
    return np.concatenate([rows.tau for rows in recording.source.rows(segment.first_row, segment.length, 10**6)])


def cure_of(path: Path, metadata: RecordingMetadata) -> Revision:
    with pytest.raises(RecordingError) as refused:
        brought_in(path, metadata)
    cure = next(check.apply for check in refused.value.checks if check.status == "error")
    assert cure is not None
    return cure


def test_what_a_check_proposes_makes_the_recording_the_right_one(tmp_path: Path) -> None:
    right, _ = brought_in(written(tmp_path / "right.csv"), RecordingMetadata())
    wrong = written(tmp_path / "wrong.csv", order=(1, 0, 2, 3, 4, 5))
    cure = cure_of(wrong, RecordingMetadata())
    assert cure == Revision(permutation={"tau": (2, 1, 3, 4, 5, 6)})
    mended, checks = brought_in(wrong, cure.apply_to(RecordingMetadata()))
    assert np.array_equal(torque(mended), torque(right))
    assert all(check.apply is None for check in checks if check.name.endswith(("order", "sign")))


def test_a_cure_goes_on_from_what_was_said_before(tmp_path: Path) -> None:
    right, _ = brought_in(written(tmp_path / "right.csv"), RecordingMetadata())
    wrong = written(tmp_path / "wrong.csv", order=(1, 2, 0, 3, 4, 5), signs=(1, -1, 1, 1, 1, 1))
    said = RecordingMetadata(permutation={"tau": (3, 2, 1, 4, 5, 6)}, signs={"tau3": -1})
    cure = cure_of(wrong, said)
    mended, _ = brought_in(wrong, cure.apply_to(said))
    assert np.array_equal(torque(mended), torque(right))


def test_mistakes_that_checks_know_a_cure_of_are_mended_one_after_the_other_if_asked(tmp_path: Path) -> None:
    right, _ = brought_in(written(tmp_path / "right.csv"), RecordingMetadata())
    wrong = written(tmp_path / "wrong.csv", order=(1, 0, 2, 3, 4, 5), signs=(1, 1, -1, 1, 1, 1))
    mended = import_cured(ROBOT, wrong, tmp_path / "mended.parquet", RecordingMetadata())
    assert np.array_equal(torque(mended.recording), torque(right))
    assert len(mended.revisions) == 2
    assert "tau: 2 1 3 4 5 6" in str(mended.revisions[0]) + str(mended.revisions[1])


def test_what_has_no_cure_is_refused_all_the_same(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv")
    with pytest.raises(RecordingError, match="Window 1 runs"):
        import_cured(ROBOT, path, tmp_path / "x.parquet", RecordingMetadata(windows=((100.0, 200.0),)))


SIGNS = {"first": (1, 1, 1, 1, 1, -1), "second": (1, 1, 1, 1, -1, 1), "third": (1, 1, 1, 1, 1, -1)}


def test_recordings_that_no_one_sign_fits_are_told_as_such(tmp_path: Path) -> None:
    paths = [written(tmp_path / f"{name}.csv", signs=signs) for name, signs in SIGNS.items()]
    with pytest.raises(RecordingError) as refused:
        read_recordings(*paths, robot=ROBOT)
    last, before = ROBOT.joint_names[-1], ROBOT.joint_names[-2]
    assert f"another sign of {last} in first and third; another sign of {before} in second" in refused.value.detail
    with pytest.raises(RecordingError) as refused:
        read_recordings(paths[0], paths[2], robot=ROBOT)
    assert "No one correction" not in refused.value.detail


def test_recordings_that_would_be_cured_apart_are_refused(tmp_path: Path) -> None:
    orders = {"first": (1, 0, 2, 3, 4, 5), "second": (0, 2, 1, 3, 4, 5)}
    paths = [written(tmp_path / f"{name}.csv", order=order) for name, order in orders.items()]
    for path in paths:
        read_recordings(path, robot=ROBOT, cure=True)
    with pytest.raises(RecordingError, match=r"another order of tau .2 1 3 4 5 6. in first") as refused:
        read_recordings(*paths, robot=ROBOT, cure=True)
    assert refused.value.title == "Recordings contradict each other"


def test_a_cure_that_another_recording_of_the_robot_has_is_taken_first(tmp_path: Path) -> None:
    right, _ = brought_in(written(tmp_path / "right.csv"), RecordingMetadata())
    path, target = written(tmp_path / "wrong.csv", signs=SIGNS["first"]), tmp_path / "cured.parquet"
    # By itself the recording does not tell whether the position or the torque has the wrong sign.
    with pytest.raises(RecordingError):
        import_cured(ROBOT, path, target, RecordingMetadata())
    known = (Revision(signs={"tau6": -1.0}),)
    cured = import_cured(ROBOT, path, target, RecordingMetadata(), known=known)
    assert cured.revisions == known
    assert np.array_equal(torque(cured.recording), torque(right))


def test_excluded_seconds_are_not_used(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv")
    whole, _ = brought_in(path, RecordingMetadata(exclude=((5.0, 7.0),)))
    (_, before), (after, _) = whole.windows
    assert (before, after) == (5.0, 7.0)
    part, _ = brought_in(path, RecordingMetadata(windows=((4.0, 12.0),), exclude=((5.0, 7.0), (11.0, 30.0))))
    assert part.windows == ((4.0, 5.0), (7.0, 11.0))
    with pytest.raises(RecordingError, match="removes the whole recording"):
        brought_in(path, RecordingMetadata(windows=((4.0, 12.0),), exclude=((0.0, 30.0),)))


def test_scales_and_signs_are_of_one_joint_or_of_all(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv")
    own = torque(brought_in(path, RecordingMetadata())[0])
    other, _ = brought_in(
        path, RecordingMetadata(scale={"tau": 2.0}, signs={"tau2": -1}, accept=("torque_sign", "joint_sign"))
    )
    assert np.allclose(torque(other), own * [2, -2, 2, 2, 2, 2], rtol=1e-12)


@pytest.mark.parametrize(
    ("said", "pointer"),
    [
        (lambda: RecordingMetadata(permutation={"tau": (1, 2)}), "/permutation/tau"),
        (lambda: RecordingMetadata(permutation={"tau": (0, 1, 2, 3, 4, 5)}), "/permutation/tau/0"),
        (lambda: RecordingMetadata(permutation={"dq": (1, 2, 3, 4, 5, 6)}), "/permutation/dq"),
        (lambda: RecordingMetadata(signs={"tau9": -1}), "/signs/tau9"),
        (lambda: RecordingMetadata(signs={"tau1": 0.5}), "/signs/tau1"),
        (lambda: RecordingMetadata(scale={"q1": -2.0}), "/scale/q1"),
    ],
)
def test_an_order_or_sign_that_cannot_be_is_named(
    tmp_path: Path, said: Callable[[], RecordingMetadata], pointer: str
) -> None:
    with pytest.raises(RecordingError) as refused:
        brought_in(written(tmp_path / "run.csv"), said())
    assert refused.value.pointer == pointer


def test_a_revision_changes_what_it_names_and_keeps_the_rest() -> None:
    said = RecordingMetadata(name="run", units={"q": "deg"}, signs={"tau1": -1}, windows=((0.0, 5.0),))
    after = Revision(units={"t": "ms"}, signs={"tau1": 1, "tau2": -1}).apply_to(said)
    assert after.units == {"q": "deg", "t": "ms"}
    assert after.signs == {"tau1": 1, "tau2": -1}
    assert after.windows == ((0.0, 5.0),)
    assert Revision(windows=()).apply_to(said).windows == ()


def test_a_zero_is_stated_of_a_joint_and_goes_with_its_column(tmp_path: Path) -> None:
    def position(metadata: RecordingMetadata) -> np.ndarray:
        recording = brought_in(path, replace(metadata, accept=("joint_order", "joint_sign", "torque_order")))[0]
        segment = recording.segments[0]
        return np.concatenate([rows.q for rows in recording.source.rows(segment.first_row, segment.length, 10**6)])

    path = written(tmp_path / "run.csv")
    right = position(RecordingMetadata())
    said = RecordingMetadata(zeros={"q2": 0.25}, signs={"q3": -1})
    turned = position(said)
    assert np.allclose(turned, right * [1, 1, -1, 1, 1, 1] - [0, 0.25, 0, 0, 0, 0], rtol=1e-12)
    revision = adapt_revision(
        Revision(permutation={"q": (1, 3, 2, 4, 5, 6)}, signs={"q3": -1.0}, zeros={"q3": 0.5}), said, ROBOT.joint_names
    )
    after = position(revision.apply_to(said))
    assert np.allclose(after, turned[:, [0, 2, 1, 3, 4, 5]] * [1, 1, -1, 1, 1, 1] - [0, 0, 0.5, 0, 0, 0], rtol=1e-12)
    with pytest.raises(RecordingError) as refused:
        brought_in(path, RecordingMetadata(zeros={"tau2": 0.1}))
    assert refused.value.pointer == "/zeros/tau2"
