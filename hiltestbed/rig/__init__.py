"""The physical side: platform, mechanisms and force sensor, in MuJoCo."""

from hiltestbed.rig.plant import Plant

__all__ = ["Plant"]
