"""`python -m hiltestbed.cli`."""

from hiltestbed.cli.program import main

main()
