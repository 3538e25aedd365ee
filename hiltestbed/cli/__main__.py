"""`python -m hiltestbed.cli`."""

from hiltestbed.cli import main

main()
