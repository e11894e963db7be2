"""Encodings of texts: byte-order marks, UTF-16 without a mark, and bytes of other encodings."""

import pytest

import warpdiff as wd
from warpdiff.core.text_encodings import decoded
from warpdiff.heightfield.readers import text_table

TEXT = "Höhe;µm\n1,5;2,5\n"


@pytest.mark.parametrize(
    "code",
    ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "latin-1", "cp1252"],
)
def test_texts_are_decoded_without_their_mark(code):
    assert decoded(TEXT.encode(code)) == TEXT


def test_names_of_other_encodings_remain_different_and_their_files_remain_texts(tmp_path):
    """Shift-JIS texts have bytes that Windows-1252 does not define. They must become different characters."""
    first, second = (decoded(name.encode("shift-jis")) for name in ("マ", "ミ"))
    assert first != second
    path = tmp_path / "heights.txt"
    path.write_bytes("高さ マミ 1.0 2.0\n".encode("shift-jis"))
    assert text_table.is_text(path)


def test_measured_data_may_be_utf_32(tmp_path):
    path = tmp_path / "orders.csv"
    path.write_bytes(
        "light_theta_deg,light_phi_deg,wavelength_nm,m_y,m_x,efficiency\n0,0,550,0,1,0.1\n".encode("utf-32")
    )
    assert len(wd.Measured.from_csv(path).values) == 1
