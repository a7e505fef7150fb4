"""Untrusted XML: parsed without entities or external references, asked for by path.

Every miss is a `ProductError` that names the file and the tag.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import parse

from geoposition.arrays import FloatArray
from geoposition.errors import MissingFileError, ProductError

MAX_XML_BYTES = 256 * 2**20


@dataclass(frozen=True, slots=True)
class XmlNode:
    """One element of a file; `place` is its path from the root, for messages."""

    path: Path
    place: str
    element: Element

    @property
    def tag(self) -> str:
        """Element name without its namespace."""
        return local_name(self.element)

    def find(self, tags: str) -> XmlNode | None:
        """First descendant at the path `tags` ("A/B/C"), or None."""
        nodes = self.all(tags)
        return XmlNode(self.path, f"{self.place}/{tags}", nodes[0].element) if nodes else None

    def need(self, tags: str) -> XmlNode:
        """First descendant at the path `tags`; a missing one is a `ProductError`."""
        node = self.find(tags)
        if node is None:
            raise ProductError(self.path, f"{self.place}/{tags}", "this tag is missing")
        return node

    def all(self, tags: str) -> list[XmlNode]:
        """All descendants at the path `tags`, in file order; the list may be empty."""
        level = [self.element]
        for tag in tags.split("/"):
            level = [child for element in level for child in element if local_name(child) == tag]
        place = f"{self.place}/{tags}"
        return [XmlNode(self.path, f"{place}[{i + 1}]", e) for i, e in enumerate(level)]

    def some(self, tags: str) -> list[XmlNode]:
        """Like `all`, but at least one must be there."""
        nodes = self.all(tags)
        if not nodes:
            raise ProductError(self.path, f"{self.place}/{tags}", "this tag is missing")
        return nodes

    def text(self, tags: str = "") -> str:
        """Return the stripped text of the element (or of the descendant at `tags`), not empty."""
        node = self.need(tags) if tags else self
        text = (node.element.text or "").strip()
        if not text:
            raise ProductError(node.path, node.place, "text expected, this tag is empty")
        return text

    def number(self, tags: str = "") -> float:
        """Finite number in the element (or in the descendant at `tags`)."""
        node = self.need(tags) if tags else self
        return float(node.numbers(1)[0])

    def integer(self, tags: str = "") -> int:
        """Whole number in the element (or in the descendant at `tags`)."""
        node = self.need(tags) if tags else self
        value = node.number()
        if value != math.floor(value):
            raise ProductError(node.path, node.place, f"a whole number expected, got {value!r}")
        return int(value)

    def numbers(self, count: int | None = None) -> FloatArray:
        """Finite numbers in the element's text, separated by white space or commas."""
        words = self.text().replace(",", " ").split()
        if count is not None and len(words) != count:
            raise ProductError(
                self.path, self.place, f"{count} number(s) expected, got {len(words)}"
            )
        try:
            if any("_" in word for word in words):  # digit groups of Python, not of XML
                raise ValueError
            values = np.array([float(word) for word in words])
        except ValueError:
            raise ProductError(
                self.path, self.place, f"number(s) expected, got {self.text()[:40]!r}"
            ) from None
        if not np.all(np.isfinite(values)):
            raise ProductError(self.path, self.place, "finite numbers expected")
        return values


def local_name(element: Element) -> str:
    """Element name without its namespace."""
    return str(element.tag).rpartition("}")[2]


def read_xml(path: str | Path) -> XmlNode:
    """Parse `path` and return its root; entities, external references and bombs are refused."""
    path = Path(path)
    if path.is_dir():
        raise ProductError(path, "", "an XML document expected, this is a folder")
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    if path.stat().st_size == 0:
        raise ProductError(path, "", "an XML document expected, the file is empty")
    if path.stat().st_size > MAX_XML_BYTES:
        raise ProductError(path, "", f"larger than {MAX_XML_BYTES >> 20} MiB, refused")
    try:
        root = parse(path, forbid_dtd=False, forbid_entities=True, forbid_external=True).getroot()
    except DefusedXmlException as error:
        raise ProductError(
            path, type(error).__name__, "XML with entities or external references is refused"
        ) from None
    except ParseError as error:
        line, column = error.position
        raise ProductError(
            path, f"line {line}, column {column}", f"well-formed XML expected ({error.msg})"
        ) from None
    except (ValueError, LookupError) as error:
        raise ProductError(path, "encoding", f"readable XML expected ({error})") from None
    return XmlNode(path, local_name(root), root)
