"""The loop with real devices, for the command `live`. The sequence of a run is in
:mod:`hiltestbed.devices.session`.
"""

from __future__ import annotations

from hiltestbed.devices.rehearsal import rehearse
from hiltestbed.devices.session import Observed, Options, Session
from hiltestbed.scenario import Scenario
from hiltestbed.simulation import Run

__all__ = ["Observed", "Options", "live"]


def live(scenario: Scenario, options: Options) -> Run | Observed:
    """Run ``scenario`` with devices; unarmed, only observe them.

    Raises:
        InputError, DeviceError: the devices cannot be connected, or their rate is not the
            scenario's. Later faults end in the run.
    """
    rehearse(scenario)
    session = Session(scenario, options)
    with session.connected():
        observed = session.observe()
        if options.armed:
            session.run()
    return session.result(observed) if options.armed else observed
