"""
Coherence lengths
=================

Colours for three coherence lengths. A short coherence length gives wide and pale spectra. A long coherence
length gives narrow spectra with pure colours.
"""

import warpdiff as wd

skin = wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
for sigma_um in (1.0, 4.0, 16.25):
    image = wd.reflectance_map(skin, (0, 0, 1), size=240, coherence=wd.Coherence(sigma_um=sigma_um))
    image.save(f"sigma_{sigma_um:g}.png")
