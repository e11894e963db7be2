"""
Read an .x3p file and a text export
===================================

Write one scan in two formats of instruments, load both, and compare them. Sizes and units come from the files.
"""

import zipfile

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

surface = wd.gratings.fingers(size_um=12.8, pitch_um=0.1)
picture_nm = 1e3 * surface.heights_um[::-1]  # instruments store the top row first
ny, nx = picture_nm.shape
header = f"# Channel: Height\n# Width: {0.1 * nx:g} µm\n# Height: {0.1 * ny:g} µm\n# Value units: nm"
np.savetxt("scan.txt", picture_nm, fmt="%.3f", delimiter="\t", header=header, comments="", encoding="utf-8")
axis = "<{0}><AxisType>I</AxisType><DataType>D</DataType><Increment>1e-7</Increment></{0}>"
xml = (
    f"<ISO5436_2><Record1><FeatureType>SUR</FeatureType><Axes>{axis.format('CX')}{axis.format('CY')}"
    "<CZ><AxisType>A</AxisType><DataType>D</DataType></CZ></Axes></Record1><Record3><MatrixDimension>"
    f"<SizeX>{nx}</SizeX><SizeY>{ny}</SizeY><SizeZ>1</SizeZ></MatrixDimension><DataLink><PointDataLink>data.bin"
    "</PointDataLink></DataLink></Record3></ISO5436_2>"
)
with zipfile.ZipFile("scan.x3p", "w", zipfile.ZIP_DEFLATED) as archive:
    archive.writestr("main.xml", xml)
    archive.writestr("data.bin", (1e-9 * picture_nm).tobytes())
figure, axes = plt.subplots(1, 2, figsize=(7, 3.2), layout="constrained")
for plot, name in zip(axes, ("scan.x3p", "scan.txt"), strict=True):
    scan = wd.HeightField.load(name)
    plot.imshow(scan.heights_um, origin="lower", extent=(0, scan.size_um[1], 0, scan.size_um[0]))
    plot.set(title=name, xlabel="x [µm]", ylabel="y [µm]")
plt.savefig("read_instrument_files.png", dpi=100)
plt.close()
