"""The page on phase lead, then RLS: what it says is what its command prints, and what the phasors
say.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.scripts import module

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def example():
    return module(DOCS / "examples" / "identified.py")


@pytest.fixture(scope="module")
def found(example):
    return example.measured()


def numbers(lines: list[str]) -> list[list[float]]:
    return [[float(n) for n in re.findall(r"[-+]?\d[\d.]*", line)] for line in lines]


def test_the_table_of_the_page_is_that_of_its_command(example, found) -> None:
    """To the rounding of two digits, which a last bit may turn."""
    text = (DOCS / "explanation" / "lead-then-rls.md").read_text(encoding="utf-8")
    shown = [line for line in text.splitlines() if line.startswith("|")]
    printed = example.table(found)
    assert shown[:2] == printed[:2]
    for ours, page in zip(numbers(printed[2:]), numbers(shown[2:]), strict=True):
        np.testing.assert_allclose(page, ours, rtol=0.06, atol=0.003)


def test_short_delays_give_what_the_phasors_say(example, found) -> None:
    """A bounce is half a sine and begins with a step c v, whose higher frequencies a lead raises
    more: within a tenth, and a little, as long as w tau is small.
    """
    for e in found:
        slow = e.contact.speed < 0.02  # the noise that a lead raises is a fifth of a percent of k
        if slow or e.contact.w * e.contact.delay > 0.2 or e.way == "paired in time":
            continue
        k, c = example.by_phasors(e.contact, lead=e.way.startswith("phase lead"))
        assert e.stiffness == pytest.approx(k, rel=0.1, abs=0.002)
        assert e.damping == pytest.approx(c, rel=0.1, abs=0.015)


def test_paired_in_time_nothing_depends_on_the_delay(found) -> None:
    paired = [e for e in found if e.way == "paired in time"]
    assert max(abs(e.stiffness) for e in paired) < 0.001
    assert max(abs(e.damping) for e in paired) < 0.004
    for slow, fast in ((0.01, 0.03), (0.03, 0.1)):  # the noise over the force
        rms = [
            np.sqrt(np.mean([e.damping**2 for e in paired if e.contact.speed == v]))
            for v in (slow, fast)
        ]
        assert rms[1] == pytest.approx(rms[0] * slow / fast, rel=0.5)
