"""Text encodings of files: UTF-8, UTF-16 and UTF-32 with a byte-order mark, UTF-16 without a mark, and Windows-1252."""

from __future__ import annotations

import codecs

# Number of bytes at the start of a file in which NUL bytes are counted, to recognise UTF-16 without a byte-order mark.
# Texts in scripts other than Latin have few NUL bytes in UTF-16. Names and comments in such scripts are shorter than
# this number of bytes, so that the digits and Latin keywords around them are counted, too.
_SAMPLE_BYTES = 4096
# Smallest fraction of NUL bytes in UTF-16. Each Latin letter, digit and space has one NUL byte among its two bytes, so
# that usual texts have a fraction of nearly one half.
_LEAST_NUL_SHARE = 0.25
# Byte-order marks with their encodings. The mark of UTF-32 begins with that of UTF-16, and is therefore compared first.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip


def decoded(data: bytes) -> str:
    """Return the text of a file, without a byte-order mark.

    The encoding is that of the byte-order mark. Without a mark, UTF-16 is recognised by its NUL bytes. Bytes that are
    neither UTF-16 nor UTF-8 are read as Windows-1252, or as Latin-1. For a text in any other encoding, letters in names
    are wrong, but different names remain different, and numbers are right.
    """
    for mark, name in _MARKS:
        if data.startswith(mark):
            return data.decode(name, errors="replace")
    sample = data[:_SAMPLE_BYTES]
    if sample.count(0) > _LEAST_NUL_SHARE * len(sample):
        # In UTF-16, one byte of a Latin letter is NUL. It is the second byte if the lower byte comes first.
        code = "utf-16-le" if sample[1::2].count(0) >= sample[::2].count(0) else "utf-16-be"
        return data.decode(code, errors="replace")
    for name in ("utf-8", "cp1252"):
        try:
            return data.decode(name)
        except UnicodeDecodeError:
            continue
    return data.decode("latin-1")
