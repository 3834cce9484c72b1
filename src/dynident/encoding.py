"""Text as bytes, whatever is in it."""

from __future__ import annotations

import re

NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
"""Characters that no XML document may hold, not even escaped."""


def without_control_characters(text: str) -> str:
    """Return a text that an XML document may hold: what it may not is replaced by the sign for that."""
    return NOT_XML.sub("\ufffd", text)


def encode_text(text: str) -> bytes:
    r"""Encode a text as UTF-8; halves of surrogate pairs, which have no code, are written as escapes: "\ud800".

    Names of files that are no UTF-8 hold such halves, and so may JSON.
    """
    return text.encode("utf-8", "backslashreplace")


def encodable(text: str) -> str:
    """Return the text as `encode_text` writes it, for what encodes by itself."""
    return encode_text(text).decode("utf-8")
