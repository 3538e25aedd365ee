"""What all tests of devices share."""

from __future__ import annotations

import pytest

from hiltestbed.devices import realtime


@pytest.fixture(autouse=True)
def memory_and_garbage_are_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A live loop locks all memory and collects all garbage before its first cycle: of a whole test
    run both are much, a second each time.
    """
    monkeypatch.setattr(realtime, "_memory_and_slack", lambda result, undo: None)
    monkeypatch.setattr(realtime, "_quiet_interpreter", lambda result, undo: None)
