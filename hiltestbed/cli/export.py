"""`hiltestbed export`: the extended model of a diagnosis for another simulator."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from hiltestbed.cli.options import Json

app = typer.Typer()


@app.command()
def export(
    diagnosis: Annotated[
        Path, typer.Argument(metavar="DIAGNOSIS", help="Folder that `diagnose` has written.")
    ],
    mjcf: Annotated[
        Path, typer.Option("--mjcf", metavar="FILE", help="MJCF file to write, for MuJoCo.")
    ],
    as_json: Json = False,
) -> None:
    """Write the extended model of a diagnosis as MJCF: a small model that loads, and what MuJoCo
    cannot say as a comment at its top.

    hiltestbed export runs/diagnosis-arm --mjcf arm.xml && python -m mujoco.viewer --mjcf arm.xml
    """
    from hiltestbed.analysis.export import export_mjcf

    found = export_mjcf(diagnosis, mjcf)
    if as_json:
        print(json.dumps({"file": str(mjcf), "said": found.said, "unsaid": found.unsaid}))
        return
    print(f"{mjcf}: written")
    print("".join(f"  {text}\n" for text in found.said), end="")
    if found.unsaid:
        print("MuJoCo cannot say:")
        print("".join(f"  {text}\n" for text in found.unsaid), end="")
