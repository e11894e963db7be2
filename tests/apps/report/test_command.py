"""Command ``report``: its flags become the arguments of `warpdiff.report`, and its messages name the flags."""

from types import SimpleNamespace

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.apps import cli


@pytest.fixture
def called(monkeypatch):
    """Arguments of the calls of ``wd.report`` instead of reports."""
    calls = []
    signature = wd.report

    def report(heightfield, folder, **settings):
        calls.append({"heightfield": heightfield, "folder": folder, **settings})
        return SimpleNamespace(page="report.html")

    report.__signature__, report.__doc__ = signature.__signature__, signature.__doc__
    report.__annotations__ = signature.__annotations__
    monkeypatch.setattr(wd, "report", report)
    return calls


def test_flags_become_arguments(called, capsys):
    line = "report sinusoidal:period_um=2,depth_um=0.1 --compare goniometer.csv --incidence-deg 20 --azimuth-deg 90"
    line += " --view-deg -10 --sigmas-um 5 --wavelengths-nm 633 --tolerance 0.1 --material Au -o folder"
    assert cli.main(line.split()) == 0
    (call,) = called
    assert call["folder"] == "folder"
    assert call["compare"] == "goniometer.csv"
    np.testing.assert_allclose(call["to_light"], wd.direction(20.0, 90.0))
    np.testing.assert_allclose(call["to_view"], wd.direction(-10.0, 90.0))
    assert (call["sigmas_um"], call["wavelengths_nm"], call["tolerance"]) == ([5.0], [633.0], 0.1)
    assert call["material"].name == "gold"
    assert call["title"] == "sinusoidal:period_um=2,depth_um=0.1"
    assert capsys.readouterr().out.endswith("report.html\n")


def test_an_angle_without_an_azimuth_is_in_the_plane_of_the_strongest_wave(called, tmp_path):
    heights = 0.05 * np.cos(2.0 * np.pi * 0.1 * np.arange(160) / 1.6)[:, None] + np.zeros(40)
    path = wd.HeightField(heights, 0.1).save(tmp_path / "scan.npz")
    assert cli.main(["report", str(path), "--incidence-deg", "20", "--view-deg=-5"]) == 0
    assert cli.main(["report", str(path)]) == 0
    first, second = called
    np.testing.assert_allclose(first["to_light"], wd.direction(20.0, 90.0), atol=1e-9)
    np.testing.assert_allclose(first["to_view"], wd.direction(-5.0, 90.0), atol=1e-9)
    assert second["to_light"] is None
    assert second["title"] is None


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--compare absent.csv", "--compare: there is no file 'absent.csv'"),
        ("--incidence-deg 95", "--incidence-deg must be more than -90 and less than 90, got 95"),
        ("--sigmas-um 0", "--sigmas-um must be 1 to 6 numbers"),
        ("--wavelengths-nm 50", "--wavelengths-nm"),
    ],
)
def test_messages_name_the_flag(flags, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["report", "blazed", *flags.split()]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "report").exists()
