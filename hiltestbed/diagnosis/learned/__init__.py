"""Laws learned from data on the link that departs, where the effects with a name leave more than noise."""

from hiltestbed.diagnosis.learned.learn import learn

__all__ = ["learn"]
