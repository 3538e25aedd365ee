"""The recording of a run for the rerun viewer, and `hiltestbed view`."""

from hiltestbed.viewer.display import view
from hiltestbed.viewer.record import write_recording

__all__ = ["view", "write_recording"]
