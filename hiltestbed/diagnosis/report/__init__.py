"""Stage "report": from a `Finding` to a `Diagnosis` (closed-loop runs, next experiment) and its
folder.
"""
