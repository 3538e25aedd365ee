"""One self-contained HTML page: headings, text, tables and figures, without external resources."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

from jinja2 import Environment
from markupsafe import Markup, escape

from hiltestbed.run_folder.folders import FIGURES_APART, safe_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTTED = re.compile(r"(?<=[a-z0-9_])\.(?=[a-z_])")  # the dots in a scenario key or in a file name
LONGEST_NAME = 48  # characters of the caption in a figure's file name

_HTML = Environment(autoescape=True)
_PAGE = _HTML.from_string("""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
:root { color-scheme: light; --ink: #1b2530; --soft: #5b6b7a; --line: #d9e0e6; --accent: #0b6e99; --paper: #ffffff; --shade: #f4f7f9 }
body { font: 15px/1.55 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 72rem; margin: 2rem auto;
  padding: 0 1rem; overflow-wrap: anywhere }
h1 { font-size: 1.7rem; margin-bottom: .2rem } h2 { margin-top: 2.2rem; border-bottom: 1px solid var(--line); padding-bottom: .2rem }
p.lead { font-size: 1.15rem; border-left: 4px solid var(--accent); padding: .3rem .9rem; background: var(--shade) }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums } th, td { padding: .25rem .7rem; text-align: right }
th { background: var(--shade); border-bottom: 2px solid var(--line) } td { border-bottom: 1px solid var(--line) }
th:first-child, td:first-child, .words { text-align: left } figure { margin: 1.2rem 0 } figure img { max-width: 100% }
figcaption, .soft { color: var(--soft); font-size: .92rem } pre { background: var(--shade); padding: .6rem .9rem; white-space: pre-wrap }
.scroll { overflow-x: auto } th { overflow-wrap: normal; vertical-align: bottom } td { overflow-wrap: break-word; max-width: 22rem }
p.warning { border-left: 4px solid #d55e00; padding: .3rem .9rem; background: #fdf3ec }
@media (max-width: 40rem) { body { font-size: 14px; margin: .5rem auto } h1 { font-size: 1.35rem }
  th, td { padding: .2rem .35rem; font-size: 12px }
  figure .scroll img { max-width: none; width: calc(var(--wide) * .62px) } }
</style></head><body><h1>{{ title }}</h1>{% for part in parts %}{{ part }}{% endfor %}</body></html>
""")
# a dotted key may break after a dot, nothing before a per cent sign
_HTML.filters["cell"] = lambda cell: Markup(
    DOTTED.sub(".<wbr>", escape(str(cell).replace(" %", "\N{NO-BREAK SPACE}%")))
)
_TABLE = _HTML.from_string(
    '<div class="scroll"><table>{% for tag, cells in lines %}<tr>{% for cell in cells %}<{{ tag }}'
    '{% if words[loop.index0] %} class="words"{% endif %}>{{ cell | cell }}</{{ tag }}>{% endfor %}'
    '</tr>{% endfor %}</table></div>{% if caption %}<p class="soft">{{ caption }}</p>{% endif %}'
)


class Report:
    """A page, written from top to bottom."""

    def __init__(self, title: str) -> None:
        self.title = title
        self._parts: list[Markup] = []
        self._apart: list[tuple[str, bytes, bytes]] = []

    def lead(self, text: str) -> None:
        """The finding, in a sentence."""
        self._parts.append(Markup('<p class="lead">{}</p>').format(text))

    def heading(self, text: str) -> None:
        self._parts.append(Markup("<h2>{}</h2>").format(text))

    def text(self, text: str) -> None:
        self._parts.append(Markup("<p>{}</p>").format(text))

    def warning(self, text: str) -> None:
        """A highlighted warning."""
        self._parts.append(Markup('<p class="warning"><b>Warning:</b> {}</p>').format(text))

    def items(self, texts: Sequence[str]) -> None:
        """A list."""
        self._parts.append(
            Markup("<ul>{}</ul>").format(
                Markup("").join(Markup("<li>{}</li>").format(text) for text in texts)
            )
        )

    def code(self, text: str) -> None:
        self._parts.append(Markup("<pre>{}</pre>").format(text))

    def table(
        self, header: Sequence[str], rows: Sequence[Sequence[object]], caption: str = ""
    ) -> None:
        """Cells are escaped; numbers should come formatted."""
        words = [i > 0 and _words([row[i] for row in rows]) for i in range(len(header))]
        lines = [("th", header), *(("td", row) for row in rows)]
        self._parts.append(Markup(_TABLE.render(lines=lines, words=words, caption=caption)))

    def figure(self, figure: Figure, caption: str = "") -> None:
        """A matplotlib figure, as a PNG inside the page."""
        data = io.BytesIO()
        figure.savefig(
            data, format="png", dpi=110, bbox_inches="tight", metadata={"Software": None}
        )
        # width from the PNG header; narrow screens scroll the figure
        wide = int.from_bytes(data.getvalue()[16:20], "big")
        source = Markup("data:image/png;base64," + base64.b64encode(data.getvalue()).decode())
        image = Markup(
            '<div class="scroll"><img alt="{}" style="--wide: {}" src="{}"></div>'
        ).format(caption, wide, source)
        self._parts.append(
            Markup("<figure>{}<figcaption>{}</figcaption></figure>").format(image, caption)
        )
        if FIGURES_APART.get():
            name = f"{len(self._apart) + 1:02d}-{safe_name(shorten(caption, LONGEST_NAME, placeholder=''))}"
            self._apart.append((name, data.getvalue(), _as_svg(figure)))

    def html(self) -> str:
        return _PAGE.render(title=self.title, parts=self._parts)

    def write(self, path: Path) -> None:
        """Write the page, and the folder ``figures`` beside it if requested by
        :data:`hiltestbed.run_folder.folders.FIGURES_APART`.
        """
        # the name of a file may contain bytes that are no UTF-8
        path.write_text(self.html(), encoding="utf-8", errors="backslashreplace")
        for name, png, svg in self._apart:
            folder = path.parent / "figures"
            folder.mkdir(exist_ok=True)
            (folder / f"{name}.png").write_bytes(png)
            (folder / f"{name}.svg").write_bytes(svg)


def _as_svg(figure: Figure) -> bytes:
    """The figure as SVG; the same figure gives the same bytes."""
    from matplotlib import rc_context

    data = io.BytesIO()
    with rc_context({"svg.hashsalt": "hiltestbed"}):
        figure.savefig(
            data, format="svg", bbox_inches="tight", metadata={"Date": None, "Creator": None}
        )
    return data.getvalue()


def provenance(versions: Mapping[str, str], plugins: Mapping[str, str]) -> list[tuple[str, str]]:
    """Table rows: each package with its version, each plugin with the start of its hash."""
    return [
        *versions.items(),
        *((f"plugin {name}", digest[:16]) for name, digest in plugins.items()),
    ]


def _words(cells: Sequence[object]) -> bool:
    """Whether a column contains mostly text, which is left-aligned; numbers are right-aligned."""
    firsts = [str(cell)[:1] for cell in cells if str(cell)]
    return 2 * sum(first.isalpha() for first in firsts) > len(firsts)


def new_figure(width: float = 8.0, height: float = 4.0, **subplots: object):
    """A figure and its axes, independent of display and pyplot, whose state stays as it is."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(**subplots)  # type: ignore[arg-type]
