"""Links of the sources lead to what stands in the repository, so that they work where it is read;
on the site they lead to the pages that are made from it.

MkDocs calls :func:`on_page_markdown` while it builds.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGES = {  # in the repository, to the page of the site
    "examples/gallery": "gallery/index.md",
    "hiltestbed/effects": "reference/effects.md",
} | {
    f"examples/gallery/{path.name}": f"gallery/{path.stem}.md"
    for path in (ROOT / "examples" / "gallery").glob("*.ipynb")
}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """MkDocs' hook."""
    return for_the_site(markdown, page.file.src_uri)


def for_the_site(markdown: str, page: str) -> str:
    """The text of a page below docs, with the links that leave it led to the site's pages."""
    folder = posixpath.dirname(page)

    def led(found: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join("docs", folder, found[1]))
        return (
            f"]({posixpath.relpath(PAGES[target], folder or '.')}" if target in PAGES else found[0]
        )

    return re.sub(r"\]\(([^)#\s]+)", led, markdown)
