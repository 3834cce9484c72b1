"""`dynident remove`."""

from __future__ import annotations

from dynident_service.cli.options import Effects, Json, ModelArgument, Out


def remove(model: ModelArgument, effects: Effects, out: Out = None, as_json: Json = False) -> None:
    """Take effects out of a model.

    No measurement is needed: the model's file holds the reduced data.
    """
    from dynident.errors import DynidentError
    from dynident.identification import remove as remove_effects
    from dynident.identification import to_bytes
    from dynident_service.adapters.identifications import describe_identification
    from dynident_service.cli import inputs, shown, shown_ladders, terminal
    from dynident_service.models.common import plain

    identification = inputs.model_of(model)
    taken = inputs.named_effects(effects)
    if not taken:
        raise DynidentError("say what to remove: --effects", pointer="--effects")
    found = remove_effects(identification, taken)
    if out is not None:
        inputs.write_whole(out, to_bytes(found))
    if as_json:
        terminal.print_json(plain(describe_identification(found, model.stem, identification)))
        return
    console = terminal.out()
    shown_ladders.show_ladder(console, found)
    shown.show_identification(console, found, parameters=False)
    if out is not None:
        console.print(f"model written to {out}", markup=False)
