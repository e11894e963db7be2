"""Progress: the caller's function, a bar that appears only for long work, or nothing."""

import pytest

from warpdiff.core import progress


def test_a_function_is_called_itself_and_none_is_none():
    shares = []
    assert progress.reporter(shares.append, "shade()") == shares.append
    assert progress.reporter(None, "shade()") is None
    assert progress.reporter(False, "shade()") is None
    with pytest.raises(TypeError, match="progress must be True, a callable or None, got str"):
        progress.reporter("bar", "shade()")


@pytest.mark.parametrize("delay", [0.0, 60.0])
def test_a_bar_appears_for_long_work_alone(delay, monkeypatch, capsys):
    monkeypatch.setattr(progress, "_DELAY_S", delay)
    report = progress.reporter(True, "shade()")
    for share in (0.25, 0.5, 1.0):
        report(share)
    written = capsys.readouterr().err
    assert ("shade()" in written) == (delay == 0.0)
