"""Models in which nothing more was found missing: of the benchmark's arms, and of real ones where there are any."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from common import RECORDINGS
from engine.robots import arm_by_name, as_described
from hiding.case import Case
from hiding.recorded import recorded

from dynident.diagnosis import diagnose
from dynident.effects import DEFAULT_EFFECTS, EffectChoice
from dynident.identification import Identification, IdentificationChoices, extend, identify
from dynident.recordings import RecordedJoints, Recording, RecordingMetadata, import_recording
from dynident.robot import Robot, robot_from_modified_dh, robot_from_urdf


@dataclass(frozen=True, eq=False)
class Subject:
    """A final model: identified, diagnosed, with all that was recommended added; `added` says what that was.

    It has an offset on every joint: a constant is right at any time, and naming one that is missing is no mistake.
    """

    name: str
    identification: Identification
    recordings: tuple[Recording, ...]
    added: tuple[str, ...]


@dataclass(frozen=True)
class RealArm:
    """Recordings of a real arm that are identified from together."""

    folder: str
    files: tuple[str, ...]
    gains: tuple[float, ...] | None = None

    @property
    def is_here(self) -> bool:
        """Whether its recordings are on this machine."""
        return (RECORDINGS / self.folder).is_dir()

    @property
    def name(self) -> str:
        """What it is called in the table."""
        return f"{self.folder}, {' + '.join(self.files)}"


_UR10E_GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
REAL_ARMS = (
    RealArm("ur10e", ("id_30s_12harm",), _UR10E_GAINS),
    RealArm("ur10e", ("id_30s_12harm", "id_40s_12harm"), _UR10E_GAINS),
    RealArm("ur10", ("exciting_traj",)),
    RealArm("tx40", ("all",)),
    RealArm("airbot_play", ("id_chirp_unloaded",)),
    RealArm("kr300", ("id_A",)),
    RealArm("dvrk_psm", ("base_one",)),
)


def simulated(case: Case, cache: Path | None) -> Subject:
    """A case of the benchmark of hidden effects."""
    data = recorded(case, cache)
    return _final(case.name, as_described(arm_by_name(case.arm), case.noise), data.recordings(held_out=False))


def real(arm: RealArm, folder: Path) -> Subject:
    """A real arm, no windows given; what is imported is put into the folder."""
    return _final(arm.name, *imported(arm, folder))


def imported(arm: RealArm, folder: Path) -> tuple[Robot, list[Recording]]:
    """A real arm's description and recordings, which are put into the folder."""
    robot = _robot(RECORDINGS / arm.folder)
    return robot, list(_imported(arm, robot, folder))


def _final(name: str, robot: Robot, recordings: list[Recording]) -> Subject:
    plain = identify(robot, recordings, choices=IdentificationChoices((*DEFAULT_EFFECTS, EffectChoice("offset"))))
    recommended = diagnose(plain, recordings).recommended
    found = extend(plain, recommended, recordings) if recommended else plain
    return Subject(name, found, tuple(recordings), tuple(choice.effect for choice in recommended))


def _robot(folder: Path) -> Robot:
    urdf = folder / "robot.urdf"
    if urdf.exists():
        return robot_from_urdf(folder.name, urdf.read_text(encoding="utf-8"))
    return robot_from_modified_dh(folder.name, (folder / "robot.json").read_text(encoding="utf-8"))


def _imported(arm: RealArm, robot: Robot, folder: Path) -> Iterator[Recording]:
    for file in arm.files:
        source, target = RECORDINGS / arm.folder / f"{file}.parquet", folder / f"{arm.folder}-{file}.parquet"
        metadata = RecordingMetadata(name=file)
        yield import_recording(source, target, RecordedJoints(robot.joint_names, gains=arm.gains), metadata=metadata)[0]
