"""
Depth and duty cycle of a lamellar grating
==========================================

Efficiency of the first order at 550 nm as a function of depth and duty cycle. It is largest for a duty cycle
of one half and a depth of a quarter of the wavelength.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

depths_um, duties = np.linspace(0.02, 0.4, 15), np.linspace(0.1, 0.9, 13)
first_order = np.zeros((len(duties), len(depths_um)))
for j, duty in enumerate(duties):
    for i, depth_um in enumerate(depths_um):
        grating = wd.gratings.lamellar(2.0, depth_um, duty=duty)
        first_order[j, i] = wd.order_efficiencies(grating, (0, 0, 1), [550.0], ior=np.inf)[0, 1][0]
plt.imshow(first_order, origin="lower", aspect="auto", extent=(0.02, 0.4, 0.1, 0.9))
plt.xlabel("depth [µm]")
plt.ylabel("duty cycle")
plt.colorbar(label="efficiency of order 1 at 550 nm")
plt.savefig("depth_and_duty_cycle.png", dpi=100)
plt.close()
