"""The sections of a scenario that a method reads its parameters from.

A section is one of several kinds; the factories of :mod:`hiltestbed.compensation` and :mod:`hiltestbed.identification` hand a method only
scenarios of its own kind, so that its parameters are there.
"""

from __future__ import annotations

from typing import Any

from hiltestbed.scenario import Scenario


def force_section(scenario: Scenario) -> Any:
    """``compensation.force``"""
    return scenario.compensation.force


def motion_section(scenario: Scenario) -> Any:
    """``compensation.motion``"""
    return scenario.compensation.motion


def identification_section(scenario: Scenario) -> Any:
    """``identification``"""
    return scenario.identification
