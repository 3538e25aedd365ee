"""What a diagnosis leaves behind. The naming of causes ends with a `Finding`; the rest follows from it::

    finding = find(dataset)                 # verdict, link, causes, series, held-out gain, ranking
    diagnosis = conclude(dataset, finding)  # model extended, both models in closed loop, next experiment
    diagnosis.to_json()                     # the contents of diagnosis.json
    diagnosis.write("diagnosis")            # the folder, whole or not at all

`evidence.link_series` makes the series from a replayed link.
"""

from hiltestbed.diagnosis.output.conclude import conclude
from hiltestbed.diagnosis.output.result import Cause, Diagnosis, Finding, Heldout, Parameter, Ranked

__all__ = ["Cause", "Diagnosis", "Finding", "Heldout", "Parameter", "Ranked", "conclude"]
