"""Which tests are quick: those that need no long simulation. All others are marked slow, so that a new test is slow until it is listed."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent
QUICK = (  # files and folders below tests
    "campaign/test_designs.py",
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
    "measured/test_formats.py",
    "models/test_descriptions.py",
    "platform/test_kinematics.py",
    "platform/test_settings.py",
    "scenario",
    "sensor",
    "test_frames.py",
    "test_imports.py",
    "test_ledger.py",
    "test_progress.py",
    "test_python_api.py",
    "viewer/test_display.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.is_relative_to(HERE):
            place = item.path.relative_to(HERE).as_posix()
            if not any(place == quick or place.startswith(f"{quick}/") for quick in QUICK):
                item.add_marker(pytest.mark.slow)
