"""The diagnosis folder: diagnosis.json, report.html, extended.yaml, recording.rrd. A folder that
exists is complete.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hiltestbed.diagnosis.conclusion import Conclusion
from hiltestbed.diagnosis.plain import finite
from hiltestbed.diagnosis.report.extend import extended_yaml
from hiltestbed.diagnosis.report.page import report_of
from hiltestbed.diagnosis.report.sentence import (
    learned_sentence,
    partial_sentence,
    verdict_sentence,
)
from hiltestbed.run_folder.store import RECORDING, whole_folder
from hiltestbed.run_folder.versions import versions

DIAGNOSIS, REPORT, EXTENDED = "diagnosis.json", "report.html", "extended.yaml"


def diagnosis_json(diagnosis: Conclusion) -> dict[str, Any]:
    """The contents of diagnosis.json: plain data without infinities."""
    finding = diagnosis.finding
    learned, partial, gain = finding.learned, finding.partial, finding.partial_gain
    return finite(
        {
            "name": diagnosis.name,
            "verdict": diagnosis.verdict,
            "sentence": verdict_sentence(diagnosis),
            "link": diagnosis.link,
            "causes": [c.to_json() for c in diagnosis.causes],
            "not_judged": dict(finding.not_judged),
            "left": finding.left or None,
            "explained": finding.explained,
            "learned": learned.to_json() | {"sentence": learned_sentence(learned)}
            if learned
            else None,
            "partial": {
                "sentence": partial_sentence(partial, gain),
                "causes": [c.to_json() for c in partial],
                "heldout": gain.to_json() if gain else None,
            },
            "residuals": [vars(r) for r in diagnosis.residuals],
            "heldout": diagnosis.heldout.to_json() if diagnosis.heldout else None,
            "closed_loop": diagnosis.closed_loop.to_json(),
            "next_experiment": diagnosis.next_experiment,
            "next_experiment_runs": list(diagnosis.experiment.runs) if diagnosis.experiment else [],
            "extended_scenario": "extended.yaml" if finding.extends else None,
            "ranking": [vars(r) for r in finding.ranking],
            "certainty": [c.to_json() for c in finding.certainty],
            "overridden": list(diagnosis.overridden),
            "unsized": dict(finding.unsized),
            "isolability": [vars(i) for i in finding.isolability],
            "remarks": list(diagnosis.remarks),
            "seconds": diagnosis.seconds,
            "versions": versions(),
        }
    )


def write_diagnosis(diagnosis: Conclusion, path: str | Path) -> Path:
    """Write the folder and return its path.

    Raises:
        InputError: the folder cannot be written, or holds something else.
    """
    from hiltestbed.diagnosis.report.recording import write_diagnosis_recording

    path = Path(path)
    causes = diagnosis.finding.extension
    with whole_folder(path, mark=DIAGNOSIS) as folder:
        (folder / DIAGNOSIS).write_text(
            json.dumps(diagnosis_json(diagnosis), indent=2, allow_nan=False) + "\n",
            encoding="utf-8",
        )
        (folder / EXTENDED).write_text(extended_yaml(diagnosis.extended, causes), encoding="utf-8")
        report_of(diagnosis).write(folder / REPORT)
        write_diagnosis_recording(folder / RECORDING, diagnosis)
    return path
