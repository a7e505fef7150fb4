"""Mutations of files: what broken transfers, other writers and attackers make of them."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from typing import Final

_NUMBER: Final = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_TAG: Final = re.compile(rb"<[^<>]{1,200}>")
_NUMBERS: Final = (
    b"nan", b"inf", b"-inf", b"0", b"-0.0", b"-1", b"1e308", b"-1e308", b"1e400", b"1e-320",
    b"9223372036854775808", b"2147483648", b"99999999999", b"1_000", b"0x10", b"", b"1,5", b"--1",
    b"1e", b"\xd9\xa3", b"True", b"null", b"-7200", b"360", b"-90.000001", b"1e9",
)  # fmt: skip
_SCRAPS: Final = (
    b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n\n", b"\t", b"\x1a", b'"', b"'", b",", b";",
    b"=", b"[", b"{", b"]]>", b"&#0;", b"&lol;", b"<!--", b"{{", b"%s", b"../../etc/passwd",
    b"/vsicurl/http://127.0.0.1/x", b"\xf0\x9f\x9b\xb0", b"NaN,", b"END;", b"A" * 4096,
)  # fmt: skip
_BOMB: Final = (
    b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">'
    b'<!ENTITY c SYSTEM "file:///etc/passwd">]>'
)
_LONGEST: Final = 4_000_000

Mutation = Callable[[bytes, random.Random], bytes]


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Return `data` with one to four mutations."""
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        data = rng.choice(MUTATIONS)(data, rng)
        if len(data) > _LONGEST:
            return data[:_LONGEST]
    return data


def _span(data: bytes, rng: random.Random, longest: int = 400) -> tuple[int, int]:
    begin = rng.randrange(len(data) + 1)
    return begin, min(len(data), begin + rng.randrange(1, longest))


def _flip(data: bytes, rng: random.Random) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 5)):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(data: bytes, rng: random.Random) -> bytes:
    begin, end = _span(data, rng)
    return data[:begin] + data[end:]


def _truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _repeat(data: bytes, rng: random.Random) -> bytes:
    begin, end = _span(data, rng)
    return data[:end] + data[begin:end] * rng.choice((1, 1, 2, 50)) + data[end:]


def _number(data: bytes, rng: random.Random) -> bytes:
    found = list(_NUMBER.finditer(data))
    if not found:
        return _flip(data, rng)
    match = rng.choice(found)
    return data[: match.start()] + rng.choice(_NUMBERS) + data[match.end() :]


def _swap_numbers(data: bytes, rng: random.Random) -> bytes:
    found = list(_NUMBER.finditer(data))
    if len(found) < 2:
        return _flip(data, rng)
    a, b = sorted(rng.sample(found, 2), key=lambda match: match.start())
    return b"".join((data[: a.start()], b[0], data[a.end() : b.start()], a[0], data[b.end() :]))


def _tag(data: bytes, rng: random.Random) -> bytes:
    found = list(_TAG.finditer(data))
    if not found:
        return _cut(data, rng)
    match = rng.choice(found)
    other = rng.choice((b"", match[0] * 2, rng.choice(found)[0], match[0].swapcase()))
    return data[: match.start()] + other + data[match.end() :]


def _lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    if len(lines) < 2:
        return _repeat(data, rng)
    kind = rng.randrange(4)
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    if kind == 0:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 1:
        del lines[min(i, j) : max(i, j)]
    elif kind == 2:
        lines.insert(i, lines[j])
    else:
        rng.shuffle(lines)
    return b"".join(lines)


def _scrap(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.choice(_SCRAPS) + data[at:]


def _noise(data: bytes, rng: random.Random) -> bytes:
    begin, end = _span(data, rng, 64)
    return data[:begin] + rng.randbytes(end - begin) + data[end:]


def _bomb(data: bytes, rng: random.Random) -> bytes:
    """Put an entity bomb, and an entity that reads a file, into an XML file's head."""
    if not data.lstrip().startswith(b"<"):
        return _scrap(data, rng)
    body = data[data.find(b"?>") + 2 :] if data.lstrip().startswith(b"<?xml") else data
    at = body.find(b">", body.find(b"<")) + 1
    return _BOMB + body[:at] + b"&b;&c;" + body[at:]


def _other_encoding(data: bytes, rng: random.Random) -> bytes:
    text = data.decode("latin-1")
    return text.encode(rng.choice(("utf-16", "utf-32", "utf-8")), "replace")


def _empty(data: bytes, rng: random.Random) -> bytes:
    return rng.choice((b"", b"\n", b" ", b"{}", b"[]", b"<a/>", b"\x00" * 64))


MUTATIONS: Final[tuple[Mutation, ...]] = (
    _flip, _cut, _truncate, _repeat, _number, _number, _number, _swap_numbers, _tag, _tag, _lines,
    _lines, _scrap, _noise, _bomb, _other_encoding, _empty,
)  # fmt: skip
