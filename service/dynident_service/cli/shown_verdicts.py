"""Verdicts for people."""

from __future__ import annotations

from rich.console import Console

from dynident.verdict import ModelVerdict

STOPPED = 3
"""The exit code of a model that is not to be used."""


def show_verdict(console: Console, found: ModelVerdict) -> None:
    """What the model is fit for, why not, and what to do next."""
    if found.stop is not None:
        console.print(f"✕ {found.summary}", markup=False, style="bold red")
    else:
        for one in found.uses:
            mark, style = ("✓", "green") if one.fit else ("✕", "yellow")
            console.print(f"{mark} {one.use.replace('_', ' ')}: {one.reason}", markup=False, style=style)
    for step in found.next_steps:
        console.print(f"→ {step}", markup=False)
