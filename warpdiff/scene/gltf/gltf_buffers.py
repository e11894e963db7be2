"""Container of a glTF file (.gltf or .glb): its JSON, its buffers, and the files and data URIs to which it refers."""

from __future__ import annotations

import base64
import re
import struct
import urllib.parse
from typing import TYPE_CHECKING

from warpdiff.core import files, memory
from warpdiff.core.wording import ref, renaming
from warpdiff.scene.gltf.gltf_values import Element, parsed, refuse

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_MAGIC = b"glTF"
# Numbers that mark the JSON chunk and the binary chunk of a .glb file.
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
# Pattern of the scheme at the start of a URI, such as "https://" or "file://".
_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


class UnreadableUriError(ValueError):
    """Error about a URI that cannot be opened; the message is the reason."""


class Container:
    """JSON of a glTF file, and its buffers, which are read when they are first used.

    Attributes:
        name: Name of the file.
        root: JSON of the file.
        views: Elements ``bufferViews`` of the file.
    """

    def __init__(self, file: Path) -> None:
        """Read the JSON of a glTF file."""
        memory.require_memory(2.0 * file.stat().st_size, f"{ref('mesh')} file {file.name!r}", "use a smaller one")
        with renaming({"path": "mesh"}), files.naming_file(file):
            data = file.read_bytes()
        self.name = file.name
        self._folder = file.parent.resolve()
        self._binary: memoryview | None = None
        if data[:4] == _MAGIC:
            self.root = parsed(self._read_chunks(data))
        else:
            self.root = parsed(data)
        self._buffers = self.root.elements("buffers")
        self._contents: dict[int, memoryview] = {}
        self.views = self.root.elements("bufferViews")

    def view(self, index: int) -> memoryview:
        """Return the bytes of a buffer view."""
        view = self.views[index]
        for name in _MESHOPT:
            compressed = view.extension(name)
            if compressed is not None and self._is_placeholder(view):
                refuse(view.place, f"requires the extension {name}, which is not supported; export without it")
        number = view.integer("buffer", most=len(self._buffers) - 1)
        begin, size = view.integer("byteOffset", 0), view.integer("byteLength", least=1)
        buffer = self._buffer(number)
        if begin + size > len(buffer):
            rule = f"ends at byte {begin + size}, but buffers[{number}] has {len(buffer)} bytes"
            refuse(view.place, f"{rule}; the file may be truncated")
        return buffer[begin : begin + size]

    def stride(self, index: int) -> int | None:
        """Return the distance of neighbouring elements in a buffer view [bytes]; None if the file states none."""
        view = self.views[index]
        return view.integer("byteStride", least=1) if "byteStride" in view else None

    def resource(self, uri: str) -> bytes:
        """Return the content of a data URI, or of a file in the folder of the glTF file.

        Raises:
            UnreadableUriError: The URI cannot be read. The message is the reason.
        """
        if uri.startswith("data:"):
            return _data_of(uri)
        try:
            return self._path_of(uri).read_bytes()
        except FileNotFoundError as error:
            raise UnreadableUriError(f"there is no file {str(error.filename)!r}") from None
        except OSError as error:
            raise UnreadableUriError(error.strerror or str(error)) from None

    def _path_of(self, uri: str) -> Path:
        """Return the path of a file in the folder of the glTF file, after a check that it fits into memory."""
        if _ADDRESS.match(uri):
            raise UnreadableUriError("it lies outside the mesh's folder")
        try:
            file = (self._folder / urllib.parse.unquote(uri)).resolve()
            size = file.stat().st_size if file.is_relative_to(self._folder) else 0
        except ValueError as error:
            # A file name with a NUL character raises a ValueError in ``pathlib``.
            raise UnreadableUriError(str(error)) from None
        if not file.is_relative_to(self._folder):
            raise UnreadableUriError("it lies outside the mesh's folder")
        if size > memory.available():
            raise UnreadableUriError(f"it has {size / 1e9:.2g} GB, more than the free memory")
        return file

    def _read_chunks(self, data: bytes) -> bytes:
        """Return the JSON chunk of a .glb file, and store its binary chunk."""
        text: bytes | None = None
        for kind, chunk in _chunks(data):
            if kind == _JSON_CHUNK and text is None:
                text = bytes(chunk)
            elif kind == _BINARY_CHUNK and self._binary is None:
                self._binary = chunk
        if text is None:
            refuse("its first chunk", "must be JSON; the file may be truncated")
        return text

    def _buffer(self, index: int) -> memoryview:
        """Return the bytes of a buffer."""
        if index not in self._contents:
            buffer = self._buffers[index]
            size = buffer.integer("byteLength", least=1)
            if "uri" in buffer:
                uri = buffer.text("uri")
                try:
                    content = memoryview(self.resource(uri))
                except ValueError as error:
                    name = "its data URI" if uri.startswith("data:") else repr(uri[:200])
                    refuse(buffer.place, f"refers to {name}, which cannot be read: {error}")
            elif index == 0 and self._binary is not None:
                content = self._binary
            else:
                buffer.refuse("uri", "must be stated, because the file has no binary chunk for this buffer")
            if len(content) < size:
                rule = f"must have {size} bytes (byteLength), got {len(content)}; the data may be truncated"
                refuse(buffer.place, rule)
            self._contents[index] = content
        return self._contents[index]

    def _is_placeholder(self, view: Element) -> bool:
        """Whether the buffer of a compressed buffer view is only a placeholder without uncompressed data."""
        number = view.integer("buffer", most=len(self._buffers) - 1)
        buffer = self._buffers[number]
        return "uri" not in buffer and not (number == 0 and self._binary is not None)


def _chunks(data: bytes) -> Iterator[tuple[int, memoryview]]:
    """Yield the type and the content of each chunk of a .glb file."""
    if len(data) < 20:
        refuse("its header", f"must have 20 bytes, got {len(data)}; the file may be truncated")
    version, total = struct.unpack_from("<II", data, 4)
    if version != 2:
        refuse("its version", f"must be 2, got {version}; export it as glTF 2.0")
    if total > len(data):
        refuse("its header", f"states {total} bytes, but the file has {len(data)}; it may be truncated")
    at = 12
    while at + 8 <= total:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > total:
            refuse("a chunk", f"of {size} bytes ends beyond the {total} bytes of the file")
        yield kind, memoryview(data)[at + 8 : at + 8 + size]
        at += 8 + size


def _data_of(uri: str) -> bytes:
    """Return the content of a data URI."""
    head, comma, body = uri.partition(",")
    if not comma:
        raise UnreadableUriError("its data URI has no comma before the data")
    try:
        if head.endswith(";base64"):
            return base64.b64decode(urllib.parse.unquote(body))
        return urllib.parse.unquote_to_bytes(body)
    except ValueError as error:
        raise UnreadableUriError(f"its data URI is damaged: {error}") from None
