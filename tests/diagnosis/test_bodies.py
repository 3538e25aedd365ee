"""The same effect on the other body: relative motion shows the reduced mass alone, 1/mu =
1/m_chaser + 1/m_target.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import hiltestbed
from hiltestbed.diagnosis.report.sentence import rivals_of
from tests.slow import slow

from .recorded import NOMINAL, recorded

UNSEEN = ("pose_act", "twist_act", "wrench_meas", "wrench_true")
CHASER, TARGET = (NOMINAL["spacecraft"][body]["mass"] for body in ("chaser", "target"))


def alike(factor: float) -> float:
    """The factor on the chaser's mass with the reduced mass that ``factor`` on the target's gives."""
    return 1.0 / (CHASER * (1.0 / CHASER + (1.0 / factor - 1.0) / TARGET))


@pytest.mark.parametrize("factor", [0.7, slow(1.3)])
def test_a_wrong_mass_of_either_body_is_left_open(tmp_path: Path, factor: float) -> None:
    hidden = {"kind": "dynamics.mass", "factor": factor, "body": "target"}
    found = hiltestbed.diagnose(recorded(tmp_path, [hidden], without=UNSEEN))
    assert found.verdict == "ambiguous"
    (cause,) = found.causes
    assert (cause.effect, cause.indistinguishable_from) == ("dynamics.mass", ("dynamics.mass",))
    told = [cause.entry(), cause.alternatives[0][0]]
    assert {t["body"]: t["factor"] for t in told} == pytest.approx(
        {"target": factor, "chaser": alike(factor)}, rel=1e-3
    )
    assert cause.probability == pytest.approx(0.5, abs=0.01)
    assert rivals_of(cause) == [f"dynamics.mass [body {told[1]['body']}]"]
    assert found.experiment is not None
    assert any("mass" in key for key in found.experiment.runs[0])


def test_a_run_with_another_target_decides_which_body_it_is(tmp_path: Path) -> None:
    """With a target four times as heavy an error of the target's mass fades to a quarter, one of
    the chaser's does not.
    """
    hidden = {"kind": "dynamics.mass", "factor": 1.3, "body": "target"}
    found = hiltestbed.diagnose(
        recorded(
            tmp_path, [hidden], without=UNSEEN, beside={"spacecraft.target.mass": 4.0 * TARGET}
        )
    )
    assert found.verdict == "named"
    (cause,) = found.causes
    assert cause.parameters["body"].estimate == "target"
    assert cause.parameters["factor"].estimate == pytest.approx(1.3, rel=1e-3)
