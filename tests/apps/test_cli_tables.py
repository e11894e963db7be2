"""Commands that print tables of optical results: exact numbers, complete CSV files, and errors that name the flags."""

import math

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.apps import cli


def run(line, *more):
    """Run a command line, given as one text and further arguments, and return its exit code."""
    return cli.main([*line.split(), *map(str, more)])


def test_orders_prints_the_strongest_and_writes_all(tmp_path, capsys):
    target = tmp_path / "orders.csv"
    line = "orders sinusoidal:period_um=2.5,depth_um=0.1 --incidence-deg 20 --wavelengths-nm 450 650 --count 1"
    assert run(line, "--ior", "inf", "--energy", "stam", "--csv", target) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) == 5
    assert str(target) in out
    assert "The orders are reliable at" in out
    rows = np.genfromtxt(target, delimiter=",", names=True)
    sine = rows["m_x"] * rows["wavelength_nm"] * 1e-3 / 2.5 - math.sin(math.radians(20.0))
    signed = rows["view_theta_deg"] * np.cos(np.radians(rows["view_phi_deg"]))
    np.testing.assert_allclose(signed, np.degrees(np.arcsin(sine)), atol=1e-9)
    assert np.count_nonzero(rows["wavelength_nm"] == 450.0) == 11


def test_angles_are_those_of_the_grating_equation(capsys):
    assert run("angles blazed:period_um=2,depth_um=0.2 --wavelengths-nm 500 --most-order 1 --incidence-deg -10") == 0
    lines = capsys.readouterr().out.splitlines()
    angles = [float(line.split()[3]) * (-1.0 if float(line.split()[4]) == 180.0 else 1.0) for line in lines[1:]]
    expected = [math.degrees(math.asin(0.25 * m + math.sin(math.radians(10.0)))) for m in (-1, 0, 1)]
    assert angles == pytest.approx(expected, rel=1e-4)


def test_spectrum_is_the_spectral_reflectance(tmp_path, capsys):
    target = tmp_path / "spectrum.csv"
    line = "spectrum sinusoidal:period_um=2,depth_um=0.2 --view-deg 15 --incidence-deg 5 --azimuth-deg 180"
    assert run(line, "--from-nm", 250, "--to-nm", 300, "--step-nm", 12.5, "--material", "Al", "--csv", target) == 0
    assert str(target) in capsys.readouterr().out
    rows = np.genfromtxt(target, delimiter=",", names=True)
    assert rows["wavelength_nm"].tolist() == [250.0, 262.5, 275.0, 287.5, 300.0]
    expected = wd.spectral_reflectance(
        wd.gratings.sinusoidal(2.0, 0.2), wd.direction(5.0, 180.0), wd.direction(15.0), rows["wavelength_nm"],
        material=wd.Material.metal("Al"),
    )  # fmt: skip
    np.testing.assert_array_equal(rows["relative_reflectance"].astype(np.float32), expected)


@pytest.mark.parametrize(
    ("line", "message"),
    [("orders blazed --count 0", "--count must be an integer, at least 1, got 0"),
     ("orders blazed --wavelengths-nm 0.55", "--wavelengths-nm must lie within 100 to 10000 nm"),
     ("orders blazed --csv orders.txt", "--csv must end in .csv, got 'orders.txt'"),
     ("orders blazed --csv absent/orders.csv", "--csv: the folder 'absent' does not exist"),
     ("angles blazed --incidence-deg 90", "--incidence-deg must be more than -90 and less than 90, got 90"),
     ("angles blazed --azimuth-deg 400", "--azimuth-deg must be -360 to 360 degrees"),
     ("angles blazed --most-order 0", "--most-order must be an integer, at least 1, got 0"),
     ("spectrum blazed --view-deg -95", "--view-deg must be more than -90"),
     ("spectrum blazed --view-azimuth-deg 400", "--view-azimuth-deg must be -360 to 360 degrees"),
     ("spectrum blazed --step-nm 0", "--step-nm must be more than 0, got 0"),
     ("spectrum blazed --from-nm 500 --to-nm 400", "--to-nm must be at least --from-nm"),
     ("spectrum blazed --from-nm 50", "--from-nm must lie within 100 to 10000 nm")],
)  # fmt: skip
def test_bad_input_is_refused_by_its_flag(line, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(line) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
