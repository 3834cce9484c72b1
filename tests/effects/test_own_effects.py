"""Effects that other distributions bring along: the documented example as written, and broken ones."""

from __future__ import annotations

import json
import shlex
import tomllib
from collections.abc import Mapping
from pathlib import Path

import pytest
from support.effect_columns import PUBLISHED
from support.own_effects_page import block, run

from dynident.robot import robot_from_library, urdf_from_robot


def install(folder: Path, module: str, code: str, points: Mapping[str, str]) -> None:
    """What an installer leaves behind: the module, and the entry points beside it."""
    (folder / f"{module}.py").write_text(code, encoding="utf-8")
    info = folder / f"{module}-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1\n", encoding="utf-8")
    lines = "\n".join(f"{name} = {value}" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[dynident.effects]\n{lines}\n", encoding="utf-8")


@pytest.fixture
def documented(tmp_path: Path) -> Path:
    points = tomllib.loads(block("toml"))["project"]["entry-points"]["dynident.effects"]
    install(tmp_path, "hose_friction", block("python"), points)
    return tmp_path


LISTED = """
import json, tempfile
from pathlib import Path
from fastapi.testclient import TestClient
from dynident.effects import CATALOGUE
from dynident.robot import robot_from_library
from dynident.simulation import VirtualRobot, build_typical_effect
from dynident_service.app import create_app
from dynident_service.settings import Settings

robot = robot_from_library("ur10")
sized = build_typical_effect(robot, "hose_friction", robot.joint_names[2])
VirtualRobot(robot, (sized,))
with tempfile.TemporaryDirectory() as folder:
    client = TestClient(create_app(Settings(data_dir=Path(folder))), "http://127.0.0.1")
    listed = {item["id"]: item for item in client.get("/v1/effects").json()["items"]}
print(json.dumps({
    "catalogue": list(CATALOGUE)[-1],
    "http": listed["hose_friction"],
    "size": dict(sized.values)["Fh"],
}))
"""


def test_the_documented_effect_is_in_the_catalogue_over_http_and_in_virtual_robots(documented: Path) -> None:
    answer = run(documented, LISTED)
    assert answer.returncode == 0, answer.stderr
    found = json.loads(answer.stdout.splitlines()[-1])
    assert found["catalogue"] == "hose_friction"
    assert found["http"]["title"] == "Friction of a wound hose"
    assert found["http"]["parameters"][0]["unit"] == "N m/rad"
    # 2 % of the joint's largest torque, 150 N m, over a random posture.
    assert 1.0 < found["size"] < 5.0


NAMED = """
import json
import numpy as np
from support.oracles import arm, fourier_motion, pinocchio_torque, record
from dynident.diagnosis import diagnose
from dynident.identification import IdentificationChoices, extend, identify
from dynident.recordings import Preprocessing

robot = arm("ur10")
motion = fourier_motion(robot, 30.0, 100.0, 1)
tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 3.0 * np.sign(motion.dq) + 2.0 * motion.dq
tau[:, 2] += 9.0 * np.abs(motion.q[:, 2] - 0.3) * np.sign(motion.dq[:, 2])
tau += 0.3 * np.random.default_rng(0).normal(size=tau.shape)
run = record(robot, motion, tau, "run")
plain = identify(robot, [run], [], IdentificationChoices(preprocessing=Preprocessing(10.0, 8.0, 3)))
first = diagnose(plain, [run]).recommended[0]
grown = extend(plain, [first], [run])
parameter = next(p for p in grown.parameters if p.name == "Fh3")
print(json.dumps([first.effect, list(first.joints), parameter.value, dict(parameter.shape)["q0"]]))
"""


@pytest.mark.slow
def test_the_documented_effect_is_named_by_a_diagnosis_where_it_is_in_the_data(documented: Path) -> None:
    answer = run(documented, NAMED)
    assert answer.returncode == 0, answer.stderr
    effect, joints, value, position = json.loads(answer.stdout.splitlines()[-1])
    assert (effect, joints) == ("hose_friction", ["elbow_joint"])
    assert value == pytest.approx(9.0, rel=0.05)
    assert position == pytest.approx(0.3, abs=0.05)


@pytest.mark.slow
def test_the_documented_commands_run_with_it(documented: Path) -> None:
    prepare = """
    dynident simulate ur10 --rate 50 --out run1.csv
    dynident identify ur10 run1.csv --out model.npz
    """
    (documented / "arm.urdf").write_text(urdf_from_robot(robot_from_library("ur10")), encoding="utf-8")
    for line in [*prepare.strip().splitlines(), *block("sh").splitlines()]:
        program, *arguments = shlex.split(line)
        assert program == "dynident"
        code = f"import os, sys; os.chdir({str(documented)!r}); sys.argv[1:] = {arguments!r}\n"
        ended = run(documented, code + "from dynident_cli.__main__ import main; main()")
        assert ended.returncode == 0, f"{line}\n{ended.stderr}"
        assert "hose_friction" in ended.stdout or arguments[0] != "effects"


BROKEN = """
from dynident.effects import Effect, ParameterSpec

class _Base(Effect):
    title, formula, signature, sources = "t", "f", "s", ("us",)
    parameters = (ParameterSpec("X", "N m", "x"),)
    def columns(self, signals, joints, shape):
        return [self._column(signals, self.parameters[0], j, signals.q[j]) for j in joints]

class Taken(_Base):
    id = "coulomb"

class Nameless(_Base):
    pass

class Failing(_Base):
    id = "failing"
    def columns(self, signals, joints, shape):
        raise RuntimeError("nobody has written this yet")

class Short(_Base):
    id = "short"
    def columns(self, signals, joints, shape):
        return []

class Good(_Base):
    id = "good"

class Again(_Base):
    id = "good"

instance = Good()
number = 3
"""


WHY = {
    "broken:Taken": "'coulomb' of broken:Taken is left out: another effect has this id",
    "broken:Nameless": "broken:Nameless is not an effect: derive it from dynident.effects.Effect and define id",
    "broken:number": "broken:number is not an effect",
    "broken:Missing": "(broken:Missing) cannot be loaded",
    "nowhere:Missing": "(nowhere:Missing) cannot be loaded: No module named 'nowhere'",
    "broken:Failing": "'failing' (broken:Failing) is left out: nobody has written this yet",
    "broken:Short": "'short' (broken:Short) is left out: its columns belong to []",
    "broken:Again": "'good' of broken:Again is left out: another effect has this id",
}


def test_broken_effects_are_left_out_with_a_warning_each_and_others_work(tmp_path: Path) -> None:
    points = {f"{k}": point for k, point in enumerate(["broken:instance", *WHY])}
    install(tmp_path, "broken", BROKEN, points)
    show = "print(len(CATALOGUE), type(CATALOGUE['good']).__name__)"
    answer = run(tmp_path, f"from dynident.effects import CATALOGUE; {show}")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.split() == [str(len(PUBLISHED) + 1), "Good"]
    for why in WHY.values():
        assert answer.stderr.count(why) == 1, (why, answer.stderr)
