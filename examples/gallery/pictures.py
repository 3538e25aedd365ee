"""The pictures of the gallery: runs its notebooks and writes what each shows last beside it.

python examples/gallery/pictures.py [NAME ...]
"""

from __future__ import annotations

import base64
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbformat import NotebookNode

HERE = Path(__file__).resolve().parent
LONGEST = 500  # [s] that a cell may take


def notebooks() -> list[Path]:
    """The notebooks of the gallery."""
    return sorted(HERE.glob("*.ipynb"))


def executed(path: Path, folder: str | Path) -> NotebookNode:
    """The notebook with the outputs of its cells, run in ``folder``."""
    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory() as sockets:
        kernel = AsyncKernelManager(kernel_name="python3", transport="ipc", ip=f"{sockets}/kernel")
        NotebookClient(
            notebook, km=kernel, timeout=LONGEST, resources={"metadata": {"path": str(folder)}}
        ).execute()
    return notebook


def picture(notebook: NotebookNode) -> bytes:
    """The PNG that the last cell shows; empty where it shows none."""
    shown = [
        o["data"]["image/png"]
        for o in notebook.cells[-1].get("outputs", ())
        if "image/png" in o.get("data", {})
    ]
    return base64.b64decode(shown[-1]) if shown else b""


def main(names: list[str]) -> None:
    """The pictures of the notebooks that are named, of all where none is."""
    for path in notebooks():
        if not names or path.stem in names:
            with TemporaryDirectory() as folder:
                path.with_suffix(".png").write_bytes(picture(executed(path, folder)))


if __name__ == "__main__":
    main(sys.argv[1:])
