"""What the client's methods take and give, from the contract: `requests.py`, `descriptions.py`, `answers.py` of it."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from keyword import iskeyword
from typing import Any, TypedDict

FILE = "src/dynident_client/requests.py"
DESCRIPTIONS_FILE = "src/dynident_client/descriptions.py"
ANSWERS_FILE = "src/dynident_client/answers.py"
_REQUESTS = {
    "IdentificationRequest": ("robot_id", "measurement_ids", "validation_ids", "effects"),
    "DesignRequest": ("robot_id", "kind"),
    "SimulationRequest": ("robot_id", "design_id", "trajectory", "effects"),
    "DiagnosisRequest": ("identification_id", "measurement_ids", "baseline_ids"),
    "DriveGainsRequest": ("robot_id", "unloaded", "loaded", "weigh", "weigh_unloaded"),
    "ReportRequest": ("identification_id", "diagnosis_id", "design_id", "validation_ids", "measurement_ids"),
    "ValidationRequest": ("identification_id", "kind", "measurement_ids"),
}
"""Bodies whose fields are keyword arguments, and those of them that the client's methods state themselves."""
_DESCRIPTIONS = {
    "MeasurementMetadata": ("robot_id", "name"),
    "RevisionRequest-Input": (),
    "RobotRequest": ("name", "description"),
}
"""The same of what is said of robots and recordings."""
_STATED = _REQUESTS | _DESCRIPTIONS
_ANSWERS = (
    *("ComparisonResult", "CurrentModelsResult", "DesignResult", "DiagnosisResult", "DriveGainsResult"),
    *("IdentificationResult", "ReportResult", "SeriesResult", "SimulationResult", "ValidationResult"),
    *("AutocorrelationView", "CorrelationView", "DesignClearances", "EssentialView", "Evidence", "GeometryView"),
    *("Lineage", "MeshesView", "RawSignals", "ResidualMap", "Series", "Spectrum", "Standstills", "VerdictView"),
    *("Catalogue", "CheckView", "Health", "JointView", "Problem", "QuestionView", "Readiness", "UsageView"),
)
"""What is answered, or stands in an answer: what jobs compute, what is read of it, and parts of the resources."""
_SPARSE = ("Problem", "ProblemField")
"""Answers without the fields that there is nothing to say of; all others have every field."""

_HEAD = '''"""What requests take, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict
'''
_ABSTRACT = "from collections.abc import Mapping, Sequence\n"
_ANYTHING = "Mapping[str, Any]"
_SIMPLE = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}
_WIDTH = 120


class Components(TypedDict):
    """Parts that a contract names: schemas by their names."""

    schemas: Mapping[str, Mapping[str, Any]]


class Contract(TypedDict):
    """An OpenAPI document, as far as types are written from it."""

    components: Components


def client_types(contract: Contract) -> str:
    """The text of the module about what is asked for."""
    schemas = contract["components"]["schemas"]
    return _module(_with_parts(schemas, _REQUESTS), ())


def description_types(contract: Contract) -> str:
    """The text of the module about what is said of robots and recordings."""
    schemas = contract["components"]["schemas"]
    wanted, there = _with_parts(schemas, _DESCRIPTIONS), _with_parts(schemas, _REQUESTS)
    return _module({name: one for name, one in wanted.items() if name not in there}, sorted(there.keys() & wanted))


def answer_types(contract: Contract) -> str:
    """The text of the module about what is answered."""
    schemas = contract["components"]["schemas"]
    wanted = _with_parts(schemas, _ANSWERS)
    free = [name for name, one in wanted.items() if "properties" not in one]
    classes = [_class(name, wanted[name], total=name not in _SPARSE) for name in sorted(wanted) if name not in free]
    text = "\n\n".join([_HEAD.replace("What requests take", "What is answered"), *classes])
    for name in free:
        text = text.replace(name, _ANYTHING)
    return text.replace(_ABSTRACT, "").replace("Sequence[", "list[").replace("Mapping[", "dict[")


def _with_parts(schemas: Mapping[str, Any], requests: Iterable[str]) -> dict[str, Any]:
    """The schemas of requests, and of all that they consist of."""
    wanted = {name: schemas[name] for name in requests}
    to_do = list(wanted)
    while to_do:
        name = to_do.pop()
        for other in _named(schemas[name], _STATED.get(name, ())):
            if other not in wanted:
                wanted[other] = schemas[other]
                to_do.append(other)
    return wanted


def _module(wanted: Mapping[str, Any], imported: Sequence[str]) -> str:
    classes = [_class(name, wanted[name]) for name in sorted(wanted)]
    choices = [one for name in sorted(_STATED.keys() & wanted) for one in _choices(name, wanted[name])]
    more = f"\nfrom dynident_client.requests import {', '.join(imported)}\n" if imported else ""
    head = f"{_HEAD}{more}" + "".join(["\n", *choices] if choices else [])
    text = "\n\n".join([head, *classes])
    takes_anything = any(": Any" in one or "Any]" in one for one in classes)
    return text if takes_anything else text.replace("import Any, Literal", "import Literal")


def _named(schema: Mapping[str, Any], but: tuple[str, ...]) -> Iterator[str]:
    text = json.dumps({name: one for name, one in schema.get("properties", {}).items() if name not in but})
    for part in text.split('"#/components/schemas/')[1:]:
        yield part.partition('"')[0]


def _class(name: str, schema: Mapping[str, Any], *, total: bool = False) -> str:
    but = _STATED.get(name, ())
    called = f"{_stem(name)}Options" if name in _STATED else name
    # What is a word of the language cannot be a field of a class.
    words = {field: _hint(about) for field, about in schema["properties"].items() if iskeyword(field)}
    above = f"_{called}" if words else "TypedDict"
    fields = ", ".join(f'"{field}": {hint}' for field, hint in words.items())
    lines = [f'{above} = TypedDict("{above}", {{{fields}}})', "", ""] if words else []
    lines += [f"class {called}({above}):" if total else f"class {called}({above}, total=False):"]
    lines += [f'    """{schema.get("description", name).splitlines()[0]}"""', ""]
    for field, about in schema["properties"].items():
        if field in but or field in words:
            continue
        lines += _field(field, about)
    return "\n".join(lines).rstrip() + "\n"


def _stem(name: str) -> str:
    """What a body asks for."""
    return re.sub("(Request|Metadata)(-Input)?$", "", name)


def _choices(name: str, schema: Mapping[str, Any]) -> Iterator[str]:
    """The fields that the methods state themselves and that are one of several, as a type each."""
    for field in _STATED[name]:
        if "enum" in (about := schema["properties"][field]):
            yield from (f"{line}\n" for line in _lines(f"{_stem(name)}{field.title()} =", _hint(about)))


def _field(name: str, about: Mapping[str, Any]) -> Iterator[str]:
    yield from _lines(f"    {name}:", _hint(about))
    if words := about.get("description"):
        first, *rest = textwrap.wrap(f'"""{words}"""', _WIDTH - 4, break_long_words=False)
        yield from (f"    {line}" for line in (first, *rest))


def _lines(head: str, hint: str) -> Iterator[str]:
    """A type behind what it is of, in as many lines as it takes."""
    if len(head) + len(hint) + 1 <= _WIDTH:
        yield f"{head} {hint}"
        return
    margin = head[: len(head) - len(head.lstrip())]
    names = hint.removeprefix("Literal[").replace("] | None", ", None").removesuffix("]")
    yield f"{head} Literal["
    yield from (f"{margin}    {one}," for one in names.split(", "))
    yield f"{margin}]"


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
        return f"Mapping[str, {_hint(values)}]" if isinstance(values, Mapping) else _ANYTHING
    return _SIMPLE.get(str(about.get("type")), "Any")
