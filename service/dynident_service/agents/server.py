"""The protocol server: lists tools, calls them in threads, reports progress, cancels."""

from __future__ import annotations

import json
import os
import threading
from base64 import b64encode
from pathlib import Path
from typing import Any

import anyio
from anyio import to_thread
from mcp import types
from mcp.server import Server, ServerRequestContext
from mcp.server.stdio import stdio_server
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from dynident.errors import Cancelled, DynidentError
from dynident.optional_dependencies import format_install_hint
from dynident.recordings import RecordingError
from dynident.reports.pdf_report import render_drawing
from dynident.version import __version__
from dynident_service.agents.arguments import Folder
from dynident_service.agents.tools import TOOLS, Answer, Tool
from dynident_service.measurements.adapters import describe_file_problem
from dynident_service.problems import Problem, make_problem, make_validation_problem, to_problem, to_problem_fields
from dynident_service.shared.wire_types import to_plain_json

_PERIOD = 0.25
"""Seconds between reports of progress."""
_RESOLUTION = 110.0
"""Pixels per inch of figures: as wide as models of today look at."""


class _Call:
    """One call of a tool, which a thread works on: how far it is, and whether somebody still waits for it."""

    # The numerics take all processors, and matplotlib is not made for several threads: calls wait for one another.
    _one_at_a_time = threading.Lock()

    def __init__(self, tool: Tool, folder: Folder, arguments: dict[str, Any]) -> None:
        self._tool, self._folder, self._arguments = tool, folder, arguments
        self.progress = (0.0, "")
        self.is_cancelled = False

    def run(self) -> Answer | Problem:
        """Do the work, in a thread; errors that the caller can mend come back as problems."""
        with self._one_at_a_time:
            try:
                self._report(0.0, "")
                given = self._tool.arguments.model_validate(self._arguments)
                return self._tool.call(self._folder, given, self._report)
            except ValidationError as error:
                return make_validation_problem(to_problem_fields(_locate(error), self._arguments))
            except RecordingError as error:
                return describe_file_problem(error)
            except DynidentError as error:
                return to_problem(error, {})
            except ModuleNotFoundError as missing:
                # Formats need packages that not everybody installs; a module of ours that is missing is a bug.
                if (missing.name or "").startswith("dynident"):
                    raise
                return make_problem(501, format_install_hint(missing.name or ""), title="Not installed")

    def _report(self, fraction: float, message: str) -> None:
        if self.is_cancelled:
            raise Cancelled
        self.progress = (fraction, message)


def _locate(error: ValidationError) -> list[ErrorDetails]:
    # Problems are worded for bodies of requests, whose places begin so.
    return [{**details, "loc": ("body", *details["loc"])} for details in error.errors()]


def create_server(folder: Folder) -> Server[dict[str, object]]:
    """Build the server. Its tools read and write in this folder alone."""
    tools = {tool.name: tool for tool in TOOLS}

    async def list_tools(
        _: ServerRequestContext[dict[str, Any]], __: types.PaginatedRequestParams | None
    ) -> types.ListToolsResult:
        return types.ListToolsResult(tools=[_describe_tool(tool) for tool in TOOLS])

    async def call_tool(
        context: ServerRequestContext[dict[str, Any]], params: types.CallToolRequestParams
    ) -> types.CallToolResult:
        if params.name not in tools:
            return _refuse(make_problem(404, f"There is no tool {params.name!r}.", title="Not found"))
        call = _Call(tools[params.name], folder, params.arguments or {})
        outcome: Answer | Problem
        async with anyio.create_task_group() as group:
            group.start_soon(_report_progress, call, context)
            try:
                # Left alone when the request is cancelled: the thread ends at its next report of progress.
                outcome = await to_thread.run_sync(call.run, abandon_on_cancel=True)
            finally:
                call.is_cancelled = True
            group.cancel_scope.cancel()
        return _refuse(outcome) if isinstance(outcome, Problem) else await to_thread.run_sync(_answer, outcome)

    return Server("dynident", version=__version__, on_list_tools=list_tools, on_call_tool=call_tool)


async def _report_progress(call: _Call, context: ServerRequestContext[dict[str, Any]]) -> None:
    reported = (0.0, "")
    while True:
        await anyio.sleep(_PERIOD)
        fraction, message = call.progress
        # The protocol wants numbers that grow.
        if fraction > reported[0]:
            reported = (fraction, message)
            await context.session.report_progress(fraction, 1.0, message)


def _describe_tool(tool: Tool) -> types.Tool:
    return types.Tool(
        name=tool.name,
        description=tool.description,
        input_schema=tool.arguments.model_json_schema(),
        output_schema=tool.result.model_json_schema(mode="serialization"),
        # No tool replaces a file, and none looks further than the folder.
        annotations=types.ToolAnnotations(
            read_only_hint=not tool.writes, destructive_hint=False, idempotent_hint=False, open_world_hint=False
        ),
    )


def _answer(answer: Answer) -> types.CallToolResult:
    content: list[types.ContentBlock] = [types.TextContent(text=answer.text)]
    if answer.figure is not None:
        picture = render_drawing(answer.figure.svg, "png", _RESOLUTION)
        content.append(types.ImageContent(data=b64encode(picture).decode(), mime_type="image/png"))
    return types.CallToolResult(content=content, structured_content=to_plain_json(answer.result))


def _refuse(problem: Problem) -> types.CallToolResult:
    document: dict[str, Any] = json.loads(problem.model_dump_json(exclude_none=True))
    return types.CallToolResult(
        content=[types.TextContent(text=f"{problem.title}: {problem.detail}")],
        structured_content=document,
        is_error=True,
    )


def serve_folder(root: Path) -> None:
    """Serve the tools over stdin and stdout until stdin ends."""
    os.chdir(root)
    server = create_server(Folder(Path()))

    async def run() -> None:
        async with stdio_server() as (read_stream, write_stream):
            await server.run(read_stream, write_stream, server.create_initialization_options())

    anyio.run(run)
