"""Small XML messages from the network: elements, attributes and text only."""

from __future__ import annotations

from xml.etree import ElementTree


class NotPlain(Exception):
    """The bytes are not a small plain XML message."""


class _Plain(ElementTree.TreeBuilder):
    """Refuses document types, and with them entities, and processing instructions."""

    def doctype(self, *_: object) -> None:
        raise NotPlain

    def pi(self, *_: object) -> None:
        raise NotPlain


def read(data: bytes, size: int) -> ElementTree.Element:
    """The root of a message of at most ``size`` bytes. Raises NotPlain."""
    if len(data) > size:
        raise NotPlain
    try:
        return ElementTree.fromstring(data, ElementTree.XMLParser(target=_Plain()))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise NotPlain from error


def find(root: ElementTree.Element, name: str) -> ElementTree.Element | None:
    """The first element of this name below ``root``, at any depth."""
    return root.find(f".//{name}")
