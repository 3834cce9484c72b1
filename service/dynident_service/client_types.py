"""What the client's methods take, written from the contract: `dynident_client/requests.py`."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

FILE = "src/dynident_client/requests.py"
_REQUESTS = {
    "IdentificationRequest": ("robot_id", "measurement_ids", "validation_ids", "effects"),
    "DesignRequest": ("robot_id", "kind"),
    "SimulationRequest": ("robot_id", "design_id", "trajectory", "effects"),
    "ValidationRequest": ("identification_id", "kind", "measurement_ids", "name"),
}
"""Bodies whose fields are keyword arguments, and those of them that the client's methods state themselves."""

_HEAD = '''"""What requests take, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict
'''
_SIMPLE = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}
_WIDTH = 120


def client_types(contract: Mapping[str, Any]) -> str:
    """The module's text."""
    schemas = contract["components"]["schemas"]
    wanted = {name: schemas[name] for name in _REQUESTS}
    to_do = list(_REQUESTS)
    while to_do:
        name = to_do.pop()
        for other in _named(schemas[name], _REQUESTS.get(name, ())):
            if other not in wanted:
                wanted[other] = schemas[other]
                to_do.append(other)
    classes = [_class(name, wanted[name]) for name in sorted(wanted)]
    text = "\n\n".join([_HEAD, *classes])
    takes_anything = any(": Any" in one or "Any]" in one for one in classes)
    return text if takes_anything else text.replace("import Any, Literal", "import Literal")


def _named(schema: Mapping[str, Any], but: tuple[str, ...]) -> Iterator[str]:
    text = json.dumps({name: one for name, one in schema.get("properties", {}).items() if name not in but})
    for part in text.split('"#/components/schemas/')[1:]:
        yield part.partition('"')[0]


def _class(name: str, schema: Mapping[str, Any]) -> str:
    but = _REQUESTS.get(name, ())
    called = name.removesuffix("Request") + "Options" if name in _REQUESTS else name
    lines = [f"class {called}(TypedDict, total=False):"]
    lines += [f'    """{schema.get("description", name).splitlines()[0]}"""', ""]
    for field, about in schema["properties"].items():
        if field in but:
            continue
        lines += _field(field, about)
    return "\n".join(lines).rstrip() + "\n"


def _field(name: str, about: Mapping[str, Any]) -> Iterator[str]:
    hint = _hint(about)
    if len(hint) + len(name) + 6 > _WIDTH:
        members = hint.removeprefix("Literal[").removesuffix("]").split(", ")
        yield f"    {name}: Literal["
        yield from (f"        {one}," for one in members)
        yield "    ]"
    else:
        yield f"    {name}: {hint}"
    if words := about.get("description"):
        first, *rest = textwrap.wrap(words, _WIDTH - 10)
        yield f'    """{first}' + ("" if rest else '"""')
        yield from (f"    {line}" for line in rest)
        if rest:
            yield '    """'
        yield ""


def _hint(about: Mapping[str, Any]) -> str:
    if "$ref" in about:
        return str(about["$ref"]).rpartition("/")[2]
    if "anyOf" in about:
        return " | ".join(dict.fromkeys(_hint(one) for one in about["anyOf"]))
    if "enum" in about or "const" in about:
        return f"Literal[{', '.join(json.dumps(one) for one in about.get('enum', [about.get('const')]))}]"
    if "prefixItems" in about:
        return f"tuple[{', '.join(_hint(one) for one in about['prefixItems'])}]"
    if about.get("type") == "array":
        return f"Sequence[{_hint(about.get('items', {}))}]"
    if about.get("type") == "object":
        values = about.get("additionalProperties")
        return f"Mapping[str, {_hint(values)}]" if isinstance(values, Mapping) else "Mapping[str, Any]"
    return _SIMPLE.get(str(about.get("type")), "Any")
