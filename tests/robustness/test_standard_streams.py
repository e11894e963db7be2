"""The command line with standard streams that are closed, full, closed by the reader, or limited to ASCII."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

if os.name != "posix":
    pytest.skip("these streams require POSIX", allow_module_level=True)

pytestmark = pytest.mark.permanent("closed, full or ASCII streams, no home folder, files that a mesh references")


def in_shell(command, folder, **environment):
    """Run a shell command, in which ``$W`` is the command line; return exit code, output and error output."""
    names = {key: value for key, value in os.environ.items() if key not in ("PYTHONUNBUFFERED", "PYTHONIOENCODING")}
    ran = subprocess.run(
        ["/bin/sh", "-c", command.replace("$W", '"$PYTHON" -m warpdiff')], cwd=folder,
        env=names | {"PYTHON": sys.executable, "WARPDIFF_CACHE_DIR": ""} | environment, capture_output=True,
        check=False,
    )  # fmt: skip
    assert b"Traceback" not in ran.stderr
    assert b"Exception ignored" not in ran.stderr
    return ran.returncode, ran.stdout.decode(), ran.stderr.decode(errors="surrogateescape")


@pytest.mark.parametrize(
    ("command", "code", "error"),
    [
        ("$W info --heightfield nothing.png 2>&-", 2, ""),
        ("$W info --heightfield nothing.png 2>/dev/full", 2, ""),
        ("$W info --heightfield nothing.png >&- 2>&-", 2, ""),
        ("$W cache >&-", 0, ""),
        # A pipeline's exit code is that of its last command, so the command prints its own exit code.
        ("(sleep 0.05; $W cache; echo $? >&2) | true", 0, "1\n"),
        ("($W --help; echo $? >&2) | true", 0, "1\n"),
        ("$W cache >/dev/full", 1, "warpdiff: standard output: No space left on device\n"),
        ("$W --version >/dev/full", 1, "warpdiff: standard output: No space left on device\n"),
    ],
)
def test_streams_that_cannot_be_written_to_cause_no_traceback(command, code, error, tmp_path):
    if "/dev/full" in command and not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    assert in_shell(command, tmp_path) == (code, "", error)


def test_no_file_gets_the_number_of_a_closed_stream(tmp_path):
    # If descriptor 2 stayed closed, the next opened file would get it, and error messages would be written into the
    # file.
    look = "import os; from warpdiff.apps.process import prepare_streams; prepare_streams(); "
    look += "print(os.open('a', os.O_CREAT | os.O_WRONLY))"
    assert in_shell(f'"$PYTHON" -c "{look}" 2>&- <&-', tmp_path)[1] == "3\n"


def test_output_in_ascii_has_question_marks(tmp_path):
    code, out, _ = in_shell("$W render --help", tmp_path, PYTHONIOENCODING="ascii")
    assert code == 0
    assert "Standard deviation ? of" in out
