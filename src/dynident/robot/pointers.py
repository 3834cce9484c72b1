"""JSON pointers (RFC 6901) and lists of names for messages."""

from __future__ import annotations

from collections.abc import Iterable


def pointer(*tokens: object, within: str = "") -> str:
    """Join `tokens` to the pointer `within`, escaping what RFC 6901 asks to escape."""
    escaped = (str(token).replace("~", "~0").replace("/", "~1") for token in tokens)
    return within + "".join(f"/{token}" for token in escaped)


def listed(names: Iterable[str]) -> str:
    """Names for a sentence: 'a, b, c', or 'none' where there are none."""
    return ", ".join(names) or "none"
