"""Real machines that others have measured: their records, with a frozen split, and an expert's
model beside each.
"""

from hiltestbed.bench.real import dampers, drives, servos
from hiltestbed.bench.real.device import AxisRecord, Device

DEVICES: tuple[Device, ...] = (*drives.DEVICES, *servos.DEVICES, *dampers.DEVICES)

__all__ = ["DEVICES", "AxisRecord", "Device"]
