"""
Orders against the angle of the light
=====================================

One call evaluates many directions of the light. The efficiencies of a blazed gold grating are plotted against the angle
of incidence. A CSV file contains them together with the directions of the orders.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

grating, gold = wd.gratings.blazed(2.5, 0.25), wd.Material.metal("Au")
to_light = wd.direction(np.linspace(-60.0, 60.0, 121))
orders = wd.order_efficiencies(grating, to_light, 650.0, material=gold)
print(orders.table(count=1))
orders.save("orders.csv")

axes = wd.plot.orders(orders, count=5)
axes.figure.savefig("orders_against_incidence.png", dpi=100)
plt.close(axes.figure)
