"""The links of the loop explained by one likelihood instead of by the rules of
:mod:`hiltestbed.diagnosis.search`: read `model`, `explain`, `investigate`.
"""
