"""The command line: `hiltestbed run | check | rig | view | compare | new | doctor | schema | bench
| sweep | diagnose | live | ...`.

Exit status: 0 done; 2 bad input; 3 the simulation diverged, a safety limit stopped it, or it has no
reference; 1 any other failure. Results go to standard output, progress and messages to standard
error. A command imports what it needs when it runs, so that --help is fast.
"""

from __future__ import annotations

import gc
import sys
from typing import TYPE_CHECKING, Any

from hiltestbed.process import interrupt
from hiltestbed.process.output import escaped

if TYPE_CHECKING:
    from hiltestbed.cli.program import app

__all__ = ["app", "main"]

# between two looks for garbage: at Python's 700, a tenth of all imports is spent on looking, and
# there is none
NEW_OBJECTS = 50_000


def main() -> None:
    """Entry point. Ctrl-C while the program is still loading also ends it with a short message."""
    interrupt.install()
    gc.set_threshold(NEW_OBJECTS)
    with escaped():
        try:
            from hiltestbed.cli.program import main as program
        except BaseException:
            if not interrupt.asked():
                raise
            print("interrupted", file=sys.stderr)
            sys.exit(1)
        program()


def __getattr__(name: str) -> Any:
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from hiltestbed.cli.program import app

    return app
