"""Commands that are killed or interrupted: every folder complete or absent, and the same command
then does it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.config.check import look_at
from hiltestbed.measured import load_dataset
from tests.equipment.robustness import kills
from tests.equipment.robustness.kills import COMMANDS, Command, KillError, kill
from tests.slow import SLOW

KILLED, INTERRUPTED = 2, 0  # seeds of a trial that ends a command so, and repeats it


@SLOW
@pytest.mark.parametrize("seed", [KILLED, INTERRUPTED])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_ended_leaves_a_whole_folder_or_none(
    name: str, seed: int, tmp_path: Path
) -> None:
    (tmp_path / "trials").mkdir()
    assert kill(np.random.default_rng(seed), tmp_path / "trials", name) == "survived"


def test_half_a_folder_is_a_fault(tmp_path: Path) -> None:
    """The check of the trials sees what it is there for."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "summary.json").write_text("{}")
    with pytest.raises(KillError, match="holds"):
        kills._complete_or_absent(tmp_path / "out", COMMANDS["run"], "half")
    (tmp_path / "out" / "summary.json").write_text('{"half')
    with pytest.raises(ValueError, match="Unterminated"):
        kills._complete_or_absent(tmp_path / "out", Command("", frozenset()), "half")


@pytest.mark.parametrize(
    ("files", "excused"),
    [
        ([f"{kills.PACKAGE}/__init__.py", f"{kills.PACKAGE}/kernel_cache.py"], True),
        ([f"{kills.PACKAGE}/campaign/__init__.py"], False),
        ([f"{kills.PACKAGE}/__init__.py", "/usr/lib/python3/multiprocessing/spawn.py"], False),
    ],
)
def test_a_traceback_is_excused_only_before_the_programs_first_line(files, excused) -> None:
    frames = "".join(f'  File "{file}", line 3, in f\n    x\n' for file in files)
    err = f"Traceback (most recent call last):\n{frames}KeyboardInterrupt\n"
    assert kills.in_pythons_own_start(err) is excused


def test_the_commands_are_given_inputs_without_faults(tmp_path: Path) -> None:
    """A command that refuses its input cannot be interrupted at its work."""
    (tmp_path / "worker").mkdir()
    inputs = kills.prepared(tmp_path / "worker")
    assert not look_at(inputs / "campaign.yaml").faults
    load_dataset(inputs / "set" / "dataset.yaml")
