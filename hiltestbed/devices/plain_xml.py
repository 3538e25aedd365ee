"""Small XML messages from the network: elements, attributes and text only.

Document types, entities, processing instructions and messages beyond the limits of size and depth
are refused.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.parsers import expat

DEPTH = 4
ELEMENTS = 256
# all read as UTF-8: the messages are plain ASCII
ENCODINGS = ("utf-8", "us-ascii", "ascii", "iso-8859-1", "windows-1252")


class NotPlain(Exception):
    """The bytes are not a small plain XML message."""


@dataclass
class Message:
    """The root's name, and attributes and text of each element below it; of several with the same
    name the first.
    """

    root: str = ""
    attributes: dict[str, dict[str, str]] = field(default_factory=dict)
    text: dict[str, str] = field(default_factory=dict)


def read(data: bytes, size: int) -> Message:
    """Parse ``data`` of at most ``size`` bytes. Raises NotPlain."""
    if len(data) > size:
        raise NotPlain
    message, path = Message(), []
    parser = expat.ParserCreate("utf-8")
    parser.buffer_text = True

    def start(name: str, attributes: dict[str, str]) -> None:
        path.append(name)
        if len(path) > DEPTH or len(message.attributes) > ELEMENTS:
            raise NotPlain
        if len(path) == 1:
            message.root = name
        elif name not in message.attributes:
            message.attributes[name] = attributes

    def end(name: str) -> None:
        path.pop()

    def characters(text: str) -> None:
        if len(path) > 1 and path[-1] not in message.text:
            message.text[path[-1]] = text

    def refuse(*_: object) -> None:
        raise NotPlain

    def declaration(version: str, encoding: str | None, standalone: int) -> None:
        if (encoding or "utf-8").lower() not in ENCODINGS:
            raise NotPlain

    parser.XmlDeclHandler = declaration
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = characters
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.ProcessingInstructionHandler = refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError) as error:
        raise NotPlain from error
    return message
