"""Real machines that others have measured: one page a machine, its frozen split, and an
expert's model beside it.
"""

from hiltestbed.bench.real import emps, friction_damper, mr_damper, press, so101
from hiltestbed.bench.real.device import Device, Record

PAGES = (emps, so101, friction_damper, mr_damper, press)
DEVICES: tuple[Device, ...] = tuple(device for page in PAGES for device in page.DEVICES)

__all__ = ["DEVICES", "Device", "Record"]
