"""What the XML dialects share: tags that must be there once, and tags to write."""

from __future__ import annotations

from collections.abc import Mapping
from xml.sax.saxutils import escape

from geoposition.errors import ProductError
from geoposition.rpc.formats import _fields as fields
from geoposition.xmlfile import XmlNode

Tree = Mapping[str, "str | Tree"]


def once(node: XmlNode, tag: str) -> XmlNode:
    """Return the child `tag`; a missing or repeated one is a `ProductError`."""
    found = node.need(tag)
    if len(node.all(tag)) > 1:
        raise ProductError(node.path, found.place, "this tag is given twice")
    return found


def number(node: XmlNode, tag: str) -> float:
    """Finite number in the child `tag`, which must be there once."""
    return once(node, tag).number()


def optional_number(node: XmlNode, tag: str) -> float | None:
    """Finite number in the child `tag`, or None where there is none."""
    return None if node.find(tag) is None else number(node, tag)


def optional_pair(node: XmlNode, first: str, second: str) -> tuple[float, float] | None:
    """Finite numbers in two children, or None where either is missing."""
    a, b = optional_number(node, first), optional_number(node, second)
    return None if a is None or b is None else (a, b)


def zero_based(node: XmlNode, tag: str) -> float:
    """0-based value of the 1-based number in the child `tag`."""
    child = once(node, tag)
    return fields.from_one_based(child.path, child.place, child.text())


def render(root: str, tree: Tree, pixel_origin: str) -> str:
    """Indented document with `root` around `tree`; texts are escaped."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f"<!-- Pixels: {pixel_origin}. Heights: {fields.HEIGHT_DATUM}. -->",
    ]

    def put(tag: str, value: str | Tree, depth: int) -> None:
        pad = "  " * depth
        if isinstance(value, str):
            lines.append(f"{pad}<{tag}>{escape(value)}</{tag.split()[0]}>")
            return
        lines.append(f"{pad}<{tag}>")
        for name, child in value.items():
            put(name, child, depth + 1)
        lines.append(f"{pad}</{tag.split()[0]}>")

    put(root, tree, 0)
    return "\n".join(lines) + "\n"
