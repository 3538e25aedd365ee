"""The file of a recording, of a run or of a diagnosis."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

APPLICATION = "hiltestbed"


@contextmanager
def recording_file(
    path: Path, identity: str, blueprint: rrb.Blueprint
) -> Iterator[rr.RecordingStream]:
    """A recording that is written to ``path``, with its layout, at the end of the block.

    It is collected in memory: rerun's own writer of files is a thread that is waited for, for ever
    where the disk became full.

    Raises:
        OSError: the file could not be written.
    """
    with rr.RecordingStream(APPLICATION, recording_id=identity, send_properties=False) as stream:
        memory = stream.memory_recording()
        stream.send_blueprint(blueprint, make_active=False, make_default=True)
        yield stream
        content = memory.drain_as_bytes()
    try:
        path.write_bytes(content)
    except OSError as error:
        raise OSError(
            error.errno,
            f"the recording could not be written ({error.strerror}); is the disk full?",
            str(path),
        ) from None
