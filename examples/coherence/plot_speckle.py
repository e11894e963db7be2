"""
Speckle of one window
=====================

A coherence window at a single position gives speckle. The average over all positions of the window is smooth.
"""

import warpdiff as wd

skin = wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
windows = {"averaged": wd.Coherence(sigma_um=5.0), "centred": wd.Coherence("centred", sigma_um=5.0)}
for name, window in windows.items():
    wd.reflectance_map(skin, (0, 0, 1), size=240, coherence=window).save(f"window_{name}.png")
