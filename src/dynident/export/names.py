"""Names for files and programs from a robot's name, and text that is safe inside comments."""

from __future__ import annotations

import re

_LONGEST = 40


def make_slug(name: str) -> str:
    """Return the name in characters for file names and identifiers: lower case letters, digits, underscores."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")[:_LONGEST].strip("_")
    return words or "robot"


def escape_c_comment(text: str) -> str:
    """Return text that is safe in a C comment: no comment marks, trigraphs or unprintable characters."""
    # Repeat until none is left: a blank between two characters can leave a new pair, as in "**//".
    for pair in ("*/", "/*", "??"):
        while pair in text:
            text = text.replace(pair, " ".join(pair))
    return replace_unprintable(text)


def escape_xml_comment(text: str) -> str:
    """Return text that may stand in an XML comment."""
    while "--" in text:
        text = text.replace("--", "- -")
    return replace_unprintable(text).rstrip("-")


def replace_unprintable(text: str) -> str:
    """Return the text with a blank for every character that cannot be seen."""
    return "".join(character if character.isprintable() else " " for character in text)
