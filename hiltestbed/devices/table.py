"""The protocols by URL scheme, and a device from its URL.

A protocol is one module with a :class:`~hiltestbed.devices.interface.Protocol` named ``PROTOCOL``;
it is imported when a URL uses it. A user's own protocol is added to the table with
:func:`register`.
"""

from __future__ import annotations

from importlib import import_module

from hiltestbed.config.validation import nearest
from hiltestbed.devices import poses
from hiltestbed.devices.interface import (
    PlatformClient,
    PlatformServer,
    Protocol,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.url import DeviceSettings, parse, refused, scheme_of

SCHEMES = ("rdt", "rsi", "rtde", "shm", "udp")  # each the module of its name

_registered: dict[str, Protocol] = {}


def register(protocol: Protocol) -> None:
    """Add a protocol; it replaces one with the same scheme."""
    _registered[protocol.scheme] = protocol


def protocols() -> dict[str, Protocol]:
    """Every protocol by its scheme."""
    return {scheme: _load(scheme) for scheme in sorted({*SCHEMES, *_registered})}


def find(url: str, place: str) -> Protocol:
    """The protocol of a URL. Raises InputError, which lists the known schemes."""
    scheme, known = scheme_of(url, place), sorted({*SCHEMES, *_registered})
    if scheme not in known:
        similar = nearest(scheme, known)
        raise refused(
            f"{place} {url}",
            f"unknown protocol{similar} (got {scheme!r}); allowed: {', '.join(known)}",
        )
    return _load(scheme)


def settings_of(url: str, place: str = "--device") -> DeviceSettings:
    """The checked settings of a URL. Raises InputError."""
    return parse(url, find(url, place).settings, place)


def sensor_client(url: str, place: str = "--sensor") -> SensorClient:
    """The loop's side of the sensor at ``url``, not yet open. Raises InputError."""
    return _made(url, place, "sensor_client")


def platform_client(url: str, place: str = "--platform") -> PlatformClient:
    """The loop's side of the platform at ``url``, not yet open. Raises InputError."""
    return _made(url, place, "platform_client")


def sensor_server(url: str, place: str = "--sensor") -> SensorServer:
    """The device's side of a sensor at ``url``, not yet open. Raises InputError."""
    return _made(url, place, "sensor_server")


def platform_server(url: str, place: str = "--platform") -> PlatformServer:
    """The device's side of a platform at ``url``, not yet open. Raises InputError."""
    return _made(url, place, "platform_server")


def with_rate(url: str, rate: float, place: str) -> str:
    """``url`` with a scenario's ``rate`` [Hz], if its protocol has that option and none is given.

    Raises:
        InputError: another rate is given, or the protocol has a different period.
    """
    settings = find(url, place).settings
    if "rate" in settings.model_fields and "rate=" not in url:
        return f"{url}{'&' if '?' in url else '?'}rate={rate:g}"
    if "period_ms" in settings.model_fields:
        period = 1e-3 * parse(url, settings, place).period_ms  # type: ignore[attr-defined]
        if abs(period * rate - 1.0) > 1e-6:  # beyond the rounding of a written rate
            message = (
                f"is {1e3 * period:g} ms, the scenario's tick {1e3 / rate:g} "
                f"ms; set rate to {1.0 / period:g} (--set rate=...)"
            )
            raise refused(f"{place} {url}", message, "period_ms")
    return url


def _load(scheme: str) -> Protocol:
    return _registered.get(scheme) or import_module(f"hiltestbed.devices.{scheme}").PROTOCOL


def _made(url: str, place: str, part: str):
    protocol = find(url, place)
    made = getattr(protocol, part)
    if made is None:
        what = "a force sensor" if part.startswith("sensor") else "a motion platform"
        able = [name for name, other in protocols().items() if getattr(other, part) is not None]
        raise refused(
            f"{place} {url}",
            f"{protocol.scheme} is not a protocol of {what} ({protocol.summary}); "
            f"allowed: {', '.join(able)}",
        )
    poses.compile_now()
    return made(parse(url, protocol.settings, place))
