"""The telegrams of KUKA's RobotSensorInterface: a frame as six attributes, and the controller's
clock. Sources: :mod:`hiltestbed.devices.rsi`.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.devices import plain_xml
from hiltestbed.devices.interface import Array

LARGEST = 4096  # [byte] of a telegram
AXES = ("X", "Y", "Z", "A", "B", "C")
FARTHEST, LARGEST_ANGLE = 1.0e6, 1.0e3  # [mm], [deg] largest plausible values in a telegram
LONGEST_IPOC = 18  # digits


def frame_element(name: str, frame: Array, decimals: int) -> str:
    """``<name X="" ... C=""/>``."""
    values = zip(AXES, frame.tolist(), strict=True)
    inside = " ".join(f'{axis}="{value:.{decimals}f}"' for axis, value in values)
    return f"<{name} {inside}/>"


def answer(sentype: str, correction: Array, ipoc: int, decimals: int) -> bytes:
    """The telegram to the controller; ``correction`` (6,) [mm, deg]."""
    inside = frame_element("RKorr", correction, decimals)
    return f'<Sen Type="{sentype}">{inside}<IPOC>{ipoc}</IPOC></Sen>'.encode("ascii")


def read_frame(message: plain_xml.Message, name: str) -> Array | None:
    """The six numbers of an element; None if they are not six plausible numbers."""
    try:
        frame = np.array([float(message.attributes[name][axis]) for axis in AXES])
    except (KeyError, ValueError):
        return None
    plausible = np.abs(frame) <= np.repeat([FARTHEST, LARGEST_ANGLE], 3)  # false for NaN as well
    return frame if plausible.all() else None


def read_count(text: str | None) -> int | None:
    """The non-negative integer in a text; None if the text is not one."""
    text = (text or "").strip()
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= LONGEST_IPOC else None


def oddity(data: bytes, root: str, element: str) -> str:
    """Why :func:`read_telegram` does not take a telegram, and what to do about it."""
    try:
        message = plain_xml.read(data, LARGEST)
    except plain_xml.NotPlain:
        return (
            f"they are not plain XML of at most {LARGEST} bytes ({data[:20]!r}...); check what "
            f"sends to this port"
        )
    if message.root != root:
        return f"their root is <{message.root}>, not <{root}>; check what sends to this port"
    if element not in message.attributes:
        have = ", ".join(message.attributes) or "nothing"
        return (
            f"they are without {element} (they hold {have}); add the tag DEF_{element}, type "
            f"DOUBLE, to SEND/ELEMENTS in the controller's configuration file"
        )
    if read_frame(message, element) is None:
        given = " ".join(f'{k}="{v}"' for k, v in message.attributes[element].items())
        return (
            f"{element} has no six plausible numbers {' '.join(AXES)} (got {given[:120]!r}); check "
            f"the tag DEF_{element} of SEND/ELEMENTS in the controller's configuration file"
        )
    return f"IPOC is no whole number (got {message.text.get('IPOC')!r}); check what sends them"


def read_telegram(
    data: bytes, root: str, element: str
) -> tuple[plain_xml.Message, Array, int] | None:
    """A telegram with ``root``, the frame in ``element`` and its IPOC; None for anything else."""
    try:
        message = plain_xml.read(data, LARGEST)
    except plain_xml.NotPlain:
        return None
    frame, ipoc = read_frame(message, element), read_count(message.text.get("IPOC"))
    return None if message.root != root or frame is None or ipoc is None else (message, frame, ipoc)
