"""Random tests of invalid inputs, damaged files and interrupted commands: `hiltestbed bench
robustness`.
"""
