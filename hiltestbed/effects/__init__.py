"""Effects: how a rig may depart from its nominal model. One class per effect, in the package of the
link that it acts on.
"""

from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.table import EFFECTS, AnyEffect, by_link

__all__ = ["EFFECTS", "AnyEffect", "Effect", "by_link", "quantity"]
