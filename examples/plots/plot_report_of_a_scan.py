"""
Report of a scan
================

Write a page with everything about a surface, and compare its colours with a measured spectrum. Here the measurement is
computed, with noise.
"""

from pathlib import Path

import numpy as np

import warpdiff as wd

rng = np.random.default_rng(3)
x_um = 0.08 * np.arange(200)
heights_um = 0.05 * np.cos(2.0 * np.pi * x_um / 1.6) + 0.002 * rng.normal(size=(120, 200)) + 0.01 * x_um
scan = wd.HeightField(heights_um, pitch_um=0.08).levelled()
light, view = wd.direction(30.0), wd.direction(-9.0)
wavelengths_nm = np.arange(400.0, 701.0, 10.0)
model = wd.spectral_reflectance(scan, light, view, wavelengths_nm)
counts = 800.0 * model * rng.normal(1.0, 0.05, model.shape)
lines = [f"{nm},{count:.4g}" for nm, count in zip(wavelengths_nm, counts, strict=True)]
Path("spectrum.csv").write_text("\n".join(["wavelength_nm,counts", *lines]), encoding="utf-8")

report = wd.report(scan, "report", to_light=light, to_view=view, compare="spectrum.csv", sigmas_um=[5.0, 16.25])
print(report)
print(f"{report.numbers['fit']['scale']:.0f} counts per reflectance, expected 800")
wd.plot.height_map(scan, profile_along="x").figure.savefig("scan.png", dpi=100)
