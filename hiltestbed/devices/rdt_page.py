"""The configuration page of ATI's sensors, netftapi2.xml: counts per unit and rates.

ATI Industrial Automation, document 9620-05-NET FT, section 9.1 "System and Configuration
Information (netftapi2.xml)": elements below ``netft``, among them ``cfgcpf`` and ``cfgcpt`` (counts
per force and per torque), ``scfgfu`` and ``scfgtu`` (their units), ``comrdte`` (whether RDT is
enabled), ``comrdtrate`` (its rate [Hz]), ``runrate`` (the sensor's internal rate [Hz]).
"""

from __future__ import annotations

import contextlib
import http.client
import math
import socket
import threading
import time
from collections.abc import Collection
from dataclasses import dataclass

from hiltestbed.devices import plain_xml
from hiltestbed.devices.interface import DeviceError
from hiltestbed.measured.units import UNITS, unit_named

PATH = "/netftapi2.xml"
LARGEST = 65536  # [byte]
PATIENCE = 2.0  # [s] to wait for each part of the page
DEADLINE = 5.0  # [s] for the whole page
HINT = (
    "or give counts_per_force, counts_per_torque, force_unit, torque_unit and rate, the rate of "
    "the device's records, in the URL"
)
# [Hz] defaults of an emulated sensor; 7 kHz is the internal rate of a Net F/T
RATE, INTERNAL_RATE = 1000.0, 7000.0


def factor(si: str, unit: str) -> float | None:
    """``unit`` in ``si`` (N or N m), however it is spelt; None if it is none of its units."""
    return UNITS[si].get(unit_named(unit) or "")


@dataclass(frozen=True)
class Page:
    """Counts per unit of force and torque, these units, and the rates [Hz] of the records and of
    the sensor's own samples.
    """

    counts_per_force: float
    counts_per_torque: float
    force_unit: str
    torque_unit: str
    rate: float = RATE
    internal_rate: float = INTERNAL_RATE

    @property
    def force(self) -> float:
        return factor("N", self.force_unit) or math.nan

    @property
    def torque(self) -> float:
        return factor("N m", self.torque_unit) or math.nan


def fetch(host: str, port: int, where: str, by_hand: Collection[str] = ()) -> Page:
    """The content of the page of the device at ``host``; ``by_hand``: of force and torque, those
    whose counts and unit are not read there. Raises DeviceError.
    """
    address = f"http://{host}:{port}{PATH}"
    connection = http.client.HTTPConnection(host, port, timeout=PATIENCE)
    until = time.monotonic() + DEADLINE
    # each byte that trickles in would begin the time-out of the socket anew
    deadline = threading.Timer(DEADLINE, lambda: _cut(opened))
    deadline.daemon = True
    opened: socket.socket | None = None
    try:
        connection.connect()
        opened = connection.sock
        deadline.start()
        connection.request("GET", PATH)
        response = connection.getresponse()
        data = response.read(LARGEST + 1)
        if time.monotonic() > until:
            raise TimeoutError
        if response.status != http.client.OK:
            raise OSError(f"status {response.status}, {response.reason}")
    except (OSError, ValueError, http.client.HTTPException) as error:
        late = time.monotonic() > until
        reason = f"it was not complete within {DEADLINE:g} s" if late else error or type(error)
        raise DeviceError(
            f"{where}: the configuration page {address} cannot be read ({reason}); check the "
            f"address, {HINT}"
        ) from None
    finally:
        deadline.cancel()
        connection.close()
    return understood(data, where, by_hand)


def _cut(opened: socket.socket | None) -> None:
    """End a connection under a read that waits."""
    if opened is not None:
        with contextlib.suppress(OSError):
            opened.shutdown(socket.SHUT_RDWR)


def understood(data: bytes, where: str, by_hand: Collection[str]) -> Page:
    """What a page says. Raises DeviceError."""
    try:
        root = plain_xml.read(data, LARGEST)
    except plain_xml.NotPlain:
        raise DeviceError(
            f"{where}: the configuration page is not the XML of a Net F/T; check the address, "
            f"{HINT}"
        ) from None
    text = {element.tag: (element.text or "").strip() for element in root.iter()}
    if text.get("comrdte") in ("0", "Disabled"):
        raise DeviceError(f"{where}: RDT is disabled; enable it on the device's communication page")

    def amount(element: str, otherwise: float | None = None) -> float:
        if element not in text and otherwise is not None:
            return otherwise
        try:
            value = float(text.get(element, ""))
        except ValueError:
            value = 0.0
        if not 0.0 < value < 1e12:
            raise DeviceError(
                f"{where}: the configuration page gives no {element} (got {text.get(element)!r}); "
                f"check the device, {HINT}"
            )
        return value

    def unit(element: str, quantity: str) -> str:
        value = text.get(element, "")
        si = "N" if quantity == "force" else "N m"
        if quantity not in by_hand and factor(si, value) is None:
            raise DeviceError(
                f"{where}: the configuration page gives {element} = {value!r}, which is no unit "
                f"of {quantity}; known: {', '.join(UNITS[si])}; set one of these on the device, "
                f"{HINT}"
            )
        return value

    return Page(
        1.0 if "force" in by_hand else amount("cfgcpf"),
        1.0 if "torque" in by_hand else amount("cfgcpt"),
        unit("scfgfu", "force"),
        unit("scfgtu", "torque"),
        amount("comrdtrate", RATE),
        amount("runrate", INTERNAL_RATE),
    )
