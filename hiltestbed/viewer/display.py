"""`hiltestbed view`: opens the recording of a run."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.process.output import has_display

RECORDING = "recording.rrd"


def view(folder: str | Path) -> None:
    """Open the recording of a run folder, or a recording, in the rerun viewer; returns when its
    window is closed.

    Raises:
        InputError: there is no recording.
        HiltestbedError: this machine has no display, or the viewer failed; the message says what to
            do.
    """
    path = Path(folder)
    recording = path / RECORDING if path.is_dir() else path
    if not recording.is_file():
        raise InputError(
            f"{folder}: has no {RECORDING}; allowed is a folder that `hiltestbed run --out` wrote, "
            "or a .rrd file; run the scenario again without --no-rerun"
        )
    if not has_display():
        raise HiltestbedError(
            "no display on this machine (neither DISPLAY nor WAYLAND_DISPLAY is set). Write a "
            f"picture, hiltestbed view {folder} --png run.png; or copy "
            f"{recording} to a machine with one and run `rerun {recording.name}` there, or serve "
            f"it from here to a browser: rerun {recording} --serve-web"
        )
    status = subprocess.run([str(viewer_binary()), str(recording)], check=False).returncode
    if status != 0:
        raise HiltestbedError(
            f"the rerun viewer ended with status {status}; to view it in a browser: rerun "
            f"{recording} --serve-web"
        )


def viewer_binary() -> Path:
    """The viewer binary of rerun-sdk; a `rerun` script that is ended leaves its viewer running."""
    spec = find_spec("rerun_cli")
    binary = (
        Path(spec.origin).with_name("rerun.exe" if sys.platform == "win32" else "rerun")
        if spec and spec.origin
        else None
    )
    if binary is None or not binary.is_file():
        raise HiltestbedError(
            "the rerun viewer is not installed; install it with: pip install "
            "'rerun-sdk>=0.41,<0.42'"
        )
    return binary
