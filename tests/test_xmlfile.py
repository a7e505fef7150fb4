"""Untrusted XML: every kind of bad file is one line naming file and place."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import pytest

from geoposition.errors import GeopositionError, MissingFileError, ProductError
from geoposition.xmlfile import MAX_XML_BYTES, XmlNode, read_xml

GOOD = """<?xml version="1.0" encoding="UTF-8"?>
<Doc xmlns="http://x.org/a" xmlns:b="http://x.org/b">
  <Meta><b:Name> Pléiades </b:Name><Empty/></Meta>
  <Points><P>1 2,3</P><P>4.5e1</P><Q n="7">-8</Q></Points>
  <Points><P>9</P></Points>
  <Twice><A/></Twice><Twice><B>yes</B></Twice>
  <Bad><Nan>NaN</Nan><Inf>1 inf</Inf><Word>3 m</Word><Half>2.5</Half><Under>1_000</Under></Bad>
</Doc>
"""


@pytest.fixture
def doc(tmp_path: Path) -> XmlNode:
    path = tmp_path / "good.xml"
    path.write_text(GOOD, encoding="utf-8")
    return read_xml(path)


def refused(tmp_path: Path, content: str | bytes) -> ProductError:
    path = tmp_path / "bad.xml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    start = time.perf_counter()
    with pytest.raises(ProductError) as caught:
        read_xml(path)
    assert time.perf_counter() - start < 10.0
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert isinstance(caught.value, (GeopositionError, ValueError))
    return caught.value


def test_paths_and_namespaces(doc: XmlNode) -> None:
    assert doc.tag == "Doc"
    assert doc.text("Meta/Name") == "Pléiades"
    assert doc.need("Meta/Name").place == "Doc/Meta/Name"
    assert doc.find("Meta/Nothing") is None
    assert doc.find("Nothing/Name") is None
    assert [node.number() for node in doc.all("Points/P")[1:]] == [45.0, 9.0]
    assert doc.all("Points/P")[2].place == "Doc/Points/P[3]"
    assert doc.all("Points/X") == []
    assert doc.need("Points").integer("Q") == -8
    assert doc.need("Points/P").numbers().tolist() == [1.0, 2.0, 3.0]
    assert doc.need("Points/P").numbers(3).tolist() == [1.0, 2.0, 3.0]


def test_first_at_a_path_looks_into_every_branch(doc: XmlNode) -> None:
    # What `all` finds, `find` finds.
    assert len(doc.all("Twice/B")) == 1
    assert doc.text("Twice/B") == "yes"


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda d: d.need("Meta/Nothing"), "Doc/Meta/Nothing: this tag is missing"),
        (lambda d: d.some("Points/X"), "Doc/Points/X: this tag is missing"),
        (lambda d: d.text("Meta/Empty"), "Doc/Meta/Empty: text expected"),
        (lambda d: d.number("Meta/Empty"), "Doc/Meta/Empty: text expected"),
        (lambda d: d.number("Points/P"), r"Doc/Points/P: 1 number\(s\) expected, got 3"),
        (lambda d: d.all("Points/P")[1].numbers(2), r"P\[2\]: 2 number\(s\) expected, got 1"),
        (lambda d: d.number("Bad/Nan"), "Doc/Bad/Nan: finite"),
        (lambda d: d.need("Bad/Inf").numbers(2), "Doc/Bad/Inf: finite"),
        (lambda d: d.need("Bad/Word").numbers(), "Doc/Bad/Word: number.s. expected, got '3 m'"),
        (lambda d: d.integer("Bad/Half"), "Doc/Bad/Half: a whole number expected, got 2.5"),
        (lambda d: d.integer("Meta/Name"), "Doc/Meta/Name: number"),
        # Python's own digit grouping is no XML number.
        (lambda d: d.number("Bad/Under"), "Doc/Bad/Under: number.s. expected, got '1_000'"),
    ],
)
def test_misses_name_file_and_place(doc: XmlNode, ask: object, message: str) -> None:
    with pytest.raises(ProductError, match=message) as caught:
        ask(doc)  # type: ignore[operator]
    assert str(caught.value).startswith(str(doc.path))
    assert "\n" not in str(caught.value)


def test_entity_bomb(tmp_path: Path) -> None:
    levels = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    bomb = f'<!DOCTYPE a [<!ENTITY e0 "ha">{levels}]><a>&e11;</a>'
    assert "refused" in str(refused(tmp_path, bomb))


@pytest.mark.parametrize(
    "document",
    [
        '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>',
        '<!DOCTYPE a [<!ENTITY x "inner">]><a>&x;</a>',
        '<!DOCTYPE a [<!ENTITY % p SYSTEM "http://localhost/x.dtd"> %p;]><a/>',
        '<!DOCTYPE a [<!ENTITY x SYSTEM "pic.gif" NDATA gif>]><a/>',
        '<!DOCTYPE a SYSTEM "http://localhost/x.dtd"><a>&x;</a>',
    ],
)
def test_entities_and_external_references(tmp_path: Path, document: str) -> None:
    refused(tmp_path, document)


def test_a_plain_dtd_reference_is_not_fetched(tmp_path: Path) -> None:
    # DIMAP v1 names its DTD; nothing is read from there.
    path = tmp_path / "dimap.xml"
    path.write_text('<!DOCTYPE Dimap_Document SYSTEM "http://localhost:9/a.dtd"><D><A>1</A></D>')
    try:
        assert read_xml(path).number("A") == 1.0
    except ProductError as error:
        assert "refused" in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"   \n",
        GOOD[: len(GOOD) // 2].encode(),
        GOOD.replace("</Doc>", "").encode(),
        b"not xml at all",
        b"\x89PNG\r\n\x1a\n" + bytes(200),
        b"\x00" * 50,
        b"<a>\xff\xfe\xfd</a>",
        b"<a>1</a><b>2</b>",
        b"<a b='1' b='2'/>",
        b"<a>&undefined;</a>",
        '<?xml version="1.0" encoding="utf-8"?><a>Pl\xe9iades</a>'.encode("latin-1"),
        b'<?xml version="1.0" encoding="no-such-code"?><a/>',
        b'<?xml version="1.0" encoding="utf-16"?><a/>',
        b'<?xml version="1.0" encoding="utf-7"?><a/>',
        "<a>\N{GREEK SMALL LETTER ALPHA}</a>".encode("utf-16")[:-3],
    ],
)
def test_what_is_not_well_formed(tmp_path: Path, content: bytes) -> None:
    refused(tmp_path, content)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_declared_encodings(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.xml"
    name = encoding.removesuffix("-sig")
    path.write_bytes(f'<?xml version="1.0" encoding="{name}"?><a>Pl\xe9iades</a>'.encode(encoding))
    assert read_xml(path).text() == "Pléiades"


def test_deep_nesting(tmp_path: Path) -> None:
    depth = 200_000
    path = tmp_path / "deep.xml"
    path.write_text("<a>" * depth + "</a>" * depth)
    # Read or refused, but never a crash of the parser.
    with contextlib.suppress(ProductError):
        assert read_xml(path).tag == "a"


def test_absent_and_unreadable(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no such file"):
        read_xml(tmp_path / "absent.xml")
    with pytest.raises(ProductError, match="folder"):
        read_xml(tmp_path)


def test_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "large.xml"
    with path.open("wb") as file:
        file.truncate(MAX_XML_BYTES + 1)
    with pytest.raises(ProductError, match="larger than 256 MiB"):
        read_xml(path)
