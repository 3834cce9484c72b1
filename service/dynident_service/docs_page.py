"""The page `/docs`: the HTTP contract on one page without scripts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from fastapi import FastAPI
from fastapi.responses import HTMLResponse

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 62rem; padding: 0 1rem }
:root { color-scheme: light dark }
code, .path { font-family: ui-monospace, monospace } .verb { display: inline-block; width: 5rem; font-weight: 600 }
details { border-top: 1px solid #8884; padding: .35rem 0 } summary { cursor: pointer }
table { border-collapse: collapse }
td, th { text-align: left; vertical-align: top; padding: .15rem .8rem .15rem 0 } h3 { margin-top: 1.6rem }
"""
# The page has no scripts and loads nothing: browsers are told to refuse both.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"


def mount_docs_page(app: FastAPI) -> None:
    """Serve the page, which is no part of the contract."""
    pages: list[str] = []  # made when first asked for: the contract does not change while the service runs

    @app.get("/docs", include_in_schema=False)
    def documentation() -> HTMLResponse:
        if not pages:
            contract = app.openapi()
            pages.append(render_page(contract["info"], contract["paths"], contract["components"]["schemas"]))
        return HTMLResponse(pages[0], headers={"Content-Security-Policy": POLICY})


def render_page(
    info: Mapping[str, str],
    paths: Mapping[str, Mapping[str, Mapping[str, object]]],
    schemas: Mapping[str, Mapping[str, object]],
) -> str:
    """Render an OpenAPI document as HTML."""
    title = f"{escape(info['title'])} {escape(info['version'])}"
    body = [
        f"<h1>{title}</h1><p>{escape(info['description'])}</p>",
        "<p>This page shows <a href='/openapi.json'>/openapi.json</a> for people.</p>",
        *_render_operations(paths),
        "<h2>Schemas</h2>",
        *(_render_schema(name, schema) for name, schema in sorted(schemas.items())),
    ]
    head = f"<meta charset='utf-8'><meta name='viewport' content='width=device-width'><title>{title}</title>"
    return (
        f"<!doctype html><html lang='en'><head>{head}<style>{STYLE}</style></head><body>{''.join(body)}</body></html>"
    )


def _render_operations(paths: Mapping[str, Any]) -> Iterator[str]:
    by_tag: dict[str, list[str]] = {}
    for path, operations in paths.items():
        for verb, operation in operations.items():
            # An operation stands in the section of its first tag.
            tag = (operation.get("tags") or ["other"])[0]
            by_tag.setdefault(tag, []).append(_render_operation(path, verb, operation))
    for tag, parts in by_tag.items():
        yield f"<h3>{escape(tag)}</h3>{''.join(parts)}"


def _render_operation(path: str, verb: str, operation: Mapping[str, Any]) -> str:
    description = escape(operation.get("description") or operation.get("summary", ""))
    rows = [
        (
            f"<code>{escape(parameter['name'])}</code> in {parameter['in']}",
            _render_type(parameter["schema"]),
            parameter.get("description", ""),
        )
        for parameter in operation.get("parameters", ())
    ]
    for kind, content in operation.get("requestBody", {}).get("content", {}).items():
        rows.append((f"body, {escape(kind)}", _render_type(content.get("schema", {})), ""))
    for status, answer in operation["responses"].items():
        for kind, content in answer.get("content", {}).items():
            rows.append((f"answer {escape(status)}, {escape(kind)}", _render_type(content.get("schema", {})), ""))
    head = f"<span class='verb'>{verb.upper()}</span><span class='path'>{escape(path)}</span>"
    return f"<details><summary>{head}</summary><p>{description}</p>{_render_table(rows)}</details>"


def _render_schema(name: str, schema: Mapping[str, Any]) -> str:
    required = schema.get("required", ())
    rows = [
        (
            f"<code>{escape(field)}</code>{'' if field in required else ' (optional)'}",
            _render_type(about),
            about.get("description", ""),
        )
        for field, about in schema.get("properties", {}).items()
    ]
    description = escape(schema.get("description", ""))
    named = escape(name)
    return (
        f"<details id='{named}' "
        f"open><summary><b>{named}</b></summary><p>{description}</p>{_render_table(rows)}</details>"
    )


def _render_table(rows: list[tuple[str, str, str]]) -> str:
    """Render rows of a name and a type, both HTML, and a plain text."""
    cells = "".join(
        f"<tr><td>{name}</td><td>{kind}</td><td>{escape(description)}</td></tr>" for name, kind, description in rows
    )
    return f"<table>{cells}</table>"


def _render_type(schema: Mapping[str, Any]) -> str:
    """Render the type of a value in a few words."""
    if "$ref" in schema:
        name = escape(schema["$ref"].rpartition("/")[2])
        return f"<a href='#{name}'>{name}</a>"
    for choice in ("anyOf", "oneOf", "allOf"):
        if choice in schema:
            return " or ".join(_render_type(member) for member in schema[choice])
    if "enum" in schema:
        return " or ".join(f"<code>{escape(str(value))}</code>" for value in schema["enum"])
    if "const" in schema:
        return f"<code>{escape(str(schema['const']))}</code>"
    if schema.get("type") == "array":
        return f"list of {_render_type(schema.get('items', {}))}"
    if isinstance(schema.get("additionalProperties"), dict):
        return f"map to {_render_type(schema['additionalProperties'])}"
    # A schema without a type takes any value.
    return escape(str(schema.get("type", "anything")))
