"""Stage "decide": laws learned from data on a link that departs, where the named effects leave more
than noise.
"""

from hiltestbed.diagnosis.learned.learn import learn

__all__ = ["learn"]
