"""The command line: `hiltestbed run | check | rig | view | compare | new | doctor | schema | bench | sweep | diagnose | live | ...`.

Exit status: 0 done; 2 bad input; 3 the simulation diverged or a safety limit stopped it; 1 anything else that failed. Results go to
standard output, progress and messages to standard error. A command imports what it needs when it runs, so that --help is quick.
"""

from hiltestbed.cli.program import app, main

__all__ = ["app", "main"]
