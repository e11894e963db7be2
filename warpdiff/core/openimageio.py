"""Fork-safe use of OpenImageIO, and image files of named formats.

A fork of the process waits until the library's calls and threads have ended. A reader opens only files of the formats
that it names, so that no other decoder of the library reads files from untrusted sources.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from typing import TYPE_CHECKING, Any

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path
    from types import ModuleType

# Longest time that a fork waits for OpenImageIO calls of other threads [s]. After this time, the process forks anyway,
# and the child process cannot use the library. If doubled, such forks are delayed by another second.
_MOST_WAIT_S = 1.0


class _Library:
    """Access to OpenImageIO.

    An object counts the active contexts of :meth:`in_use`, and stores the numbers of threads that OpenImageIO uses
    outside of these contexts.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._users, self._forking = 0, False
        self._cut_off = False
        self._threads = self._exr_threads = 0
        forks.at_fork(before=self._before, after_in_parent=self._in_parent, after_in_child=self._in_child)

    @contextlib.contextmanager
    def in_use(self) -> Iterator[Any]:
        """Provide the library in a context, within which EXR files are read and written on the calling thread.

        A child process would wait forever for OpenEXR's threads, which exist only in the parent. The child process
        would also wait for locks that another thread had acquired, such as the locks of OpenColorIO. A fork therefore
        waits up to a second for the end of all contexts of this method.

        Raises:
            RuntimeError: This process was forked while another thread used the library.
        """
        import OpenImageIO as oiio  # noqa: N813 (the name that its manual uses)

        with self._changed:
            self._changed.wait_for(lambda: not self._forking)
            if self._cut_off:
                raise RuntimeError(
                    f"this process was forked while a thread read, showed or wrote pictures: {forks.REMEDY}"
                )
            self._users += 1
            if self._users == 1:
                self._exr_threads = oiio.get_int_attribute("exr_threads")
                oiio.attribute("exr_threads", -1)
        try:
            yield oiio
        finally:
            with self._changed:
                self._users -= 1
                if not self._users:
                    oiio.attribute("exr_threads", self._exr_threads)
                    self._changed.notify_all()

    def _before(self) -> None:
        self._changed.acquire()
        self._forking = True
        self._changed.wait_for(lambda: not self._users, timeout=_MOST_WAIT_S)
        oiio: Any = sys.modules.get("OpenImageIO")
        # Another thread may be importing OpenImageIO at this moment. The module then exists, but its functions may
        # still be missing.
        self._threads = oiio.get_int_attribute("threads") if hasattr(oiio, "get_int_attribute") else 0
        self._set_threads(1)

    def _in_parent(self) -> None:
        self._set_threads(self._threads)
        self._forking = False
        self._changed.notify_all()
        self._changed.release()

    def _in_child(self) -> None:
        self._changed = threading.Condition()
        self._forking = False
        self._cut_off = self._cut_off or self._users > 0
        if not self._cut_off:
            self._set_threads(self._threads)

    def _set_threads(self, count: int) -> None:
        if self._threads:
            sys.modules["OpenImageIO"].attribute("threads", count)


in_use = _Library().in_use


def opened(oiio: ModuleType, file: Path, formats: Sequence[str], configuration: object = None) -> Any | None:
    """Open an image file of one of the named formats; None if OpenImageIO cannot open it or it has another format.

    If the result is None, the library may have an error message, which the caller must read.

    Args:
        oiio: OpenImageIO, as :meth:`in_use` provides it.
        file: Path of the file.
        formats: Names of the accepted formats in OpenImageIO, such as ``"openexr"``.
        configuration: ``ImageSpec`` with options for the decoder, or None.
    """
    by_suffix = _format_of_suffix(oiio, file.suffix.lower().removeprefix("."))
    if by_suffix is not None and by_suffix not in formats:
        return None
    by_content = next((name for name in formats if _is_of_format(oiio, file, name)), None)
    # For a damaged file, only the decoder of its suffix is tried. Otherwise OpenImageIO would try all decoders.
    is_foreign = by_content is not None and by_content != by_suffix
    if by_suffix is None and not is_foreign:
        return None
    tries_all = oiio.get_int_attribute("try_all_readers")
    oiio.attribute("try_all_readers", int(is_foreign))
    try:
        arguments = (str(file),) if configuration is None else (str(file), configuration)
        image = oiio.ImageInput.open(*arguments)
    finally:
        oiio.attribute("try_all_readers", tries_all)
    if image is not None and image.format_name() not in formats:
        image.close()
        return None
    return image


def error_text(source: Any) -> str:
    """Return the last message of OpenImageIO, or of one of its objects, as one line, and clear it.

    OpenImageIO prints unread messages when the process ends. A message may quote bytes of the file that are not text. A
    fixed text is returned for such a message.
    """
    try:
        return " ".join(source.geterror().split())
    except UnicodeDecodeError:
        return "its header is damaged"


def _format_of_suffix(oiio: ModuleType, suffix: str) -> str | None:
    """Return OpenImageIO's name of the format of a suffix without its dot; None if the library has no such suffix."""
    for entry in oiio.get_string_attribute("extension_list").split(";"):
        name, _, suffixes = entry.partition(":")
        if suffix in suffixes.split(","):
            return str(name)
    return None


def _is_of_format(oiio: ModuleType, file: Path, name: str) -> bool:
    """Whether the decoder of a format recognises the content of a file."""
    decoder = oiio.ImageInput.create(name)
    return decoder is not None and bool(decoder.valid_file(str(file)))
