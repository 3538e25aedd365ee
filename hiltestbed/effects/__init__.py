"""Effects: how a rig may depart from what is believed of it. One class an effect, in the package of the link that it acts on."""

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.table import EFFECTS, AnyEffect, by_link

__all__ = ["EFFECTS", "AnyEffect", "Effect", "by_link", "quantity"]
