"""Has schemathesis ask for what there is: hooks that put the ids of a service's resources into most of its cases.

Loaded by schemathesis (`SCHEMATHESIS_HOOKS`) in an environment of its own, so it imports nothing of ours.
"""

from __future__ import annotations

import json
import os
import random
from typing import Any

import schemathesis

IDS: dict[str, list[str]] = json.loads(os.environ["DYNIDENT_KNOWN_IDS"])
"""Ids of what is there, by kind ("robot", …, "job")."""
OFTEN, SELDOM = 0.85, 0.05
FIELDS = {
    "robot_id": "robot",
    "meshes_of": "robot",
    "design_id": "design",
    "identification_id": "identification",
    "against": "identification",
    "measurement_id": "measurement",
    "diagnosis_id": "diagnosis",
    "import_id": "import",
    "continues": "series",
    "measurement_ids": "measurement",
    "validation_ids": "measurement",
    "baseline_ids": "measurement",
    "earlier_ids": "measurement",
    "unloaded": "measurement",
    "loaded": "measurement",
    "weigh": "measurement",
}
chance = random.Random(1)


@schemathesis.hook
def map_path_parameters(context: Any, path_parameters: Any) -> Any:
    # What is deleted is not there any more for the other cases.
    often = SELDOM if context.operation.method.lower() == "delete" else OFTEN
    return {
        name: chance.choice(IDS[name.removesuffix("_id")])
        if IDS.get(name.removesuffix("_id")) and chance.random() < often
        else value
        for name, value in (path_parameters or {}).items()
    }


@schemathesis.hook
def map_query(_context: Any, query: Any) -> Any:
    return known(query)


@schemathesis.hook
def map_body(_context: Any, body: Any) -> Any:
    return known(body)


def known(value: Any) -> Any:
    """The same with ids that exist in most fields that take one."""
    if isinstance(value, list):
        return [known(one) for one in value]
    if not isinstance(value, dict):
        return value
    found = {name: known(one) for name, one in value.items()}
    for name, kind in FIELDS.items():
        if name in found and IDS.get(kind) and chance.random() < OFTEN:
            one = chance.choice(IDS[kind])
            found[name] = [one] if isinstance(found[name], list) else one
    return found
