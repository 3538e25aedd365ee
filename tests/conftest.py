"""Which tests are quick: those that need no long simulation. All others are marked slow, so that a
new test is slow until it is listed.

And which files come first, where several workers take a file at a time: those that compile the
kernels that the others need, a rig to each worker so that none is compiled twice, then the longest,
so that at the end no worker waits for another.

At the end of a file the C library gives back to the system what has been freed: by itself it keeps
what lies below any block that is still in use, hundreds of megabytes a file of long runs and
batches.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import io
import json
import os
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest

from hiltestbed import cli, plugins
from hiltestbed.config import trial
from hiltestbed.measured import apart

HERE = Path(__file__).parent
# of glibc
_TRIM = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
QUICK = (  # files and folders below tests
    "campaign/test_schema.py",
    "campaign/test_sensitivity.py",
    "contact/surfaces/test_revolution.py",
    "contact/surfaces/test_shapes.py",
    "devices/test_poses.py",
    "devices/test_url.py",
    "effects",
    "identification/test_least_squares.py",
    "measured/test_channel_map.py",
    "measured/test_clock.py",
    "models/test_descriptions.py",
    "platform/test_kinematics.py",
    "platform/test_settings.py",
    "scenario",
    "sensor",
    "test_frames.py",
    "test_imports.py",
    "test_kept_stability.py",
    "test_ledger.py",
    "test_progress.py",
    "test_python_api.py",
    "viewer/test_display.py",
)
FIRST = (
    "robustness/test_distortions.py",  # the independent rig
    "test_ledger.py",  # the loop, with every compensation
    "diagnosis/test_naming.py",  # the replay
    "test_docking.py",  # latches
    "campaign/test_sweep.py",
    "replay/test_simulated.py",
    "docs/test_pages.py",
    "plugins/test_examples.py",
    "axis/test_recovery.py",
    "platform/test_facility_loop.py",
    "test_first_bounce.py",
    "test_cli.py",
    "platform/test_responses.py",
    "platform/test_nine_axes.py",
    "contact/test_users_mechanism.py",
    "diagnosis/test_verdict.py",
    "diagnosis/test_channels.py",
    "test_jit.py",
    "devices/test_live_faults.py",
    "devices/test_live.py",
    "devices/test_fmu.py",
    "devices/test_commission.py",
    "replay/test_platform.py",
    "replay/test_wrench.py",
    "replay/test_compensation.py",
    "bench/test_cor.py",
    "bench/test_benches.py",
    "identification/test_methods.py",
    "test_user_files.py",
    "test_stability.py",
    "docs/test_gallery.py",
)


def _is_quick(path: Path) -> bool:
    return any(path == HERE / quick or (HERE / quick) in path.parents for quick in QUICK)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """What the quick subset leaves out is not imported for it, either."""
    left_out = config.option.markexpr == "not slow" and collection_path.suffix == ".py"
    return True if left_out and not _is_quick(collection_path) else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    first = {HERE / file: rank for rank, file in enumerate(FIRST)}
    items.sort(key=lambda item: first.get(item.path, len(FIRST)))
    for item in items:
        if not _is_quick(item.path):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(
    item: pytest.Item, nextitem: pytest.Item | None
) -> Generator[None, object, object]:
    result = yield
    if _TRIM is not None and (nextitem is None or nextitem.path != item.path):
        _TRIM(0)
    return result


@pytest.fixture
def tables_as_shipped() -> Iterator[None]:
    """What a test loads is taken out of the tables again: other tests walk the vocabulary that is
    shipped.

    Loading also leaves the modules in the environment, for processes that are started; they are
    gone afterwards as well.
    """
    asked = os.environ.pop(plugins.ENVIRONMENT, None)
    before = [(registry, dict(registry)) for registry in plugins._REGISTRIES]
    loaded = dict(plugins._LOADED)
    yield
    os.environ.pop(plugins.ENVIRONMENT, None)
    if asked is not None:
        os.environ[plugins.ENVIRONMENT] = asked
    for registry, classes in before:
        registry._found = classes
    plugins._LOADED.clear()
    plugins._LOADED.update(loaded)
    for refresh in plugins._DEPENDENTS:
        refresh()


def _served(module: str, order: dict[str, Any], patience: float) -> SimpleNamespace:
    """What ``module`` answers to an ``order``, served in this process."""
    order_in, told = io.TextIOWrapper(io.BytesIO(json.dumps(order).encode())), io.StringIO()
    with mock.patch("sys.stdin", order_in), contextlib.redirect_stdout(told):
        importlib.import_module(module)._serve()
    return SimpleNamespace(stdout=told.getvalue(), returncode=0)


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models and logs of the users are read without a process of their own, which is tested for
    itself.
    """
    for module in (trial, apart):
        monkeypatch.setattr(module, "in_own_process", _served)
        monkeypatch.setattr(module, "limit_resources", lambda **limits: None)


@pytest.fixture
def call(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Runs one command in this process: (exit status, standard output, standard error)."""

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["hiltestbed", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        assert "Traceback" not in captured.out + captured.err
        return int(ended.value.code or 0), captured.out, captured.err

    return run
