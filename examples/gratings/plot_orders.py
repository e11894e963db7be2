"""
Efficiencies of orders
======================

Fraction of the incident power in each order of a blazed gold grating, as a function of the wavelength.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

grating, gold = wd.gratings.blazed(2.5, 0.25), wd.Material.metal("Au")
wavelengths_nm = np.linspace(400.0, 750.0, 71)
orders = wd.order_efficiencies(grating, (0.2, 0, 1), wavelengths_nm, material=gold)
axes = wd.plot.orders(orders)
axes.figure.savefig("orders.png", dpi=100)
plt.close(axes.figure)
