"""Mutations of files for fuzzing: of bytes, of values in JSON, and of members of zip archives."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import re
import struct
import warnings
import zipfile
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Iterator, Sequence

VALUES = (
    None, True, -1, 0, 1, 2, 3, 255, 2**31, 2**53, 10**30, 0.5, 1e300, float("nan"), float("inf"), "", "x", "../a.bin",
    "data:;base64,AAAA", "data:x", "\0", [], [0], [0, 0], [[]], {}, {"index": 0}, {"count": 10**9},
)  # fmt: skip
NUMBERS = (
    b"nan", b"inf", b"-1", b"0", b"1e308", b"1e-308", b"2147483648", b"99999999999999999999", b"/etc/passwd",
)  # fmt: skip
_NUMBER = re.compile(rb"[-+.\deE]+")
_JSON_CHUNK = 0x4E4F534A
# Largest size of a mutated file [bytes]. Larger files are read more slowly, and mutations of larger files find no other
# faults.
_MOST_BYTES = 1 << 16


def mutated(content: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return the content of a file with random damage, which may include a part of another file.

    A third of the mutations of JSON, glTF and zip files damage the bytes; the others damage a value or a member.
    """
    structured: Callable[[bytes, random.Random], bytes] | None = None
    if content[:1] == b"{" or content[:4] == b"glTF":
        structured = _json_damage
    elif content[:4] == b"PK\x03\x04":
        structured = _zip_damage
    if structured is not None and rng.random() < 2.0 / 3.0:
        with contextlib.suppress(ValueError, zipfile.BadZipFile, struct.error, RecursionError, NotImplementedError):
            return structured(content, rng)[:_MOST_BYTES]
    if others and rng.random() < 0.1:
        other = rng.choice(others)
        return (content[: rng.randrange(len(content) + 1)] + other[rng.randrange(len(other) + 1) :])[:_MOST_BYTES]
    return byte_damage(content, rng)[:_MOST_BYTES]


def byte_damage(content: bytes, rng: random.Random) -> bytes:
    """Return content with one to three random kinds of damage of its bytes, lines or numbers."""
    result = bytearray(content)
    for _ in range(rng.randint(1, 3)):
        size = max(len(result), 1)
        at, length = rng.randrange(size), rng.randint(1, 16)
        match rng.randrange(8):
            case 0:
                del result[at:]
            case 1:
                del result[at : at + length]
            case 2:
                result[at:at] = rng.randbytes(length)
            case 3:
                result[at : at + length] = bytes([rng.choice((0, 255, 127))]) * length
            case 4 if result:
                result[at % len(result)] ^= 1 << rng.randrange(8)
            case 5:
                result[at:at] = result[: rng.randrange(size + 1)]
            case 6:
                lines = result.split(b"\n")
                lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines))
                lines.pop(rng.randrange(len(lines)))
                result = bytearray(b"\n".join(lines))
            case _:
                numbers = list(_NUMBER.finditer(bytes(result)))
                if numbers:
                    begin, end = rng.choice(numbers).span()
                    result[begin:end] = rng.choice(NUMBERS)
    return bytes(result)


def _json_damage(content: bytes, rng: random.Random) -> bytes:
    """Return a JSON or glTF file in which one to three values are removed or replaced."""
    is_binary = content[:4] == b"glTF"
    size = int.from_bytes(content[12:16], "little")
    tree = json.loads(content[20 : 20 + size] if is_binary else content)
    for _ in range(rng.randint(1, 3)):
        places = list(_containers(tree))
        if not places:
            break
        container = rng.choice(places)
        name = rng.choice(list(container) if isinstance(container, dict) else range(len(container)))
        match rng.randrange(4):
            case 0:
                del container[name]
            case 1:
                container[name] = copy.deepcopy(rng.choice(places))
            case _:
                container[name] = copy.deepcopy(rng.choice(VALUES))
    text = json.dumps(tree).encode()
    if not is_binary:
        return text
    rest = content[20 + size :]
    return b"glTF" + struct.pack("<IIII", 2, 20 + len(text) + len(rest), len(text), _JSON_CHUNK) + text + rest


def _containers(tree: Any) -> Iterator[Any]:
    """Yield all objects and lists of a JSON value that are not empty."""
    if isinstance(tree, (dict, list)) and tree:
        yield tree
        for value in tree.values() if isinstance(tree, dict) else tree:
            yield from _containers(value)


def _zip_damage(content: bytes, rng: random.Random) -> bytes:
    """Return a zip archive of which a member is damaged, removed, renamed or stored twice, with correct checksums."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(entry.filename, archive.read(entry)[:_MOST_BYTES]) for entry in archive.infolist()]
    index = rng.randrange(len(members))
    name, data = members[index]
    match rng.randrange(6):
        case 0:
            members.pop(index)
        case 1:
            members[index] = (rng.choice(members)[0], data)
        case 2:
            members.append((name, byte_damage(data, rng)))
        case _:
            members[index] = (name, byte_damage(data, rng))
    stream = io.BytesIO()
    # Python warns of two members with the same name, which is intended here.
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(stream, "w", method) as archive:
        for member, value in members:
            archive.writestr(zipfile.ZipInfo(member), value)
    return stream.getvalue()
