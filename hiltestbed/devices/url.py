"""A device as the user specifies it: ``scheme://host:port?option=value&...``, checked against its
protocol's settings.

The default address is the loopback address. An option's value is parsed like a scenario's values,
and all faults are reported at once.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, TypeVar
from urllib.parse import SplitResult, parse_qsl, urlsplit

from pydantic import BaseModel, Field

from hiltestbed.config.validation import Strictly, nearest, validate
from hiltestbed.config.yaml_source import Source, parse_yaml
from hiltestbed.errors import Fault, InputError

LOOPBACK = "127.0.0.1"
LONGEST = 2000  # characters

Port = Annotated[int, Field(ge=0, le=65535)]
Settings = TypeVar("Settings", bound=BaseModel)


class DeviceSettings(Strictly):
    """Settings common to all protocols; ``where`` is the URL as given, for messages."""

    default_port: ClassVar[int] = 0

    where: str = Field(default="", description="the URL as given")
    host: str = Field(
        default=LOOPBACK,
        description="address of the device, or of this machine if the device opens the connection",
    )
    port: Port = Field(default=0, description="its port")

    @property
    def device_tells_rate(self) -> bool:
        """Whether a client reads the rate from the device itself."""
        return False


_FROM_ADDRESS = ("where", "host", "port", "kind")


def scheme_of(url: str, place: str) -> str:
    """The scheme of a URL. Raises InputError if there is none."""
    scheme, separator, _ = url.partition("://")
    if not separator or not scheme or len(url) > LONGEST:
        raise InputError(
            Fault(
                place,
                None,
                None,
                "",
                f"is not a device (got {url[:80]!r}); give it as scheme://host:port?option=value",
            )
        )
    return scheme.lower()


def parse(url: str, model: type[Settings], place: str) -> Settings:
    """The settings in a URL.

    Args:
        model: class of the settings of the URL's protocol.
        place: where the URL was given (``--sensor``), for messages.

    Raises:
        InputError: every fault of the URL, each with the options that are allowed.
    """
    data: dict[str, Any] = {}
    faults: list[Fault] = []
    file = f"{place} {url}"
    parts = _split(url, file)
    host = parts.hostname
    if host:
        data["host"] = host
    try:
        port = parts.port
    except ValueError:
        text = parts.netloc.rpartition(":")[2]
        raise InputError(
            Fault(file, None, None, "port", f"is not a port (got {text!r}); allowed is 0 to 65535")
        ) from None
    data["port"] = port if port is not None else getattr(model, "default_port", 0)
    data["where"] = url
    if parts.path.strip("/") or parts.fragment or parts.username is not None:
        faults.append(
            Fault(
                file,
                None,
                None,
                "",
                "has a path, a user or a fragment; give it as scheme://host:port?option=value",
            )
        )
    options = [name for name in model.model_fields if name not in _FROM_ADDRESS]
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        if key in _FROM_ADDRESS:
            faults.append(
                Fault(
                    file,
                    None,
                    None,
                    key,
                    "is not an option; the address goes before the question mark",
                )
            )
        elif key in data:
            faults.append(
                Fault(file, None, None, key, "is given twice; each option may stand once")
            )
        elif key not in options:
            message = (
                f"unknown option{nearest(key, options)}; allowed: {', '.join(options) or 'none'}"
            )
            faults.append(Fault(file, None, None, key, message))
        else:
            data[key] = _value(value, file, key, faults)
    try:
        settings = validate(model, Source(file, data))
    except InputError as error:
        raise InputError([*faults, *error.faults]) from None
    if faults:
        raise InputError(faults)
    return settings


def _split(url: str, file: str) -> SplitResult:
    try:
        return urlsplit(url)
    except ValueError as error:
        raise InputError(
            Fault(
                file,
                None,
                None,
                "",
                f"is not a URL ({error}); give it as scheme://host:port?option=value",
            )
        ) from None


def _value(text: str, file: str, key: str, faults: list[Fault]) -> Any:
    try:
        return parse_yaml(text, file)[0]
    except InputError as error:
        faults.extend(Fault(file, None, None, key, fault.message) for fault in error.faults)
        return text
