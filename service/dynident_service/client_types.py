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
ANSWERS_FOLDER = "src/dynident_client/answers"
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
_ANSWERS = {
    "comparisons": ("AutocorrelationView", "ComparisonResult", "ResidualMap", "Series", "Spectrum"),
    "designs": ("DesignClearances", "DesignResult", "SimulationResult"),
    "diagnoses": ("DiagnosisResult", "Evidence", "SeriesResult"),
    "identifications": (
        *("CorrelationView", "CurrentModelsResult", "EssentialView", "IdentificationResult", "Lineage"),
        *("ReportResult", "Tables", "VerdictView"),
    ),
    "resources": (
        *(
            "Catalogue",
            "CheckView",
            "GeometryView",
            "Health",
            "JointView",
            "MeshesView",
            "PosesView",
            "Problem",
            "QuestionView",
        ),
        *("RawSignals", "Readiness", "Standstills", "UsageView"),
    ),
    "validations": ("DriveGainsResult", "ValidationResult"),
}
"""What is answered, or stands in an answer, and the module of it: what jobs compute, what is read of it, resources."""
_SHARED = "parts"
"""The module of what stands in answers of several modules."""
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


def answer_types(contract: Contract) -> dict[str, str]:
    """The texts of the modules about what is answered, by their files' names."""
    schemas = contract["components"]["schemas"]
    reached = {module: _with_parts(schemas, names) for module, names in _ANSWERS.items()}
    homes: dict[str, str] = {}
    for module, schemas_of_it in reached.items():
        for name in schemas_of_it:
            homes[name] = module if name not in homes else _SHARED
    free = {name for name in homes if "properties" not in schemas[name]}
    by_module = {one: sorted(name for name in homes.keys() - free if homes[name] == one) for one in (*reached, _SHARED)}
    found = {}
    for module, names in by_module.items():
        shared = {part for name in names for part in _named(schemas[name], ())} & set(by_module[_SHARED])
        more = [_import(_SHARED, sorted(shared))] if shared and module != _SHARED else []
        classes = [_class(name, schemas[name], total=name not in _SPARSE) for name in names]
        text = "\n\n".join(["\n".join([_HEAD.replace("What requests take", "What is answered"), *more]), *classes])
        found[f"{module}.py"] = _answered(text, free)
    imports = [_import(one, names) for one, names in sorted(by_module.items())]
    everything = ["__all__ = [", *(f'    "{name}",' for name in sorted(homes.keys() - free)), "]", ""]
    words = '"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""\n\n'
    return {"__init__.py": words + "".join(imports) + "\n" + "\n".join(everything), **found}


def _answered(text: str, free: Iterable[str]) -> str:
    """The text of a module with answers: its containers are those of JSON, and what is `free` may be anything."""
    for name in free:
        text = text.replace(name, _ANYTHING)
    text = text.replace(_ABSTRACT, "").replace("Sequence[", "list[").replace("Mapping[", "dict[")
    needed = {"Any": "Any]" in text or ": Any" in text, "Literal": "Literal[" in text, "TypedDict": True}
    used = ", ".join(name for name, is_there in needed.items() if is_there)
    return text.replace("from typing import Any, Literal, TypedDict", f"from typing import {used}")


def _import(module: str, names: Sequence[str]) -> str:
    names = sorted(names, key=str.casefold)
    lines = "".join(f"    {name},\n" for name in names)
    one = f"from dynident_client.answers.{module} import {', '.join(names)}\n"
    return one if len(one) <= _WIDTH + 1 else f"from dynident_client.answers.{module} import (\n{lines})\n"


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
