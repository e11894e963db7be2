"""Footprints of pixels in (u, v), to first order: ray differentials (Igehy 1999) on the face that a ray hits.

The view direction, the hit point and the shading frame are differentiated in closed form with respect to the position
in the picture. The derivatives of (u, v) follow from these derivatives. Neighbouring pixels are not used, so that edges
do not affect footprints.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import warp as wp

from warpdiff.kernels.shading_frames import LEAST_COSINE
from warpdiff.kernels.structs import Camera, Footprint, Pixels, SurfaceArrays

# Least cosine of the angle between the view direction and a face's normal; smaller cosines are replaced by it. The
# value is limited by faces that are nearly edge-on, on which footprints (changes of (u, v) in a pixel) would become
# infinite.
LEAST_FACING = 1e-4


@wp.func_native(
    "warpdiff::find_footprints<16>(camera, surface, pixels, scattering_vectors, deviation, begin, end, "
    f"{{{float(LEAST_COSINE)}f, {LEAST_FACING}f}}, footprints_out);"
)
def pixel_footprints_run(
    camera: Camera, surface: SurfaceArrays, pixels: Pixels, scattering_vectors: wp.array(dtype=wp.vec3d),
    deviation: wp.float32, begin: wp.int32, end: wp.int32, footprints_out: wp.array(dtype=Footprint),
):  # fmt: skip
    """Compute the footprints in (u, v) of the rays with indices from ``begin`` to ``end``."""
