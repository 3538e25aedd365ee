"""The configuration page of ATI's sensors, netftapi2.xml: counts per unit and rates.

ATI Industrial Automation, document 9620-05-NET FT, section 9.1 "System and Configuration
Information (netftapi2.xml)": elements below ``netft``, among them ``cfgcpf`` and ``cfgcpt`` (counts
per force and per torque), ``scfgfu`` and ``scfgtu`` (their units), ``comrdte`` (whether RDT is
enabled), ``comrdtrate`` (its rate [Hz]), ``runrate`` (the sensor's internal rate [Hz]).
"""

from __future__ import annotations

import threading
import urllib.error
import urllib.request
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING

from hiltestbed.devices import plain_xml
from hiltestbed.devices.interface import DeviceError
from hiltestbed.errors import Fault, InputError

if TYPE_CHECKING:
    from hiltestbed.devices.rdt import RdtSettings

POUND, INCH, FOOT, KILOGRAM_FORCE = 4.4482216152605, 0.0254, 0.3048, 9.80665
FORCE = {"N": 1.0, "kN": 1000.0, "lbf": POUND, "klbf": 1000.0 * POUND, "kgf": KILOGRAM_FORCE}  # [N]
TORQUE = {
    "N-m": 1.0,
    "N-mm": 1.0e-3,
    "kN-m": 1000.0,
    "lbf-in": POUND * INCH,
    "lbf-ft": POUND * FOOT,
    "kgf-cm": KILOGRAM_FORCE * 0.01,
}  # [N m]
PATH = "/netftapi2.xml"
LARGEST = 65536  # [byte]
PATIENCE = 2.0  # [s]
HTTP_PORT = 80
# [Hz] defaults of an emulated sensor; 7 kHz is the internal rate of a Net F/T
RATE, INTERNAL_RATE = 1000.0, 7000.0


@dataclass(frozen=True)
class Page:
    """Counts per unit of force and torque, these units [N, N m], the rate of records and of the
    sensor's own samples [Hz].
    """

    counts_per_force: float = 1.0e6
    counts_per_torque: float = 1.0e6
    force_unit: str = "N"
    torque_unit: str = "N-m"
    rate: float = RATE
    internal_rate: float = INTERNAL_RATE

    @property
    def force(self) -> float:
        return FORCE[self.force_unit]

    @property
    def torque(self) -> float:
        return TORQUE[self.torque_unit]


def from_options(settings: RdtSettings, counts: float, host: str | None) -> Page:
    """The page from the URL's options, completed from the device at ``host``, or (None) with
    ``counts`` per unit. Raises DeviceError.
    """
    scaled = settings.counts_per_force is not None and settings.counts_per_torque is not None
    whole = scaled and settings.rate is not None and settings.internal_rate is not None
    if host is None or whole or (scaled and settings.http is None):
        page = Page(counts, counts, settings.force_unit, settings.torque_unit)
    else:
        page = fetch(host, settings.http or HTTP_PORT, settings.where)
    return Page(
        settings.counts_per_force or page.counts_per_force,
        settings.counts_per_torque or page.counts_per_torque,
        settings.force_unit if scaled else page.force_unit,
        settings.torque_unit if scaled else page.torque_unit,
        settings.rate or page.rate,
        settings.internal_rate or page.internal_rate,
    )


def fetch(host: str, port: int, where: str) -> Page:
    """The content of the page of the device at ``host``. Raises DeviceError."""
    address = f"http://{host}:{port}{PATH}"
    hint = "or give counts_per_force and counts_per_torque in the URL"
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), _NoRedirect())
    try:
        with opener.open(address, timeout=PATIENCE) as response:
            data = response.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise DeviceError(
            f"{where}: the configuration page {address} cannot be read ({error}); check the "
            f"address, {hint}"
        ) from None
    return _understand(data, where, hint)


def _understand(data: bytes, where: str, hint: str) -> Page:
    try:
        text = plain_xml.read(data, LARGEST).text
    except plain_xml.NotPlain:
        raise DeviceError(
            f"{where}: the configuration page is not the XML of a Net F/T; check the address, "
            f"{hint}"
        ) from None
    if text.get("comrdte", "Enabled").strip() in ("0", "Disabled"):
        raise DeviceError(f"{where}: RDT is disabled; enable it on the device's communication page")

    def amount(element: str, otherwise: float | None) -> float:
        if element not in text and otherwise is not None:
            return otherwise
        try:
            value = float(text.get(element, ""))
        except ValueError:
            value = 0.0
        if not 0.0 < value < 1e12:
            raise DeviceError(
                f"{where}: the configuration page gives no {element} (got {text.get(element)!r}); "
                f"check the device, {hint}"
            )
        return value

    def unit(element: str, known: dict[str, float]) -> str:
        value = text.get(element, "").strip()
        if value not in known:
            raise DeviceError(
                f"{where}: the configuration page gives {element} = {value!r}; known: "
                f"{', '.join(known)}; {hint}"
            )
        return value

    return Page(
        amount("cfgcpf", None),
        amount("cfgcpt", None),
        unit("scfgfu", FORCE),
        unit("scfgtu", TORQUE),
        amount("comrdtrate", RATE),
        amount("runrate", INTERNAL_RATE),
    )


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Refuses redirects: a sensor's page is at the requested address."""

    def redirect_request(self, *_: object) -> None:
        return None


class PageServer:
    """The page of an emulated sensor, served from a separate thread.

    Attributes:
        port: at which it is served.
    """

    def __init__(self, address: tuple[str, int], page: Page, where: str) -> None:
        body = _render(page)

        class Handler(BaseHTTPRequestHandler):
            timeout = PATIENCE

            def do_GET(self) -> None:
                found = self.path.partition("?")[0] == PATH
                self.send_response(200 if found else 404)
                self.send_header("Content-Type", "text/xml")
                self.send_header("Content-Length", str(len(body) if found else 0))
                self.end_headers()
                if found:
                    self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                pass

        try:
            self._server = ThreadingHTTPServer(address, Handler)
        except OSError as error:
            message = (
                f"TCP {address[0]}:{address[1]} of the configuration page cannot be "
                f"opened ({error.strerror}); give another http port"
            )
            raise InputError(Fault(where, None, None, "http", message)) from None
        self._server.daemon_threads = True
        self.port = self._server.server_address[1]
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="rdt-page", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _render(page: Page) -> bytes:
    elements = {
        "prodname": "Emulated Net F/T",
        "cfgcpf": f"{page.counts_per_force:.12g}",
        "cfgcpt": f"{page.counts_per_torque:.12g}",
        "scfgfu": page.force_unit,
        "scfgtu": page.torque_unit,
        "comrdte": "Enabled",
        "comrdtrate": f"{page.rate:g}",
        "runrate": f"{page.internal_rate:g}",
    }
    body = "".join(f"<{name}>{value}</{name}>\n" for name, value in elements.items())
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<netft>\n{body}</netft>\n'.encode()
