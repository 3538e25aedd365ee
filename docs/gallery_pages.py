"""The pages of the gallery, made from the notebooks in examples/gallery: text, code, and the
picture that each ends in.

MkDocs calls :func:`on_files` while it builds; nothing of this is kept on disk.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

GALLERY = Path(__file__).resolve().parents[1] / "examples" / "gallery"
# from the smallest
ORDER = ("five-lines", "delay-against-rebound", "compensations-compared", "a-diagnosis", "six-axes")


def on_files(files: Any, config: Any) -> Any:
    """MkDocs' hook: add pages, pictures and notebooks."""
    from mkdocs.structure.files import File

    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    for path in sorted((*GALLERY.glob("*.png"), *GALLERY.glob("*.ipynb"))):
        files.append(File.generated(config, f"gallery/{path.name}", abs_src_path=str(path)))
    return files


def pages() -> dict[str, str]:
    """Path below the documentation to Markdown text."""
    return {"gallery/index.md": overview()} | {f"gallery/{name}.md": page(name) for name in ORDER}


def page(name: str) -> str:
    """A notebook as a page."""
    cells = [_cell(cell) for cell in _notebook(name)["cells"]]
    picture = f"![{title(name)}]({name}.png)"
    return "\n\n".join([*cells, picture, f"[The notebook]({name}.ipynb)"]) + "\n"


def overview() -> str:
    """Each example with its picture."""
    lines = [
        "# Examples",
        "",
        "Notebooks, from five lines on. Each runs in a minute at most and ends in the picture "
        "that stands here.",
        "",
    ]
    for name in ORDER:
        lines += [
            f"## [{title(name)}]({name}.md)",
            "",
            f"[![{title(name)}]({name}.png)]({name}.md)",
            "",
        ]
    return "\n".join(lines)


def title(name: str) -> str:
    """Heading of a notebook."""
    return "".join(_notebook(name)["cells"][0]["source"]).partition("\n")[0].removeprefix("# ")


def _notebook(name: str) -> dict[str, Any]:
    return json.loads((GALLERY / f"{name}.ipynb").read_text(encoding="utf-8"))


def _cell(cell: Mapping[str, Any]) -> str:
    text = "".join(cell["source"])
    return text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```"
