"""Real machines that others have measured: one page a machine, its frozen split, and an
expert's model beside it.
"""

from hiltestbed.bench.real import (
    camber,
    dyno_damper,
    emps,
    friction_damper,
    hsm150,
    mr_damper,
    press,
    so101,
    sts3215,
    ur10e,
)
from hiltestbed.bench.real.device import Device, Record

PAGES = (
    emps,
    ur10e,
    hsm150,
    so101,
    sts3215,
    camber,
    press,
    friction_damper,
    mr_damper,
    dyno_damper,
)
DEVICES: tuple[Device, ...] = tuple(device for page in PAGES for device in page.DEVICES)

__all__ = ["DEVICES", "Device", "Record"]
