"""`dynident essential`."""

from __future__ import annotations

from typing import Annotated

from dynident.identification.choices import EssentialChoices
from dynident_service.cli.options import ModelArgument, OutputOptions
from dynident_service.cli.request_options import RequestOptions, TypedValues


def essential(
    model: ModelArgument,
    request_options: Annotated[TypedValues, RequestOptions(EssentialChoices)],
    result: OutputOptions,
) -> None:
    """Find the essential parameters of a model by backward elimination.

    --out writes the model with the essential parameters estimated anew, the others at zero.
    """
    from dynident.identification import to_bytes
    from dynident.identification.study.essential_parameters import essential_parameters
    from dynident_service.adapters.identifications import describe_essential
    from dynident_service.cli import inputs, output, result_tables

    path = essential_parameters(inputs.load_model(model), request_options.build_request(EssentialChoices).ratio)
    output.write_result(
        result,
        "model",
        lambda: describe_essential(path),
        lambda console: result_tables.show_essential(console, path),
        lambda: to_bytes(path.identification),
    )
