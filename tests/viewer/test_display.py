"""`hiltestbed view` where there is nothing to see, or nothing to see it with; ranges of the plots."""

from __future__ import annotations

import math
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.viewer import display
from hiltestbed.viewer.blueprint import UPWARD, readable, ticks


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


def test_a_viewer_that_fails_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "recording.rrd").touch()
    viewer = tmp_path / "viewer"
    viewer.write_text("#!/bin/sh\nexit 3\n")
    viewer.chmod(0o755)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(display, "viewer_binary", lambda: viewer)
    with pytest.raises(HiltestbedError, match="status 3"):
        display.view(tmp_path)


def test_the_viewer_comes_with_rerun() -> None:
    assert display.viewer_binary().is_file()


def test_a_range_holds_what_is_drawn_and_two_labelled_ticks(subtests: pytest.Subtests) -> None:
    for span, place in product(np.geomspace(1e-7, 1e7, 57).tolist(), [0.0, -0.4, -1.0, 7.3]):
        with subtests.test(span=span, place=place):
            low, high = readable(place * span, (place + 1.0) * span)
            assert low < place * span
            assert high > (place + 1.0) * span
            step = 10.0 ** math.floor(math.log10(high - low))
            labelled = step if high - low <= UPWARD * step else 10.0 * step
            assert ticks(low, high, labelled) >= 2
            assert high - low < 25.0 * span  # the curve is not a line in the middle


def test_a_constant_has_a_range() -> None:
    low, high = readable(5.0, 5.0)
    assert low < 5.0 < high
