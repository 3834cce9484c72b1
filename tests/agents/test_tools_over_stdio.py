"""`dynident mcp` as an agent meets it: a process of its own, spoken to by the client of the protocol's package."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import anyio
import numpy as np
import pytest
from anyio.from_thread import BlockingPortal, start_blocking_portal
from support.small_arm_files import ARM, write_run

import dynident as dy
from dynident.robot import urdf_from_robot

mcp = pytest.importorskip("mcp", reason="the tools for agents need the package mcp (the extra mcp)")

SECRET = "t,q1,tau1\n0,4711,4712\n"


class Agent:
    """A client that is connected to a server for one folder."""

    def __init__(self, portal: BlockingPortal, client: Any, folder: Path) -> None:
        self.portal, self.client, self.folder = portal, client, folder
        self.progress: list[tuple[float, str | None]] = []

    def call(self, name: str, **arguments: Any) -> Any:
        self.progress.clear()
        return self.portal.call(self._call, name, arguments)

    def result(self, name: str, **arguments: Any) -> Any:
        answer = self.call(name, **arguments)
        assert not answer.is_error, answer.content
        return answer.structured_content

    def refusal(self, name: str, **arguments: Any) -> Any:
        answer = self.call(name, **arguments)
        assert answer.is_error
        # The text for people says the same as the data.
        assert answer.content[0].text == "{title}: {detail}".format(**answer.structured_content)
        return answer.structured_content

    async def _call(self, name: str, arguments: dict[str, Any]) -> Any:
        return await self.client.call_tool(name, arguments, progress_callback=self._keep)

    async def _keep(self, progress: float, total: float | None, message: str | None) -> None:
        assert total == 1.0
        self.progress.append((progress, message))

    def cancel(self, name: str, **arguments: Any) -> None:
        """Call a tool and cancel the call when it has reported something."""

        async def call_and_cancel() -> None:
            with anyio.CancelScope() as scope:

                async def stop(progress: float, total: float | None, message: str | None) -> None:
                    scope.cancel()

                await self.client.call_tool(name, arguments, progress_callback=stop)
            assert scope.cancelled_caught

        self.portal.call(call_and_cancel)


def command(folder: Path) -> list[str]:
    return [sys.executable, "-m", "dynident_cli", "mcp", "--folder", str(folder)]


@pytest.fixture(scope="module")
def agent(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Agent]:
    outside = tmp_path_factory.mktemp("outside")
    folder = outside / "folder"
    folder.mkdir()
    (outside / "secret.csv").write_text(SECRET)
    (outside / "secret.urdf").write_text(urdf_from_robot(ARM))
    (folder / "arm.urdf").write_text(urdf_from_robot(ARM))
    write_run(folder / "run1.csv", 1)
    write_run(folder / "run2.csv", 2)
    (folder / "link.csv").symlink_to(outside / "secret.csv")
    (folder / "linked").symlink_to(outside)
    (folder / "loop.csv").symlink_to("loop.csv")
    (folder / "inside.csv").symlink_to("run1.csv")
    program, *options = command(folder)
    server = mcp.StdioServerParameters(command=program, args=options, env=dict(os.environ))
    with start_blocking_portal() as portal, portal.wrap_async_context_manager(mcp.Client(server)) as client:
        yield Agent(portal, client, folder)


def test_a_tool_is_described_by_the_library_and_its_arguments_with_their_ranges(agent: Agent) -> None:
    tools = {tool.name: tool for tool in agent.portal.call(agent.client.list_tools).tools}
    functions = ["inspect", "identify", "diagnose", "design", "changes", "validate"]
    assert list(tools) == ["inspect", "identify", "diagnose", "why_not", "design", "changes", "validate", "export"]
    for name in functions:
        assert tools[name].description == getattr(dy, name).__doc__.split("\n\n")[0]
    assert all(tool.output_schema["type"] == "object" and tool.output_schema["properties"] for tool in tools.values())
    assert tools["identify"].input_schema["properties"]["prior_error"]["maximum"] == 10
    assert {name for name, tool in tools.items() if tool.annotations.read_only_hint} == {
        *("inspect", "why_not", "changes", "validate"),
    }


@pytest.mark.slow
def test_from_two_files_to_a_named_effect_and_a_file_for_a_simulator(agent: Agent) -> None:
    runs = {"robot": "arm.urdf", "recordings": ["run1.csv"], "validation": ["run2.csv"]}
    assert agent.result("inspect", file="run1.csv", robot="arm.urdf")["questions"] == []
    answer = agent.call("identify", **runs, out="model.npz")
    model = dy.load_model(agent.folder / "model.npz")
    identified = answer.structured_content
    assert identified["validation"]["relative_total"] == pytest.approx(model.held_out.relative_total)
    assert [parameter["value"] for parameter in identified["parameters"]] == pytest.approx(
        [parameter.value for parameter in model.parameters]
    )
    assert identified["verdict"]["summary"] in answer.content[0].text
    assert str(model.summary()) in answer.content[0].text
    assert base64.b64decode(answer.content[1].data).startswith(b"\x89PNG")
    fractions = [fraction for fraction, _ in agent.progress]
    assert fractions == sorted(fractions)
    assert fractions

    diagnosis = agent.result(
        "diagnose", model="model.npz", recordings=["run1.csv"], candidates=["stribeck", "backlash"], out="d.json"
    )
    (found,) = diagnosis["recommended"]
    assert (found["effect"], found["joints"]) == ("stribeck", [ARM.joint_names[0]])
    reason = agent.result("why_not", diagnosis="d.json", effect="backlash", joint=ARM.joint_names[1])
    (same,) = (
        outcome["reason"]
        for outcome in diagnosis["outcomes"]
        if outcome["effect"] == "backlash" and outcome["joints"] == [ARM.joint_names[1]]
    )
    assert reason == same
    # A part that the robot does not have is not tried.
    part = {"has_not": ["gravity_compensator"]}
    agent.result("diagnose", model="model.npz", recordings=["run1.csv"], **part, out="without.json")
    absent = agent.result("why_not", diagnosis="without.json", effect="gravity_compensator", joint=ARM.joint_names[1])
    assert absent["code"] == "not_tried"

    # What a diagnosis recommends goes in as it came out.
    better = agent.result("identify", **runs, effects=["default", found], out="better.npz")
    assert better["validation"]["relative_total"] < 0.6 * identified["validation"]["relative_total"]
    tests = agent.result("validate", model="better.npz", recordings=["run1.csv"], validation=["run2.csv"])
    assert tests["verdict"] == "pass"
    assert [test["verdict"] for test in tests["tests"]] == ["pass"] * 3
    written = agent.result("export", model="better.npz", out="arm.c")
    assert written["size"] == (agent.folder / "arm.c").stat().st_size
    same_arm = {"before": ["run1.csv"], "after": ["run2.csv"], "candidates": ["offset"]}
    assert agent.result("changes", model="better.npz", **same_arm)["changes"] == []
    assert agent.call("changes", model="better.npz", **{**same_arm, "candidates": []}).is_error


@pytest.mark.slow
def test_a_designed_motion_is_a_file_and_a_picture(agent: Agent) -> None:
    options = {"kind": "random", "trajectory": {"duration": 4}, "random_trajectories": 5}
    answer = agent.call("design", robot="scara", **options, out="motion.csv")
    assert not answer.is_error, answer.content
    rows = np.loadtxt(agent.folder / "motion.csv", delimiter=",", skiprows=1)
    assert len(rows) == answer.structured_content["n_samples"]
    assert answer.content[1].mime_type == "image/png"


@pytest.mark.parametrize(
    "path",
    [
        "../secret.csv",
        "../../etc/passwd",
        "link.csv",
        "linked/secret.csv",
        "linked/folder/../secret.csv",
        "run1.csv+../secret.csv",
        "run1.csv+link.csv",
        "loop.csv",
        "nul\0.csv",
        "x" * 900 + ".csv",
    ],
)
def test_nothing_outside_of_the_folder_is_read(agent: Agent, path: str) -> None:
    calls: list[tuple[str, dict[str, Any]]] = [
        ("inspect", {"file": path, "robot": "scara"}),
        ("identify", {"robot": "scara", "recordings": ["run1.csv", {"path": path}], "out": "none.npz"}),
        ("identify", {"robot": "scara", "recordings": ["run1.csv"], "validation": [path], "out": "none.npz"}),
        ("design", {"robot": path, "out": "none.csv"}),
        ("why_not", {"diagnosis": path, "effect": "stribeck"}),
        ("export", {"model": path, "out": "none.urdf"}),
    ]
    for name, arguments in calls:
        problem = agent.refusal(name, **arguments)
        assert problem["title"] in ("Outside of the folder", "No such file"), problem
        assert "4711" not in json.dumps(problem)


def test_an_absolute_path_is_as_good_as_where_it_leads(agent: Agent) -> None:
    secret = agent.folder.parent / "secret.csv"
    assert agent.refusal("inspect", file=str(secret))["title"] == "Outside of the folder"
    assert agent.refusal("inspect", file="/nowhere.csv")["title"] == "Outside of the folder"
    assert agent.result("inspect", file=str(agent.folder / "run1.csv"))["format"] == "csv"
    assert agent.result("inspect", file="inside.csv")["format"] == "csv"


@pytest.mark.parametrize("out", ["run1.csv", "../new.csv", "linked/new.csv", "link.csv", "nowhere/new.csv"])
def test_nothing_is_replaced_and_nothing_is_written_outside(agent: Agent, out: str) -> None:
    before = {path: path.read_bytes() for path in agent.folder.parent.rglob("*") if path.is_file()}
    problem = agent.refusal("design", robot="scara", kind="random", out=out)
    assert problem["errors"][0]["pointer"] == "/out"
    assert {path: path.read_bytes() for path in agent.folder.parent.rglob("*") if path.is_file()} == before


def test_xacro_which_reads_what_it_likes_is_refused(agent: Agent) -> None:
    text = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="{}"/></robot>'
    (agent.folder / "arm.xacro").write_text(text.format(agent.folder.parent / "secret.urdf"))
    assert agent.refusal("inspect", file="run1.csv", robot="arm.xacro")["title"] == "Unusable xacro"


_MODEL = '<mujoco><include file="../secret.xml"/></mujoco>'


@pytest.mark.parametrize(
    "content",
    [_MODEL.encode(), f"data: '{_MODEL}'".encode(), f"\ufeff{_MODEL}".encode("utf-16-le"), _MODEL.encode("utf-16")],
    ids=["plain", "printed", "utf-16-le", "utf-16"],
)
def test_a_model_that_includes_files_is_refused(agent: Agent, content: bytes) -> None:
    (agent.folder / "arm.xml").write_bytes(content)
    refusal = agent.refusal("inspect", file="run1.csv", robot="arm.xml")
    assert (refusal["title"], refusal["errors"][0]["pointer"]) == ("Unusable MJCF", "/robot")


def test_files_of_another_logger_are_read_as_proposed_and_the_agent_is_told(agent: Agent) -> None:
    head, *rows = (agent.folder / "run1.csv").read_text().replace('"', "").splitlines()
    other = head.replace("tau", "actual torque ").replace("q", "actual position ")
    (agent.folder / "foreign.csv").write_text("\n".join([other.replace("toractual position ue", "torque"), *rows]))
    answer = agent.call("identify", robot="arm.urdf", recordings=["foreign.csv"], out="foreign.npz")
    assert "foreign, columns: Read as t: t; q: actual position 1" in answer.content[0].text
    # What is answered for some columns leaves the others as proposed.
    answered = {"path": "foreign.csv", "columns": {"q1": "actual position 1"}}
    assert not agent.call("identify", robot="arm.urdf", recordings=[answered], out="answered.npz").is_error


def test_open_questions_and_cures_are_asked_in_the_syntax_of_the_tools(agent: Agent) -> None:
    rows = (agent.folder / "run1.csv").read_text().splitlines()
    # Rows without a time, and torques that nobody calls so.
    head = rows[0].replace('"', "").replace("tau", "load").split(",")
    kept = [k for k, name in enumerate(head) if name != "t"]
    table = [[line.split(",")[k] for k in kept] for line in [",".join(head), *rows[1:]]]
    (agent.folder / "unknown.csv").write_text("\n".join(map(",".join, table)))
    refusal = agent.refusal("identify", robot="arm.urdf", recordings=["unknown.csv"], out="x.npz")
    assert '"rate": …' in refusal["detail"]
    assert "dy." not in refusal["detail"]
    assert "metadata=" not in refusal["detail"]


def test_a_refusal_is_the_problem_document_of_the_service(agent: Agent) -> None:
    wrong = agent.refusal("identify", robot="scara", recordings=["run1.csv"], out="x.npz", prior_error=11, bogus=1)
    assert {field["pointer"] for field in wrong["errors"]} == {"/prior_error", "/bogus"}
    assert agent.refusal("nothing")["type"] == "urn:dynident:problem:not-found"
    rows = (agent.folder / "run1.csv").read_text().splitlines()
    # The torques of two joints are exchanged: the finding carries its cure.
    head = rows[0].replace("tau1", "x").replace("tau2", "tau1").replace("x", "tau2")
    (agent.folder / "exchanged.csv").write_text("\n".join([head, *rows[1:]]))
    problem = agent.refusal("identify", robot="arm.urdf", recordings=["exchanged.csv"], out="x.npz")
    cures = [check["apply"] for check in problem["checks"] if check["apply"]]
    assert cures == [{"permutation": {"tau": [2, 1, *range(3, ARM.n + 1)]}}]
    assert not (agent.folder / "x.npz").exists()


@pytest.mark.slow
def test_a_call_that_is_cancelled_ends_and_the_next_one_is_answered(agent: Agent) -> None:
    agent.result("identify", robot="arm.urdf", recordings=["run1.csv"], out="for_cancelling.npz")
    agent.cancel("diagnose", model="for_cancelling.npz", recordings=["run1.csv"], out="cancelled.json")
    start = time.monotonic()
    assert agent.result("inspect", file="run1.csv")["format"] == "csv"
    # The whole catalogue takes minutes; its next report of progress is what the call waits for.
    assert time.monotonic() - start < 60
    assert not (agent.folder / "cancelled.json").exists()


NOISY = """
import os, sys
from pathlib import Path
from dynident_service.agents import arguments, server, tools

def inspect(folder, given, progress):
    print("noise from Python")
    os.write(1, b"noise from C")
    os.system("echo noise from a child")
    return tools._inspect(folder, given, progress)

server.TOOLS = tuple(tools.replace(tool, call=inspect) if tool.name == "inspect" else tool for tool in tools.TOOLS)
server.serve_folder(Path(sys.argv[1]))
"""


def test_only_messages_of_the_protocol_reach_stdout(agent: Agent) -> None:
    information = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "raw", "version": "1"}}
    messages = [
        {"id": 1, "method": "initialize", "params": information},
        {"method": "notifications/initialized"},
        {"id": 2, "method": "tools/call", "params": {"name": "inspect", "arguments": {"file": "run1.csv"}}},
    ]
    program = [sys.executable, "-c", NOISY, str(agent.folder)]
    with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        for message in messages:
            server.stdin.write(json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n")
        server.stdin.flush()
        answers = [json.loads(server.stdout.readline()) for _ in range(2)]
        server.stdin.close()
        assert server.stdout.read() == b""
    assert [answer["id"] for answer in answers] == [1, 2]
    assert answers[1]["result"]["structuredContent"]["format"] == "csv"


def test_a_folder_that_is_not_there_is_said_so(tmp_path: Path) -> None:
    ended = subprocess.run(command(tmp_path / "none"), capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 2
    assert "there is no folder" in ended.stderr
