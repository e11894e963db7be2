"""Text encodings of mesh files: UTF-8, UTF-16 with and without a mark, and the Western encoding of Windows."""

from __future__ import annotations

import codecs

# Number of bytes in which NUL bytes are counted, to recognise UTF-16 without a byte-order mark. Choice: names and
# comments in other scripts, which have few NUL bytes, are shorter.
_SAMPLE_BYTES = 4096
# Smallest share of NUL bytes in UTF-16. Derived: each Latin letter, digit and space has one in its two bytes.
_LEAST_NUL_SHARE = 0.25


def decoded(data: bytes) -> str:
    """Return the text of a file, without a byte-order mark.

    UTF-16 is recognised by its mark or its NUL bytes. Other bytes that are not UTF-8 are read as the Western encoding
    of Windows (cp1252), or as Latin-1. In other encodings, names have wrong letters, while numbers are right.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")
    sample = data[:_SAMPLE_BYTES]
    if sample.count(0) > _LEAST_NUL_SHARE * len(sample):
        # The NUL byte of a Latin letter is the second one if the lower byte comes first.
        code = "utf-16-le" if sample[1::2].count(0) > sample[::2].count(0) else "utf-16-be"
        return data.decode(code, errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        pass
    try:
        return data.decode("cp1252")
    except UnicodeDecodeError:
        return data.decode("latin-1")
