"""The docs site, from the repository's own pages and docstrings; needs no network, and neither does who reads it.

    pip install 'dynident[docs]'
    python docs/build_site.py [FOLDER]

Builds FOLDER/<version> (`site/` where none is named) beside the versions that are there, and a page that leads to
them; the pages that are notebooks as well lie in its docs/. Ends with an error where the generator warns, a link or an
anchor leads nowhere, a page would ask another machine for something, or a public name has no entry in the reference.
"""

from __future__ import annotations

import html
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "src"))
FRONT = "README.html"
FETCHED = re.compile(r"(?:@import|url\()\s*['\"]?((?:https?:)?//[^'\")]+)")


class Page(HTMLParser):
    """What a page leads to, what it loads, and the places in it that a link may name."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep what the tag says of links, loads and places."""
        said = {name: value for name, value in attrs if value is not None}
        self.anchors |= {said[name] for name in ("id", "name") if name in said}
        if tag == "a" and "href" in said:
            self.links.append(said["href"])
        elif tag == "link" and said.get("rel") in ("stylesheet", "icon", "preload", "modulepreload", "preconnect"):
            self.loaded.append(said["href"])
        elif "src" in said:
            self.loaded.append(said["src"])


def main() -> None:
    """Build one version, look at it, and lead to it."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "site"
    from dynident.version import __version__

    place = folder / __version__
    build(place)
    faults = [*dead_ends(place), *requests(place), *without_entry(place)]
    if faults:
        sys.exit("\n".join([*faults, f"{len(faults)} faults in {place}"]))
    lead_to_versions(folder)
    pages = len(list(place.rglob("*.html")))
    print(f"{place}: {pages} pages, no dead link, no request to other machines, an entry for every public name")


def build(place: Path) -> None:
    """One version; every warning is an error."""
    with tempfile.TemporaryDirectory() as notes:
        options = ["--fail-on-warning", "--keep-going", "--quiet", "-c", str(ROOT / "docs"), "-d", notes]
        done = subprocess.run([sys.executable, "-m", "sphinx", *options, str(ROOT), str(place)], check=False)
    if done.returncode != 0:
        sys.exit(done.returncode)
    (place / "index.html").write_text(redirect(FRONT), encoding="utf-8")
    subprocess.run([sys.executable, str(ROOT / "docs" / "notebooks.py"), str(place / "docs")], check=True)


def redirect(target: str) -> str:
    """A page that leads on."""
    return f'<!doctype html><meta http-equiv="refresh" content="0; url={target}"><a href="{target}">dynident</a>\n'


def dead_ends(place: Path) -> Iterator[str]:
    """Links within the site whose file or anchor is not there."""
    page = cache(Page)
    for file in sorted(place.rglob("*.html")):
        for link in [*page(file).links, *page(file).loaded]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            if target.is_dir():
                target /= "index.html"
            if not target.exists():
                yield f"{file.relative_to(place)}: no file {link}"
            elif parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in page(target).anchors:
                yield f"{file.relative_to(place)}: no anchor {link}"


def requests(place: Path) -> Iterator[str]:
    """What a page or a style sheet would fetch from another machine."""
    for file in sorted(place.rglob("*.html")):
        for source in Page(file).loaded:
            if urlsplit(source).netloc:
                yield f"{file.relative_to(place)}: loads {source}"
    for file in sorted(place.rglob("*.css")):
        for source in FETCHED.findall(file.read_text(encoding="utf-8")):
            yield f"{file.relative_to(place)}: loads {source}"


def without_entry(place: Path) -> Iterator[str]:
    """Public names, by the packages' own `__all__`, that have no entry: neither there nor in the room they are from."""
    anchors = {anchor for file in (place / "docs" / "reference").glob("*.html") for anchor in Page(file).anchors}
    modules = {package: import_module(package) for package in public_packages()}
    for package, module in modules.items():
        for name in module.__all__:
            value = getattr(module, name)
            homes = [room for room, its in modules.items() if getattr(its, name, None) is value]
            if name != "__version__" and not {f"{home}.{name}" for home in homes} & anchors:
                yield f"{package}.{name} has no entry in the reference"


def public_packages() -> list[str]:
    """The packages whose names are public: dynident, its rooms, and the client."""
    homes = [*(ROOT / "src").glob("*/__init__.py"), *(ROOT / "src" / "dynident").glob("*/__init__.py")]
    stated = [home.parent for home in homes if "\n__all__ = [" in home.read_text(encoding="utf-8")]
    return sorted(".".join(home.relative_to(ROOT / "src").parts) for home in stated)


def lead_to_versions(folder: Path) -> None:
    """The page above all versions: the newest first, one click from each."""
    versions = sorted((one.parent.name for one in folder.glob("*/index.html")), key=_order, reverse=True)
    rows = "".join(f'<li><a href="{html.escape(one)}/{FRONT}">dynident {html.escape(one)}</a></li>' for one in versions)
    text = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>dynident</title><ul>{rows}</ul></html>\n'
    only = redirect(f"{versions[0]}/{FRONT}") if len(versions) == 1 else text
    (folder / "index.html").write_text(only, encoding="utf-8")


def _order(version: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"[.+]", version)]


if __name__ == "__main__":
    main()
