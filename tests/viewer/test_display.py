"""`hiltestbed view` where there is nothing to see, or nothing to see it with."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.viewer import display


def test_a_folder_without_a_recording_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no recording\.rrd.*--no-rerun"):
        display.view(tmp_path)


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="always has a display")
def test_without_a_display_it_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "recording.rrd").touch()
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(
        HiltestbedError, match=r"no display.*rerun .*recording\.rrd --serve-web"
    ) as error:
        display.view(tmp_path)
    assert error.value.exit_status == 1


def test_the_viewer_comes_with_rerun() -> None:
    assert display.viewer_binary().is_file()
