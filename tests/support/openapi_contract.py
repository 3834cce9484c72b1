"""The committed contract, as tests of the client look at it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import httpx2

CONTRACT = json.loads((Path(__file__).parents[2] / "openapi" / "openapi.json").read_text(encoding="utf-8"))
OPERATIONS = frozenset(
    str(operation["operationId"]) for path in CONTRACT["paths"].values() for operation in path.values()
)

COLLECTIONS = (
    "robots",
    "imports",
    "measurements",
    "designs",
    "campaigns",
    "simulations",
    "identifications",
    "comparisons",
    "diagnoses",
    "next_experiments",
    "series",
    "validations",
    "drive_gains",
    "current_models",
    "reports",
)
"""What a client has of resources that are listed."""


def operation_of(request: httpx2.Request) -> str:
    """The operation of the contract that a request is."""
    found = [
        (template.count("{"), operations[request.method.lower()]["operationId"])
        for template, operations in CONTRACT["paths"].items()
        if re.fullmatch(re.sub(r"{\w+}", "[^/]+", template), request.url.path) and request.method.lower() in operations
    ]
    assert found, f"{request.method} {request.url.path} is not in the contract"
    return str(min(found)[1])
