"""
Web page
========

Write one HTML file that any browser with WebGL 2 can show, also without a network connection.
"""

from pathlib import Path

import warpdiff as wd

body, skin = wd.meshes.tube(), wd.gratings.fingers(size_um=12.8, pitch_um=0.1)
lobes = wd.bake(skin, delta_e=8.0)
light, view = wd.DirectionalLight((0.3, 1.0, 0.6)), wd.View.fit(body, turning=True, width=320, height=180)
path = wd.export_html("page.html", body, lobes, light, view)
print(f"{Path(path).stat().st_size / 1e6:.1f} MB")
wd.shade(body, skin, light, view, tolerance=0.1).save("web_page.png", background=(0.02, 0.02, 0.02))
