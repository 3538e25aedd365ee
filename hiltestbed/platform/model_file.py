"""The compiled MuJoCo model of a rig as a file: platform, mechanisms, sensor, in one."""

from __future__ import annotations

from pathlib import Path

import mujoco

from hiltestbed.errors import InputError
from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario

WRITERS = {
    ".mjb": lambda model, name: mujoco.mj_saveModel(model, name, None),
    ".txt": mujoco.mj_printModel,
}


def write_model(scenario: Scenario, file: Path) -> Path:
    """Write the model that the loop steps, with the numbers of the scenario that MuJoCo keeps in
    it, and return ``file``: .mjb in MuJoCo's binary form, .txt with every body, joint and pair.

    Raises:
        InputError: another suffix, or the file cannot be written.
    """
    write = WRITERS.get(file.suffix)
    if write is None:
        raise InputError(
            f"--model: no such format (got {file.name}); allowed are {', '.join(WRITERS)}"
        )
    model = Plant([scenario]).model
    try:
        file.write_bytes(b"")  # MuJoCo itself does not say why it cannot write
        write(model, str(file))
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}); choose another") from None
    return file
