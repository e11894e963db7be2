"""Progress reports: the caller's function, a progress bar for long work only, or none."""

import pytest

from warpdiff.core import progress


def test_a_function_is_used_unchanged_and_none_means_no_report():
    shares = []
    assert progress.reporter(shares.append, "shade()") == shares.append
    assert progress.reporter(None, "shade()") is None
    assert progress.reporter(False, "shade()") is None
    with pytest.raises(TypeError, match="progress must be True, a callable or None, got str"):
        progress.reporter("bar", "shade()")


@pytest.mark.parametrize("delay", [0.0, 60.0])
def test_a_bar_appears_only_for_long_work(delay, monkeypatch, capsys):
    monkeypatch.setattr(progress, "_DELAY_S", delay)
    report = progress.reporter(True, "shade()")
    for share in (0.25, 0.5, 1.0):
        report(share)
    written = capsys.readouterr().err
    assert ("shade()" in written) == (delay == 0.0)
