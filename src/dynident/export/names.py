"""Names for files and programs that come from a user's name of a robot, and text that is safe inside comments."""

from __future__ import annotations

import re

_LONGEST = 40


def slug(name: str) -> str:
    """The name in the letters that file names and identifiers share: lower case, digits, underscores."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")[:_LONGEST].strip("_")
    return words or "robot"


def in_c_comment(text: str) -> str:
    """Text that neither ends a C comment nor begins another, and holds no trigraph nor unprintable character."""
    for pair in ("*/", "/*", "??"):
        while pair in text:
            text = text.replace(pair, " ".join(pair))
    return printable(text)


def in_xml_comment(text: str) -> str:
    """Text that may stand in an XML comment."""
    while "--" in text:
        text = text.replace("--", "- -")
    return printable(text).rstrip("-")


def printable(text: str) -> str:
    """The text with a blank for every character that cannot be seen."""
    return "".join(character if character.isprintable() else " " for character in text)
