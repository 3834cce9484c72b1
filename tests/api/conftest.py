"""A small arm with one hidden effect, as the files that a user has beside a notebook."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.small_arm_files import ARM, write_run

import dynident as dy
from dynident.effects import CATALOGUE
from dynident.robot import urdf_from_robot


@pytest.fixture(scope="session")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the robot's URDF, two recordings, and one of another day."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "arm.urdf").write_text(urdf_from_robot(ARM), encoding="utf-8")
    write_run(folder / "run1.csv", 1)
    write_run(folder / "run2.csv", 2)
    write_run(folder / "today.csv", 3, coulomb=4.5)
    return folder


@pytest.fixture(scope="session")
def robot(desk: Path) -> dy.Robot:
    return dy.load_robot(desk / "arm.urdf")


@pytest.fixture(scope="session")
def runs(desk: Path, robot: dy.Robot) -> dy.Recordings:
    return dy.read_recordings(desk / "run1.csv", desk / "run2.csv", robot=robot)


@pytest.fixture(scope="session")
def model(robot: dy.Robot, runs: dy.Recordings) -> dy.Model:
    """Without the Stribeck friction that the arm has."""
    return dy.identify(robot, runs[:1], validation=runs[1:])


@pytest.fixture(scope="session")
def found(model: dy.Model) -> dy.DiagnosedModel:
    return dy.diagnose(model)


@pytest.fixture(scope="session")
def better(model: dy.Model, found: dy.DiagnosedModel) -> dy.Model:
    return model.extend(found)


@pytest.fixture
def restored_catalogue() -> Iterator[None]:
    """What a test registers is gone afterwards: other tests compare the catalogue with the pages."""
    before, added = dict(CATALOGUE), set(CATALOGUE._own_ids)
    yield
    CATALOGUE._effects.clear()
    CATALOGUE._effects.update(before)
    CATALOGUE._own_ids.intersection_update(added)
