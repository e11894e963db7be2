"""
Compare with the direct sum
===========================

Luminance by the default method and by the direct sum in float64, which uses no series, as functions of the
view angle.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

surface, window = wd.gratings.fingers(size_um=6.4, pitch_um=0.1), wd.Coherence(sigma_um=2.0)
angles = np.radians(np.linspace(-60.0, 60.0, 41))
to_view = np.column_stack([np.sin(angles), 0.0 * angles, np.cos(angles)])
fast = wd.reflectance(surface, (0, 0, 1), to_view, coherence=window)
exact = wd.reflectance(surface, (0, 0, 1), to_view, coherence=window, method="direct", tolerance=1e-3)
plt.semilogy(np.degrees(angles), exact[:, 1], label="direct sum")
plt.semilogy(np.degrees(angles), fast[:, 1], "--", label="default method")
plt.xlabel("view angle [°]")
plt.ylabel("luminance Y")
plt.legend()
plt.savefig("direct_sum.png", dpi=100)
plt.close()
