from __future__ import annotations

import pytest

from dynident.robot import Robot, robot_from_library


@pytest.fixture(scope="session")
def ur10() -> Robot:
    return robot_from_library("ur10")


@pytest.fixture(scope="session")
def scara() -> Robot:
    return robot_from_library("scara")
