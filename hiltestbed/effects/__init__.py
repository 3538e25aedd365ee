"""Effects: what a rig may do that its nominal model does not, one module a link of the loop."""

from .vocabulary import EFFECTS, EffectSpec, ParameterSpec

__all__ = ["EFFECTS", "EffectSpec", "ParameterSpec"]
