"""The notebooks of the gallery: each runs, ends in a picture, and is kept without outputs."""

from __future__ import annotations

import io
from pathlib import Path

import nbformat
import pytest

from tests.scripts import module
from tests.slow import SLOW, slow

ROOT = Path(__file__).parents[2]
GALLERY = ROOT / "examples" / "gallery"
NOTEBOOKS = sorted(GALLERY.glob("*.ipynb"))
LONG = ("a-diagnosis", "six-axes")
BLANK = 5e3  # [bytes] that a picture with nothing in it takes at most


@pytest.mark.parametrize(
    "path", [slow(p) if p.stem in LONG else p for p in NOTEBOOKS], ids=[p.stem for p in NOTEBOOKS]
)
def test_a_notebook_runs_and_ends_in_a_picture(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process, where the loops are compiled."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    monkeypatch.chdir(tmp_path)
    pyplot.close("all")
    namespace: dict[str, object] = {}
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "code":
            # what is run is this repository's own gallery
            exec(compile(cell.source, path.name, "exec"), namespace)
    assert pyplot.get_fignums()
    shown = io.BytesIO()
    pyplot.savefig(shown)
    pyplot.close("all")
    assert len(shown.getvalue()) > BLANK


@SLOW
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_shows_its_picture_in_its_kernel(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the kernel's own shows the picture in the notebook
    monkeypatch.delenv("MPLBACKEND", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pictures = module(GALLERY / "pictures.py")
    picture = pictures.picture(pictures.executed(path, tmp_path))
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > BLANK


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_is_kept_without_outputs_and_with_its_picture_beside_it(path: Path) -> None:
    cells = nbformat.read(path, as_version=4).cells
    assert all(not c.get("outputs") and c.get("execution_count") is None for c in cells)
    assert cells[0].source.startswith("# ")
    assert path.with_suffix(".png").stat().st_size > BLANK


def test_every_notebook_is_a_page_of_the_site() -> None:
    pages = module(ROOT / "docs" / "gallery_pages.py")
    assert sorted(pages.ORDER) == [path.stem for path in NOTEBOOKS]
    listed = (ROOT / "mkdocs.yml").read_text()
    for name, text in pages.pages().items():
        assert f"- {name}" in listed
        assert name == "gallery/index.md" or text.count("```python") >= 1
