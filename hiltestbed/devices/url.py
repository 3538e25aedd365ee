"""A device as the user specifies it: ``scheme://host:port?option=value&...``, checked against its
protocol's settings.

The default address is the loopback address. An option's value is parsed like a scenario's values,
and all faults are reported at once.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, TypeVar
from urllib.parse import parse_qsl, urlsplit

from pydantic import Field

from hiltestbed.config.validation import Positive, Strictly, nearest, validate
from hiltestbed.config.yaml_source import Source, parse_yaml
from hiltestbed.errors import Fault, InputError

LOOPBACK = "127.0.0.1"
LONGEST = 2000  # characters
FORM = "give it as scheme://host:port?option=value"

Port = Annotated[int, Field(ge=0, le=65535)]


class DeviceSettings(Strictly):
    """Settings common to all protocols; ``where`` is the URL as given, for messages."""

    default_port: ClassVar[int] = 0

    where: str = ""  # the URL as given
    host: str = LOOPBACK  # of the device, or of this machine if the device opens the connection
    port: Port = 0

    @property
    def period(self) -> float:
        """Time between two records [s]; NaN if the device reports it."""
        return math.nan

    @property
    def device_tells_rate(self) -> bool:
        """Whether a client reads the rate from the device itself."""
        return False


class PacedSettings(DeviceSettings):
    """Settings of protocols whose records come at a rate that the user gives."""

    rate: Positive = 1000.0  # [Hz] of the records
    clock: Literal["device", "host"] = "device"  # what paces the cycle: the records, or the loop
    connect: Positive = 2.0  # [s] to wait for the first record

    @property
    def period(self) -> float:
        return 1.0 / self.rate


Settings = TypeVar("Settings", bound=DeviceSettings)
_FROM_ADDRESS = ("where", "host", "port")


def refused(where: str, message: str, key: str = "") -> InputError:
    """The error for a device that is wrong as given: the place, and the option if it is one's."""
    return InputError(Fault(where, None, None, key, message))


def scheme_of(url: str, place: str) -> str:
    """The scheme of a URL. Raises InputError if there is none."""
    scheme, separator, _ = url.partition("://")
    if not separator or not scheme or len(url) > LONGEST:
        raise refused(place, f"is not a device (got {url[:80]!r}); {FORM}")
    return scheme.lower()


def parse(url: str, model: type[Settings], place: str) -> Settings:
    """The settings in a URL, which was given at ``place`` (``--sensor``).

    Raises InputError with every fault, each with the options that are allowed.
    """
    file = f"{place} {url}"
    faults: list[Fault] = []

    def fault(key: str, message: str) -> None:
        faults.append(Fault(file, None, None, key, message))

    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise refused(file, f"is not a URL ({error}); {FORM}") from None
    try:
        port = parts.port
    except ValueError:
        text = parts.netloc.rpartition(":")[2]
        raise refused(
            file, f"is not a port (got {text!r}); allowed is 0 to 65535", "port"
        ) from None
    data: dict[str, Any] = {"port": model.default_port if port is None else port, "where": url}
    if parts.hostname:
        data["host"] = parts.hostname
    if parts.path.strip("/") or parts.fragment or parts.username is not None:
        fault("", f"has a path, a user or a fragment; {FORM}")
    options = [name for name in model.model_fields if name not in _FROM_ADDRESS]
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        if key in _FROM_ADDRESS:
            fault(key, "is not an option; the address goes before the question mark")
        elif key in data:
            fault(key, "is given twice; each option may stand once")
        elif key not in options:
            allowed = ", ".join(options) or "none"
            fault(key, f"unknown option{nearest(key, options)}; allowed: {allowed}")
        else:
            try:
                data[key] = parse_yaml(value, file)[0]
            except InputError as error:
                data[key] = value
                for found in error.faults:
                    fault(key, found.message)
    try:
        settings = validate(model, Source(file, data))
    except InputError as error:
        raise InputError([*faults, *error.faults]) from None
    if faults:
        raise InputError(faults)
    return settings
