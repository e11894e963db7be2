"""
Fit of a lamellar grating to measured orders
============================================

Depth, duty cycle, width of the walls and period of a grating from 30 efficiencies with noise of 1 %. The report lists
standard errors, correlations and the second duty cycle that explains the data equally well.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

true = wd.profiles.Trapezoid(depth_um=0.14, duty=0.42, wall=0.04, period_um=2.0)
lights = np.repeat(wd.direction([10.0, 40.0]), 15, axis=0)
wavelengths = np.tile(np.repeat([450.0, 550.0, 650.0], 5), 2)
orders = [(0, m) for m in (-2, -1, 0, 1, 2)] * 6
geometry = wd.Measured.orders(lights, wavelengths, orders, np.zeros(30), ior=math.inf)
exact = geometry.predict(true.surface(true.start)).value
sd = 0.01 * exact + 5e-4
values = exact + sd * np.random.default_rng(3).normal(size=30)
measured = wd.Measured.orders(lights, wavelengths, orders, values, ior=math.inf)

guess = wd.profiles.Trapezoid(depth_um=0.15, duty=0.4, wall=0.05, period_um=2.0)
result = wd.fit(guess, measured, sd=sd, starts=2)
print(result.report())

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), width_ratios=(1.6, 1), layout="constrained")
result.plot(ax=left)
left.set_title(f"χ² = {result.chi2:.0f} for {result.degrees_of_freedom} degrees of freedom")
picture = right.imshow(result.correlations, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
right.set_xticks(range(4), result.names, rotation=30)
right.set_yticks(range(4), result.names)
figure.colorbar(picture, ax=right, label="correlation")
figure.savefig("fit_of_a_grating.png", dpi=100)
plt.close(figure)
