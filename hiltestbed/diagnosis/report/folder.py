"""The diagnosis folder: diagnosis.json, report.html, extended.yaml, recording.rrd. A folder that
exists is complete.
"""

from __future__ import annotations

import json
from pathlib import Path

from hiltestbed.diagnosis.report.extend import extended_yaml
from hiltestbed.diagnosis.report.page import report_of
from hiltestbed.diagnosis.result import Diagnosis
from hiltestbed.run_folder.store import RECORDING, whole_folder

DIAGNOSIS, REPORT, EXTENDED = "diagnosis.json", "report.html", "extended.yaml"


def write_diagnosis(diagnosis: Diagnosis, path: str | Path) -> Path:
    """Write the folder and return its path.

    Raises:
        InputError: the folder cannot be written, or holds something else.
    """
    from hiltestbed.diagnosis.report.recording import write_diagnosis_recording

    path = Path(path)
    causes = diagnosis.finding.extension
    with whole_folder(path, mark=DIAGNOSIS) as folder:
        (folder / DIAGNOSIS).write_text(
            json.dumps(diagnosis.to_json(), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        (folder / EXTENDED).write_text(extended_yaml(diagnosis.extended, causes), encoding="utf-8")
        report_of(diagnosis).write(folder / REPORT)
        write_diagnosis_recording(folder / RECORDING, diagnosis)
    return path
