"""
Orders of a beam splitter
=========================

A relief of eight levels that reflects a laser beam into 5 × 5 equal orders: one period, and the efficiencies.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

orders = [(y, x) for y in range(-2, 3) for x in range(-2, 3)]
target = wd.Target.equal(orders, (0, 0, 1), 632.8, ior=math.inf)
pixels = wd.profiles.Pixels(0.3, np.zeros((20, 20)), samples=2)
result = wd.design(pixels, target, levels=8, starts=1)
print(result.uniformity_errors, result.shares)

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
figure.get_layout_engine().set(wspace=0.12)
wd.plot.height_map(result.heightfield, ax=left)
left.set_title("one period, eight levels")
every = wd.order_efficiencies(result.heightfield, (0, 0, 1), 632.8, ior=math.inf)
span = range(-5, 6)
powers = [[100.0 * every[y, x][0] for x in span] for y in span]
picture = right.imshow(powers, extent=(-5.5, 5.5, -5.5, 5.5), origin="lower", cmap="magma")
right.set(xlabel="order along x", ylabel="order along y", title=f"{result.shares[0]:.0%} of the light in 25 orders")
figure.colorbar(picture, ax=right, label="efficiency [%]")
figure.savefig("beam_splitter.png", dpi=100)
plt.close(figure)
