"""One likelihood for what may depart from a model, and the evidence by which causes are chosen.

Read :mod:`~hiltestbed.inference.model` (what a model has to offer), then
:mod:`~hiltestbed.inference.likelihood`, :mod:`~hiltestbed.inference.search` and
:mod:`~hiltestbed.inference.conclude`.
"""
