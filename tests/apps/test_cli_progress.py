"""Progress of a command on standard error: bar on a terminal, lines of text elsewhere, nothing for short commands."""

import io
import sys
import threading
import time

import pytest

from warpdiff.apps import cli, cli_progress

# Longest time that a test waits for an event, in seconds. The value is a limit for busy test machines. If it were
# doubled, failures would only be reported later.
WAIT_S = 20.0


class Terminal(io.StringIO):
    """Text stream that claims to be a terminal of 80 columns."""

    def isatty(self):
        return True


@pytest.fixture
def redirect(monkeypatch):
    """Return a function that replaces ``sys.stderr`` by a new stream.

    The test calls it, because pytest itself replaces ``sys.stderr`` between the fixtures and the test.
    """
    monkeypatch.setattr(cli_progress, "_FIRST_S", 0.01)
    monkeypatch.setenv("COLUMNS", "80")

    def begin(kind):
        stream = kind()
        monkeypatch.setattr(sys, "stderr", stream)
        return stream

    return begin


def wait_for(text, stream):
    end = time.monotonic() + WAIT_S
    while text not in stream.getvalue():
        assert time.monotonic() < end, stream.getvalue()
        time.sleep(0.01)


def test_without_a_terminal_lines_name_the_command_and_the_share(redirect):
    error_stream = redirect(io.StringIO)
    with cli_progress.CommandProgress("render") as progress:
        wait_for("warpdiff render: 0 % after 0 s\n", error_stream)
        progress(0.25)
        wait_for("warpdiff render: 25 % after ", error_stream)
    assert "\r" not in error_stream.getvalue()


def test_a_terminal_shows_a_bar_that_is_removed_at_the_end(redirect):
    error_stream = redirect(Terminal)
    with cli_progress.CommandProgress("render") as progress:
        wait_for("0 %", error_stream)
        progress(0.25)
        wait_for("25 %", error_stream)
    assert error_stream.getvalue().rpartition("%")[2].endswith("\r")


def test_a_printed_line_begins_in_a_cleared_line(redirect):
    error_stream = redirect(Terminal)
    with cli_progress.CommandProgress("demo") as progress:
        wait_for("0 %", error_stream)
        progress.print("snake.png", error_stream)
    before = error_stream.getvalue().partition("snake.png\n")[0]
    assert before.endswith("\r")
    assert not before.rpartition("\r")[0].rpartition("\r")[2].strip()


@pytest.mark.parametrize("kind", [io.StringIO, Terminal])
def test_short_commands_show_nothing(kind, redirect, monkeypatch):
    error_stream = redirect(kind)
    monkeypatch.setattr(cli_progress, "_FIRST_S", 600.0)
    assert cli.main(["cache"]) == 0
    assert error_stream.getvalue() == ""


@pytest.mark.parametrize("kind", [io.StringIO, Terminal])
def test_a_closed_standard_error_ends_only_the_display(kind, redirect):
    error_stream = redirect(kind)
    error_stream.close()
    with cli_progress.CommandProgress("render") as progress:
        time.sleep(0.1)
        progress(0.5)
    assert "warpdiff-progress" not in {thread.name for thread in threading.enumerate()}
