"""Mutations of files for fuzzing: of bytes, values in JSON, members of archives, and records of other formats."""

from __future__ import annotations

import contextlib
import copy
import functools
import gzip
import io
import json
import re
import struct
import warnings
import zipfile
import zlib
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

    If the structure of the file is known, a third of the mutations damage single bytes. The others damage a value, a
    member of an archive or a record. Sizes and checksums in the file are then corrected, because a reader would
    otherwise stop before it reads the damaged part.
    """
    structured = next((damage for start, damage in _STRUCTURES if content.startswith(start)), None)
    if structured is not None and rng.random() < 2.0 / 3.0:
        # The file may be damaged already, so that its structure cannot be parsed. The listed exceptions are those of
        # the parsers; zipfile raises NotImplementedError for an unknown compression.
        with contextlib.suppress(
            ValueError, zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, RecursionError,
            NotImplementedError,
        ):  # fmt: skip
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
                if number := _NUMBER.search(result, at):
                    begin, end = number.span()
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


@functools.lru_cache(maxsize=64)
def _members(content: bytes) -> list[tuple[str, bytes]]:
    """Return names and contents of the members of a zip archive."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return [(entry.filename, archive.read(entry)[:_MOST_BYTES]) for entry in archive.infolist()]


def _zip_damage(content: bytes, rng: random.Random) -> bytes:
    """Return a zip archive of which a member is damaged, removed, renamed or stored twice, with correct checksums."""
    members = list(_members(content))
    index = rng.randrange(len(members))
    name, data = members[index]
    match rng.randrange(8):
        case 0:
            members.pop(index)
        case 1:
            members[index] = (rng.choice(members)[0], data)
        case 2:
            members.append((name, byte_damage(data, rng)))
        case _:
            members[index] = (name, mutated(data, [], rng))
    stream = io.BytesIO()
    # Python warns of two members with the same name, which is intended here.
    method = zipfile.ZIP_STORED if rng.random() < 0.8 else zipfile.ZIP_DEFLATED
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(stream, "w", method, compresslevel=1) as archive:
        for member, value in members:
            archive.writestr(zipfile.ZipInfo(member), value)
    return stream.getvalue()


def _npy_damage(content: bytes, rng: random.Random) -> bytes:
    """Return a file in NumPy's format of version 1 whose header is damaged, and states its own size correctly."""
    size = int.from_bytes(content[8:10], "little")
    header = byte_damage(content[10 : 10 + size], rng)[: 2**16 - 1]
    return content[:8] + struct.pack("<H", len(header)) + header + content[10 + size :]


def _gzip_damage(content: bytes, rng: random.Random) -> bytes:
    """Return a gzip file whose content is damaged, with a correct checksum."""
    return gzip.compress(byte_damage(gzip.decompress(content), rng), 1, mtime=0)


def _png_damage(content: bytes, rng: random.Random) -> bytes:
    """Return a PNG image of which a chunk is damaged, removed or repeated, with correct sizes and checksums."""
    chunks, at = [], 8
    while at < len(content):
        size = int.from_bytes(content[at : at + 4])
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    index = rng.randrange(len(chunks))
    kind, data = chunks[index]
    match rng.randrange(6):
        case 0:
            chunks.pop(index)
        case 1:
            chunks.insert(rng.randrange(len(chunks) + 1), (kind, data))
        case _ if kind == b"IDAT":
            chunks[index] = kind, zlib.compress(byte_damage(zlib.decompress(data), rng), 1)
        case _:
            chunks[index] = kind, byte_damage(data, rng)
    return content[:8] + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def gds_records(content: bytes) -> list[tuple[bytes, bytes]]:
    """Return the type and the data of each record of a GDS layout."""
    records, at = [], 0
    while at + 4 <= len(content):
        size = max(int.from_bytes(content[at : at + 2]), 4)
        records.append((content[at + 2 : at + 4], content[at + 4 : at + size]))
        at += size
    return records


def gds_content(records: Sequence[tuple[bytes, bytes]]) -> bytes:
    """Return the bytes of a GDS layout with these records (type and data), each preceded by its size."""
    return b"".join(struct.pack(">H", 4 + len(data[:65530])) + kind + data[:65530] for kind, data in records)


def _gds_damage(content: bytes, rng: random.Random) -> bytes:
    """Return a GDS layout of which one to three records are damaged, removed, repeated or moved, with correct sizes."""
    records = gds_records(content)
    for _ in range(rng.randint(1, 3)):
        index = rng.randrange(len(records))
        kind, data = records[index]
        match rng.randrange(8):
            case 0 if len(records) > 1:
                records.pop(index)
            case 1:
                records.insert(rng.randrange(len(records) + 1), (kind, data))
            case 2:
                records[index] = rng.choice(records)[0], data
            case 3:
                records[index] = bytes([rng.randrange(64), rng.randrange(8)]), data
            case 4:
                begin, end = sorted(rng.choices(range(len(records) + 1), k=2))
                records[begin:begin] = records[begin : min(end, begin + 20)]
            case 5 if data:
                place = rng.randrange(len(data))
                value = rng.choice((0, 1, 2, 4, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000))
                size = 2 if value < 2**16 else 4
                records[index] = kind, data[: place - place % size] + value.to_bytes(size) + data[place + size :]
            case 6:
                records[index] = kind, rng.choice(records)[1]
            case _:
                records[index] = kind, byte_damage(data, rng)
    return gds_content(records)


# Functions that damage files of a known structure, with the bytes at the beginning of these files.
_STRUCTURES: tuple[tuple[bytes, Callable[[bytes, random.Random], bytes]], ...] = (
    (b"{", _json_damage), (b"glTF", _json_damage), (b"PK\x03\x04", _zip_damage), (b"\x93NUMPY\x01", _npy_damage),
    (b"\x1f\x8b", _gzip_damage), (b"\x89PNG", _png_damage), (b"\0\x06\0\x02", _gds_damage),
)  # fmt: skip
