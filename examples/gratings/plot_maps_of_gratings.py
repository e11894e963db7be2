"""
Maps of common gratings
=======================

Colours of a sine grating, a rectangular grating, a blazed grating and bumps in all view directions.
"""

import warpdiff as wd

gratings = {
    "sine": wd.gratings.sinusoidal(2.0, 0.3), "lamellar": wd.gratings.lamellar(2.0, 0.15),
    "blazed": wd.gratings.blazed(2.5, 0.25), "bumps": wd.gratings.bumps(),
}  # fmt: skip
for name, grating in gratings.items():
    image = wd.reflectance_map(grating, (0.0, 0.0, 1.0), size=220, coherence=wd.Coherence(sigma_um=4.0))
    image.save(f"map_{name}.png", exposure_stops=-3.0)
