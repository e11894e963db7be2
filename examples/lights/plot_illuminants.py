"""
Spectra of lights
=================

The same grating under daylight, incandescent light, and fluorescent light, whose spectrum has narrow lines.
"""

import warpdiff as wd

grating = wd.gratings.blazed(2.5, 0.25)
window = wd.Coherence(sigma_um=6.0)
for illuminant in ("D65", "A", "FL11"):
    image = wd.reflectance_map(grating, (0, 0, 1), size=220, illuminant=illuminant, coherence=window)
    image.save(f"illuminant_{illuminant}.png", exposure_stops=-3.0)
