"""`dynident campaign`: motion after motion, until the torque is predicted as well as asked for."""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.advice.campaign_request import MEASURES, MOTION_WORDS, CampaignRequest
from dynident.errors import DynidentError
from dynident.excitation.design_request import DesignRequest
from dynident_cli.commands.design import SafetyFiles
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_cli.shared_options import Effects, RobotArgument, RobotTimedReading, SomeFiles, file_option

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.advice.campaign import CampaignState, PlannedRun
    from dynident.api.recording_collection import CheckedRecording, Recordings
    from dynident.progress import Progress

EXIT_MISSED = 3
"""Exit code of a campaign that ended without reaching its goal."""
# Seconds between two looks for a recording, and how long its size must not have changed.
_LOOK, _SETTLED = 0.5, 2.0
_LONGEST_END = 30.0
"""Seconds that a command may take to stop the robot and end."""
UNFINISHED = ".part"
"""Ending of the file to which a command may write the rows so far; a run that goes wrong is then stopped early."""
# What a campaign decides itself, or has options of its own for.
_DECIDED = (
    *("kind", "effects", "criterion", "limits", "noise", "surroundings", "model"),
    *("sets", "speeds", "amplitudes", "joints"),
)


@dataclass(frozen=True)
class CampaignFiles(SafetyFiles):
    """Files of a campaign, and how the robot is moved."""

    region: Annotated[
        SomeFiles,
        file_option(
            "--region",
            help="Recording of your application, for whose motions the torque is to be predicted; may be repeated. "
            "By default, all motions within the limits, up to --speed.",
        ),
    ] = None
    folder: Annotated[
        Path, typer.Option("--folder", metavar="FOLDER", help="Folder for motions, recordings and the model.")
    ] = Path("campaign")
    execute: Annotated[
        str,
        typer.Option(
            "--execute",
            metavar="COMMAND",
            help="Command that moves the robot and records; {motion} and {recording} stand for the files. If it writes "
            "its rows to {recording}.part while it records, they are checked, and a faulty run is stopped. Without "
            "--execute, the campaign waits for the recording in the folder.",
        ),
    ] = ""


def campaign(
    robot: RobotArgument,
    effects: Effects,
    goal: Annotated[TypedValues, RequestOptions(CampaignRequest, but=("choices", "design"))],
    motion: Annotated[TypedValues, RequestOptions(DesignRequest, but=_DECIDED, words=MOTION_WORDS)],
    files: CampaignFiles,
    reading: RobotTimedReading,
) -> None:
    """Design, record and identify until torque is predicted well.

    The motion of run K is FOLDER/runK_motion.csv, its recording FOLDER/runK.csv (or another format). Recordings that
    are already there are used first, so the same command continues a campaign that was stopped. Runs take as long as
    --duration says, or half or a quarter of it. With --execute, the command waits for Enter before the first run with a
    load. Without a terminal it ends there; mount the load and repeat the command. The exit code is 3 if the goal was
    not reached.
    """
    from dynident.advice.campaign import add_run, plan_run, start_campaign
    from dynident.api.figure import join_figures
    from dynident.api.motion_design import DesignedMotion
    from dynident.excitation.criteria.prediction_region import collect_region
    from dynident.file_output import write_atomically
    from dynident.identification import to_bytes
    from dynident.presentation.design_tables import build_campaign_table
    from dynident.progress import ignore_progress, scale_progress
    from dynident.reports.figures.design import draw_campaign
    from dynident_cli import argument_loading, command_output
    from dynident_cli.contract_documents import load_limits, load_surroundings
    from dynident_cli.design_and_simulation_files import (
        choose_mesh_folders,
        print_warnings,
    )

    machine = argument_loading.load_robot_argument(robot, reading)
    request = goal.build_request(CampaignRequest)
    surroundings = load_surroundings(
        files.surroundings, choose_mesh_folders(machine, robot, files.meshes), floor=files.floor
    )
    design = replace(motion.build_request(DesignRequest), limits=load_limits(files.limits), surroundings=surroundings)
    chosen = argument_loading.read_effects(effects, machine)
    choices = replace(request.choices, effects=chosen) if chosen else request.choices
    folder = files.folder
    if folder.exists() and not folder.is_dir():
        raise DynidentError(f"{folder} is a file; give a folder", pointer="--folder", title="No folder")
    folder.mkdir(parents=True, exist_ok=True)
    console = command_output.message_console()

    def load(paths: Sequence[Path], progress: Progress) -> Recordings:
        return argument_loading.load_recordings(paths, machine, reading, progress)

    def read_rows(rows: Path) -> CheckedRecording:
        return load([rows], ignore_progress)[0]

    with command_output.show_progress_bar("region") as progress:
        states = collect_region(load(files.region, progress).recordings) if files.region else None
    state = start_campaign(machine, replace(request, choices=choices, design=design), states)
    while not state.decision.is_end:
        name, planned = f"run{len(state.runs) + 1}", None
        recording = _find_recording(folder, name)
        if recording is None:
            path = folder / f"{name}_motion.csv"
            was_told = path.exists()
            with command_output.show_progress_bar(f"designing {name}") as progress:
                planned = plan_run(state, progress)
            DesignedMotion(machine, planned.design).save(path)
            print_warnings(console, planned.design)
            console.print(_describe_plan(planned, path, MEASURES[request.goal][1]))
            if files.execute and state.is_load_due and len(state.runs) == request.unloaded_runs:
                _wait_for_load(console, was_told)
            recording = _record(console, files.execute, path, folder, name, state, planned, read_rows)
        with command_output.show_progress_bar(name) as progress:
            added = load([recording], scale_progress(progress, 0.0, 0.1)).recordings[0]
            state = add_run(state, added, planned, scale_progress(progress, 0.1, 1.0))
        assert state.identification is not None
        write_atomically(folder / "model.npz", to_bytes(state.identification))
        figure = join_figures([draw_campaign(state)], f"campaign with {machine.name}")
        write_atomically(folder / "campaign.svg", figure.svg.encode())
        console.print(f"{name}: {state.decision.sentence}")
    table = build_campaign_table(state.runs, state.request, state.robot.joint_names)
    results = command_output.result_console()
    command_output.print_tables(results, [table])
    for note in table.notes:
        results.print(note, style="dim")
    results.print(f"{state.decision.sentence} The model is {folder / 'model.npz'}.")
    if state.decision.code != "reached":
        raise typer.Exit(EXIT_MISSED)


def _describe_plan(planned: PlannedRun, path: Path, worst: str) -> str:
    from dynident.number_format import format_number, format_percent

    promise = (
        "It promises nothing yet."
        if planned.promised is None
        else f"It will leave an error of {format_percent(float(planned.promised.max()))} on the {worst}."
    )
    return f"{path}: the next motion, {format_number(planned.design.duration)} s. {promise}"


def _wait_for_load(console: Console, was_told: bool) -> None:
    """Wait until the load is mounted; without a terminal, end the first time that it is asked for."""
    if sys.stdin.isatty():
        typer.confirm("Is the load mounted, and is everybody away from the robot?", default=True, abort=True, err=True)
    elif not was_told:
        console.print("Mount the load, then give the same command again.")
        raise typer.Exit(EXIT_MISSED)


def _find_recording(folder: Path, name: str) -> Path | None:
    """Return the recording of a run, in whichever format, once it does not grow any more; None where there is none."""
    # A file that is still empty is none yet.
    files = sorted(
        path
        for path in folder.glob(f"{name}.*")
        if path.suffix != UNFINISHED and path.is_file() and path.stat().st_size
    )
    if not files:
        return None
    path, size, since = files[0], -1, time.monotonic()
    while time.monotonic() - since < _SETTLED:
        if path.stat().st_size != size:
            size, since = path.stat().st_size, time.monotonic()
        # A file that has been there for a while is not being written.
        if time.time() - path.stat().st_mtime > _SETTLED:
            break
        time.sleep(_LOOK)
    return path


def _record(
    console: Console,
    execute: str,
    motion: Path,
    folder: Path,
    name: str,
    state: CampaignState,
    planned: PlannedRun,
    read_rows: Callable[[Path], CheckedRecording],
) -> Path:
    """Have the robot moved, by a command or by hand, and return the recording."""
    recording = folder / f"{name}.csv"
    if not execute:
        console.print(f"Move the robot along {motion} and save the recording as {recording}. Ctrl-C stops waiting.")
        while (recorded := _find_recording(folder, name)) is None:
            time.sleep(_LOOK)
        return recorded
    rows = recording.with_name(recording.name + UNFINISHED)
    try:
        # Rows of a run that was ended before say nothing about this one.
        rows.unlink(missing_ok=True)
        # The words are split first: a path with spaces stays one argument.
        words = shlex.split(execute)
        command = [word.replace("{motion}", str(motion)).replace("{recording}", str(recording)) for word in words]
        process = subprocess.Popen(command)
    except (OSError, ValueError) as error:
        detail = f"{execute!r} cannot be run ({error}); give a program with its arguments, in quotes"
        raise DynidentError(detail, pointer="--execute", title="No recording") from error
    try:
        code = _watch(process, rows, state, planned, read_rows)
    finally:
        # Also where the campaign is interrupted: a program that goes on would move the robot unseen.
        _end(process)
    recorded = _find_recording(folder, name)
    if code or recorded is None:
        result = f"ended with code {code}" if code else f"wrote no {recording}"
        raise DynidentError(f"the command {shlex.join(command)} {result}", pointer="--execute", title="No recording")
    return recorded


def _watch(
    process: subprocess.Popen[bytes],
    rows: Path,
    state: CampaignState,
    planned: PlannedRun,
    read_rows: Callable[[Path], CheckedRecording],
) -> int:
    """Wait for a command, and end it where the rows that it has written so far are not worth going on with."""
    from dynident.api.campaigns import find_faults_under_way

    size, look = 0, _LOOK
    while True:
        try:
            return process.wait(look)
        except subprocess.TimeoutExpired:
            pass
        try:
            content = rows.read_bytes()
        except OSError:
            # None yet, or the run has just ended and they have their final name.
            continue
        if len(content) in (0, size):
            continue
        size, begun = len(content), time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            # Options name this run and those before it by their files.
            for neighbour in rows.parent.iterdir():
                Path(folder, neighbour.name).touch()
            complete = Path(folder, rows.stem)
            # The last line may be half written.
            complete.write_bytes(content.rpartition(b"\n")[0])
            try:
                reasons = find_faults_under_way(state, planned, partial(read_rows, complete))
            except DynidentError:
                # Rows of which nothing can be said yet; what is wrong with them is said once the run has ended.
                reasons = ()
        # The more rows there are, the longer a look takes: a fifth of the time at most.
        look = max(_LOOK, 4.0 * (time.monotonic() - begun))
        if reasons:
            _end(process)
            words = " ".join(reason.detail for reason in reasons)
            detail = f"{words} The command was ended; its rows are in {rows}. Correct this and repeat the command."
            raise DynidentError(detail, pointer="--execute", title="Run stopped")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ask a command to end, which has to stop the robot; after a while end it."""
    if process.poll() is not None:
        return
    process.terminate()
    try:
        process.wait(_LONGEST_END)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
