"""Checks a built site: every link leads somewhere in it, and to open a page asks nobody outside.

python docs/offline.py FOLDER
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADED = re.compile(r"""(?:url\(|@import)\s*["']?((?:https?:)?//[^"')]+)""")
"""What a style sheet takes from outside."""


class Page(HTMLParser):
    """What a page names: its anchors, its links, and what a browser loads to show it."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links, self.loaded = set(), set(), set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        """Take in one tag."""
        found = dict(attributes)
        self.anchors |= {found.get("id"), found.get("name")}
        address = found.get("href") or found.get("src") or found.get("data")
        if address:
            (self.links if tag == "a" else self.loaded).add(address)


def faults(site):
    """Return a line for each link that leads nowhere, and each thing that comes from outside."""
    pages = {file: Page(file.read_text(encoding="utf-8")) for file in sorted(site.rglob("*.html"))}
    found = []
    for file, page in pages.items():
        for address in sorted(page.links | page.loaded):
            parts = urlsplit(address)
            if parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                if address in page.loaded:
                    found.append(f"{file}: loads {address}")
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            if not target.is_file():
                found.append(f"{file}: no file {address}")
            elif (
                parts.fragment
                and target in pages
                and unquote(parts.fragment) not in pages[target].anchors
            ):
                found.append(f"{file}: no place {address}")
    for file in sorted(site.rglob("*.css")):
        loaded = _LOADED.findall(file.read_text(encoding="utf-8"))
        found += [f"{file}: loads {address}" for address in loaded]
    return found


if __name__ == "__main__":
    site = Path(sys.argv[1]).resolve()
    said = faults(site)
    print("\n".join([*said, f"{len(list(site.rglob('*.html')))} pages, {len(said)} faults"]))
    sys.exit(bool(said))
