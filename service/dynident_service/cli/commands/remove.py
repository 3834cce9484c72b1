"""`dynident remove`."""

from __future__ import annotations

from dynident_service.cli.options import Effects, ModelArgument, OutputOptions


def remove(model: ModelArgument, effects: Effects, result: OutputOptions) -> None:
    """Take effects out of a model.

    No measurement is needed: the model's file holds the reduced data.
    """
    from dynident.errors import DynidentError
    from dynident.identification import remove as remove_effects
    from dynident_service.cli import inputs, output

    identification = inputs.load_model(model)
    removed = inputs.parse_unchecked_effects(effects)
    if not removed:
        raise DynidentError("say what to remove: --effects", pointer="--effects")
    reduced_model = remove_effects(identification, removed)
    output.write_extended_model(result, reduced_model, model.stem, identification)
