"""`dynident essential`."""

from __future__ import annotations

from typing import Annotated

import typer

from dynident_service.cli.options import Json, ModelArgument, Out


def essential(
    model: ModelArgument,
    ratio: Annotated[
        float, typer.Option("--ratio", help="Largest over smallest relative standard deviation to end at (§12.7).")
    ] = 10.0,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Find the essential parameters of a model by backward elimination.

    --out writes the model with the essential parameters estimated anew, the others at zero.
    """
    from dynident.identification import to_bytes
    from dynident.identification.study.essential import essential_parameters
    from dynident_service.adapters.identifications import describe_essential
    from dynident_service.cli import inputs, shown, terminal
    from dynident_service.models.common import plain

    found = essential_parameters(inputs.model_of(model), ratio)
    if out is not None:
        inputs.write_whole(out, to_bytes(found.identification))
    if as_json:
        terminal.print_json(plain(describe_essential(found)))
        return
    console = terminal.out()
    shown.show_essential(console, found)
    if out is not None:
        console.print(f"model written to {out}", markup=False)
