"""`dynident essential`."""

from __future__ import annotations

from typing import Annotated

from dynident.identification.essential_choices import EssentialChoices
from dynident_service.cli.asked import RequestOptions, TypedValues
from dynident_service.cli.options import ModelArgument, OutputOptions


def essential(
    model: ModelArgument,
    request_options: Annotated[TypedValues, RequestOptions(EssentialChoices)],
    result: OutputOptions,
) -> None:
    """Find the essential parameters of a model by backward elimination.

    --out writes the model with the essential parameters estimated anew, the others at zero.
    """
    from dynident.identification import to_bytes
    from dynident.identification.study.essential import essential_parameters
    from dynident_service.adapters.identifications import describe_essential
    from dynident_service.cli import inputs, shown, telling

    path = essential_parameters(inputs.load_model(model), request_options.build_request(EssentialChoices).ratio)
    telling.write_result(
        result,
        "model",
        lambda: describe_essential(path),
        lambda console: shown.show_essential(console, path),
        lambda: to_bytes(path.identification),
    )
