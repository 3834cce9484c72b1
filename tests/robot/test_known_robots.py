"""Robots by name: arms of this package, and descriptions of example-robot-data where it is installed."""

from __future__ import annotations

from pathlib import Path

import pytest

import dynident as dy
from dynident.errors import DynidentError
from dynident.known_robots import list_library_arms, list_stock_robots, locate_robot
from dynident.robot import robot_from_library

STOCK = "cmeel.prefix/share/example-robot-data/robots"
WALKERS = ("walker_12dof_v1", "walker_12dof_v1_box", "walker_12dof_with_hand_v1")


@pytest.fixture
def stock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Packages as example-robot-data installs them: two files of one name, and two variants of one robot."""
    folder = tmp_path / STOCK
    for place in (
        "a_description/urdf/dog.urdf",
        "b_description/robots/dog.urdf",
        "arm_description/urdf/arm7.urdf",
        "g1_description/urdf/g1_plain.urdf",
        "g1_description/urdf/g1_hands.urdf",
        "leg_description/urdf/leg_robot.urdf",
        "walker_description/urdf/walker_12dof_with_hand_v1.urdf",
        "walker_description/urdf/walker_12dof_v1.urdf",
        "walker_description/urdf/walker_12dof_v1_box.urdf",
    ):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_text("<robot name='r'/>")
    monkeypatch.setattr("sys.path", [str(tmp_path)])
    return folder


def test_stock_robots_have_the_name_of_their_file_or_of_their_package(stock: Path) -> None:
    assert set(list_stock_robots()) == {"a", "b", "arm7", "g1_plain", "g1_hands", "leg_robot", *WALKERS}
    assert locate_robot("a") == stock / "a_description/urdf/dog.urdf"
    assert locate_robot("arm7") == stock / "arm_description/urdf/arm7.urdf"


def test_the_beginning_of_a_name_is_enough_where_one_robot_has_it(stock: Path) -> None:
    assert locate_robot("leg") == stock / "leg_description/urdf/leg_robot.urdf"
    with pytest.raises(DynidentError, match="begin with 'g1'; in place of 'g1' type one of: g1_hands, g1_plain"):
        locate_robot("g1")


@pytest.mark.parametrize("written", ["ARM-7", "arm 7", "Arm_7"])
def test_capitals_hyphens_and_spaces_do_not_count(stock: Path, written: str) -> None:
    assert locate_robot(written) == stock / "arm_description/urdf/arm7.urdf"


@pytest.mark.parametrize(("written", "name"), [("UR10e", "ur10e"), ("UR10", "ur10"), ("Franka Panda", "franka_panda")])
def test_an_arm_of_this_package_is_found_as_its_maker_writes_it(stock: Path, written: str, name: str) -> None:
    assert locate_robot(written) is None
    assert dy.load_robot(written).name == name
    with pytest.raises(DynidentError, match="there is no file"):
        locate_robot(f"../{written}")


def test_of_variants_of_one_robot_the_plain_one_is_meant(stock: Path) -> None:
    assert locate_robot("walker") == stock / "walker_description/urdf/walker_12dof_v1.urdf"
    assert locate_robot("walker_12dof_with_hand_v1").stem == "walker_12dof_with_hand_v1"


def test_a_file_comes_first_and_then_the_arms_of_this_package(stock: Path, tmp_path: Path) -> None:
    (tmp_path / "arm7").write_text("a table")
    assert locate_robot(str(tmp_path / "arm7")) == tmp_path / "arm7"
    (stock / "ur5.urdf").write_text("<robot name='another'/>")
    assert locate_robot("ur5") is None


def test_an_unknown_name_lists_what_there_is(stock: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        DynidentError, match=r"well-known robot 'crane'\. The robots are: .* scara, ur10, ur10e, ur5, a, arm7"
    ) as caught:
        locate_robot("crane")
    assert caught.value.pointer == "ROBOT"
    # Where one name is near, a hundred others would hide it.
    with pytest.raises(DynidentError, match=r"well-known robot 'ur100'; did you mean 'ur10' or 'ur10e'\?$"):
        locate_robot("ur100")
    monkeypatch.setattr("sys.path", [])
    with pytest.raises(DynidentError, match="pip install example-robot-data"):
        locate_robot("")


def test_every_arm_of_this_package_can_be_read() -> None:
    for name in list_library_arms():
        assert robot_from_library(name).n > 0
