"""Error messages of file operations: they name the file, and the argument as in Python or on the command line."""

import copy

import pytest

from warpdiff.core import files
from warpdiff.core.wording import spelled


def test_errors_of_files_name_the_file_and_mark_the_argument(tmp_path):
    (tmp_path / "large.csv").write_text("1,2\n" * 10)
    calls = {
        "path: there is no file": lambda: files.read_text(tmp_path / "no.csv", 100),
        "path: large.csv must have at most 30 bytes": lambda: files.read_text(tmp_path / "large.csv", 30),
        "path: the folder": lambda: files.check_folder(tmp_path / "no", "path"),
    }
    for message, call in calls.items():
        with pytest.raises((OSError, ValueError)) as raised:
            call()
        for error in (raised.value, copy.copy(raised.value)):
            assert str(error).startswith(message)
            assert spelled(error, lambda name, _: f"--{name}").startswith(f"--{message}")


def test_text_of_other_encodings_is_read(tmp_path):
    (tmp_path / "latin.csv").write_bytes("µm,n\n".encode("latin-1"))
    assert files.read_text(tmp_path / "latin.csv", 100) == "\ufffdm,n\n"
