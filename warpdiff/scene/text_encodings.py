"""Text encodings of mesh files: UTF-8, UTF-16 with and without a byte-order mark, and Windows-1252."""

from __future__ import annotations

import codecs

# Number of bytes in which NUL bytes are counted, to recognise UTF-16 without a byte-order mark. Names and comments in
# other scripts, which have few NUL bytes in UTF-16, are shorter than this number.
_SAMPLE_BYTES = 4096
# Smallest fraction of NUL bytes in UTF-16. Each Latin letter, digit and space has one NUL byte among its two bytes, so
# that usual texts have a fraction of nearly one half.
_LEAST_NUL_SHARE = 0.25


def decoded(data: bytes) -> str:
    """Return the text of a file, without a byte-order mark.

    UTF-16 is recognised by its byte-order mark or its NUL bytes. Bytes that are neither UTF-16 nor UTF-8 are read as
    Windows-1252, or as Latin-1. For a text in any other encoding, letters in names are wrong, but numbers are right.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")
    sample = data[:_SAMPLE_BYTES]
    if sample.count(0) > _LEAST_NUL_SHARE * len(sample):
        # In UTF-16, one byte of a Latin letter is NUL. It is the second byte if the lower byte comes first.
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
