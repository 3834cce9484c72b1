"""`python -m dynident_service.openapi [FILE]` writes the contract as the service has it, and the client's types."""

from __future__ import annotations

import json
import re
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from keyword import iskeyword
from pathlib import Path
from typing import Any, TypedDict

from dynident.schema.fields import LARGEST
from dynident_service.app import create_app
from dynident_service.settings import Settings

REQUESTS_FILE = "src/dynident_client/computation_options.py"
DESCRIPTIONS_FILE = "src/dynident_client/upload_options.py"
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
"""Bodies whose fields are keyword arguments of the client, each with the fields that its methods name themselves."""
_DESCRIPTIONS = {
    "MeasurementMetadata": ("robot_id", "name"),
    "RevisionRequest-Input": (),
    "RobotRequest": ("name", "description"),
}
"""The same for descriptions of robots and recordings."""
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
            "KnownRobots",
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
"""Schemas of answers, and of parts of answers, by the module that holds them."""
_SHARED = "shared_answers"
"""Module of the schemas that answers of several modules contain."""
_SPARSE = ("Problem", "ProblemField")
"""Answers that leave out empty fields; all others have every field."""

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
    """Named schemas of a contract."""

    schemas: Mapping[str, Mapping[str, Any]]


class Contract(TypedDict):
    """OpenAPI document, as far as types are generated from it."""

    components: Components


def build_request_types(contract: Contract) -> str:
    """Return the text of the module with the types of requests."""
    schemas = contract["components"]["schemas"]
    return _write_module(_collect_schemas(schemas, _REQUESTS), ())


def build_description_types(contract: Contract) -> str:
    """Return the text of the module with the types that describe robots and recordings."""
    schemas = contract["components"]["schemas"]
    schemas_by_name, there = _collect_schemas(schemas, _DESCRIPTIONS), _collect_schemas(schemas, _REQUESTS)
    return _write_module(
        {name: schema for name, schema in schemas_by_name.items() if name not in there},
        sorted(there.keys() & schemas_by_name),
    )


def build_answer_types(contract: Contract) -> dict[str, str]:
    """Return the texts of the modules with the types of answers, by file name."""
    schemas = contract["components"]["schemas"]
    reached = {module: _collect_schemas(schemas, names) for module, names in _ANSWERS.items()}
    homes: dict[str, str] = {}
    # A schema that answers of two modules contain moves to a shared one, so that neither imports the other.
    for module, schemas_of_it in reached.items():
        for name in schemas_of_it:
            homes[name] = module if name not in homes else _SHARED
    free = {name for name in homes if "properties" not in schemas[name]}
    # Schemas without properties are open objects: they become mappings, and no class of their own.
    by_module = {
        target: sorted(name for name in homes.keys() - free if homes[name] == target) for target in (*reached, _SHARED)
    }
    texts = {}
    # Each module imports from the shared one alone, so that none imports another of its kind.
    for module, names in by_module.items():
        shared = {part for name in names for part in _find_references(schemas[name], ())} & set(by_module[_SHARED])
        more = [_write_import(_SHARED, sorted(shared))] if shared and module != _SHARED else []
        classes = [_write_class(name, schemas[name], total=name not in _SPARSE) for name in names]
        text = "\n\n".join(["\n".join([_HEAD.replace("What requests take", "What is answered"), *more]), *classes])
        texts[f"{module}.py"] = _use_json_containers(text, free)
    imports = [_write_import(target, names) for target, names in sorted(by_module.items())]
    everything = ["__all__ = [", *(f'    "{name}",' for name in sorted(homes.keys() - free)), "]", ""]
    words = '"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""\n\n'
    return {"__init__.py": words + "".join(imports) + "\n" + "\n".join(everything), **texts}


def _use_json_containers(text: str, free: Iterable[str]) -> str:
    """Adapt the text of a module to answers: containers are those of JSON, and names in `free` accept anything."""
    for name in free:
        text = text.replace(name, _ANYTHING)
    text = text.replace(_ABSTRACT, "").replace("Sequence[", "list[").replace("Mapping[", "dict[")
    needed = {"Any": "Any]" in text or ": Any" in text, "Literal": "Literal[" in text, "TypedDict": True}
    used = ", ".join(name for name, is_there in needed.items() if is_there)
    return text.replace("from typing import Any, Literal, TypedDict", f"from typing import {used}")


def _write_import(module: str, names: Sequence[str]) -> str:
    names = sorted(names, key=str.casefold)
    lines = "".join(f"    {name},\n" for name in names)
    line = f"from dynident_client.answers.{module} import {', '.join(names)}\n"
    return line if len(line) <= _WIDTH + 1 else f"from dynident_client.answers.{module} import (\n{lines})\n"


def _collect_schemas(schemas: Mapping[str, Any], requests: Iterable[str]) -> dict[str, Any]:
    """Return schemas by name, with all schemas that they refer to."""
    collected = {name: schemas[name] for name in requests}
    to_do = list(collected)
    while to_do:
        name = to_do.pop()
        for other in _find_references(schemas[name], _STATED.get(name, ())):
            if other not in collected:
                collected[other] = schemas[other]
                to_do.append(other)
    return collected


def _write_module(schemas_by_name: Mapping[str, Any], imported: Sequence[str]) -> str:
    classes = [_write_class(name, schemas_by_name[name]) for name in sorted(schemas_by_name)]
    choices = [
        line
        for name in sorted(_STATED.keys() & schemas_by_name)
        for line in _write_choices(name, schemas_by_name[name])
    ]
    more = f"\nfrom dynident_client.computation_options import {', '.join(imported)}\n" if imported else ""
    head = f"{_HEAD}{more}" + "".join(["\n", *choices] if choices else [])
    text = "\n\n".join([head, *classes])
    takes_anything = any(": Any" in text_of_class or "Any]" in text_of_class for text_of_class in classes)
    return text if takes_anything else text.replace("import Any, Literal", "import Literal")


def _find_references(schema: Mapping[str, Any], but: tuple[str, ...]) -> Iterator[str]:
    text = json.dumps(
        {name: schema_of_field for name, schema_of_field in schema.get("properties", {}).items() if name not in but}
    )
    for part in text.split('"#/components/schemas/')[1:]:
        yield part.partition('"')[0]


def _write_class(name: str, schema: Mapping[str, Any], *, total: bool = False) -> str:
    but = _STATED.get(name, ())
    called = f"{_strip_suffix(name)}Options" if name in _STATED else name
    # A keyword of Python cannot be a field of a class; the functional form of TypedDict accepts it.
    words = {field: _write_hint(about) for field, about in schema["properties"].items() if iskeyword(field)}
    above = f"_{called}" if words else "TypedDict"
    fields = ", ".join(f'"{field}": {hint}' for field, hint in words.items())
    lines = [f'{above} = TypedDict("{above}", {{{fields}}})', "", ""] if words else []
    lines += [f"class {called}({above}):" if total else f"class {called}({above}, total=False):"]
    lines += [f'    """{schema.get("description", name).splitlines()[0]}"""', ""]
    for field, about in schema["properties"].items():
        if field in but or field in words:
            continue
        lines += _write_field(field, about)
    return "\n".join(lines).rstrip() + "\n"


def _strip_suffix(name: str) -> str:
    """Return the name of a body without its suffix."""
    return re.sub("(Request|Metadata)(-Input)?$", "", name)


def _write_choices(name: str, schema: Mapping[str, Any]) -> Iterator[str]:
    """Yield a type for each field with fixed choices that the methods name themselves."""
    for field in _STATED[name]:
        if "enum" in (about := schema["properties"][field]):
            yield from (
                f"{line}\n" for line in _wrap_type(f"{_strip_suffix(name)}{field.title()} =", _write_hint(about))
            )


def _write_field(name: str, about: Mapping[str, Any]) -> Iterator[str]:
    yield from _wrap_type(f"    {name}:", _write_hint(about))
    if words := about.get("description"):
        words += _write_range(about)
        first, *rest = textwrap.wrap(f'"""{words}"""', _WIDTH - 4, break_long_words=False)
        yield from (f"    {line}" for line in (first, *rest))


def _write_range(about: Mapping[str, Any]) -> str:
    """Return the range of a number, or of the numbers in a list, in brackets; "" where there is none of its own."""
    if "maximum" in about:
        low = f"above {about['exclusiveMinimum']:g}" if "exclusiveMinimum" in about else f"{about['minimum']:g}"
        return "" if (low, about["maximum"]) == (f"{-LARGEST:g}", LARGEST) else f" ({low} to {about['maximum']:g})"
    parts = [*about.get("anyOf", ()), *about.get("prefixItems", ())]
    parts += [about[name] for name in ("items", "additionalProperties") if isinstance(about.get(name), Mapping)]
    return next((text for part in parts if (text := _write_range(part))), "")


def _wrap_type(head: str, hint: str) -> Iterator[str]:
    """Yield a type annotation, split over several lines if it is too long."""
    if len(head) + len(hint) + 1 <= _WIDTH:
        yield f"{head} {hint}"
        return
    margin = head[: len(head) - len(head.lstrip())]
    names = hint.removeprefix("Literal[").replace("] | None", ", None").removesuffix("]")
    yield f"{head} Literal["
    yield from (f"{margin}    {name}," for name in names.split(", "))
    yield f"{margin}]"


def _write_hint(about: Mapping[str, Any]) -> str:
    if "$ref" in about:
        return str(about["$ref"]).rpartition("/")[2]
    if "anyOf" in about:
        return " | ".join(dict.fromkeys(_write_hint(member) for member in about["anyOf"]))
    if "enum" in about or "const" in about:
        return f"Literal[{', '.join(json.dumps(value) for value in about.get('enum', [about.get('const')]))}]"
    if "prefixItems" in about:
        return f"tuple[{', '.join(_write_hint(member) for member in about['prefixItems'])}]"
    if about.get("type") == "array":
        return f"Sequence[{_write_hint(about.get('items', {}))}]"
    if about.get("type") == "object":
        values = about.get("additionalProperties")
        return f"Mapping[str, {_write_hint(values)}]" if isinstance(values, Mapping) else _ANYTHING
    return _SIMPLE.get(str(about.get("type")), "Any")


CONTRACT_FILE = Path("openapi/openapi.json")


def render_contract() -> str:
    """Return the OpenAPI document in the form in which it is committed."""
    return json.dumps(create_app(Settings()).openapi(), sort_keys=True, indent=1)


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else CONTRACT_FILE
    target.write_text(render_contract(), encoding="utf-8")
    if target == CONTRACT_FILE:
        document = json.loads(render_contract())
        Path(REQUESTS_FILE).write_text(build_request_types(document), encoding="utf-8")
        for name, text in build_answer_types(document).items():
            Path(ANSWERS_FOLDER, name).write_text(text, encoding="utf-8")
        Path(DESCRIPTIONS_FILE).write_text(build_description_types(document), encoding="utf-8")
