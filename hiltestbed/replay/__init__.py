"""Open-loop replay: the blocks of the loop on recorded inputs, one link at a time.

The leading axis of every block is a *lane*: a recorded run under one hypothesis. Inputs are stored
once per run, ``(R, N, ...)``, and ``run`` ``(L,)`` is the index of the run that drives each lane. A
row of a record is a tick of the loop; what the loop calls once per tick is called here once per
row, in compiled loops over the rows where calls from Python would be slow.
"""

from hiltestbed.replay.compensation import replay_compensation
from hiltestbed.replay.felt import Felt
from hiltestbed.replay.numerical_model import Departing, replay_model
from hiltestbed.replay.platform import replay_platform
from hiltestbed.replay.rig import can_carry, follows_exactly, moves_linearly, replay_rig
from hiltestbed.replay.simulated import Engaged, Simulated
from hiltestbed.replay.wrench import replay_wrench

__all__ = [
    "Departing",
    "Engaged",
    "Felt",
    "Simulated",
    "can_carry",
    "follows_exactly",
    "moves_linearly",
    "replay_compensation",
    "replay_model",
    "replay_platform",
    "replay_rig",
    "replay_wrench",
]
