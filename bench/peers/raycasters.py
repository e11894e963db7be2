"""Camera rays of a picture by Mitsuba 3, Embree and warpdiff: rays per second, hits and normals.

All programs trace the same rays to the same mesh, in the coordinates of warpdiff's prepared mesh, which has a radius of
1. The programs compute only hits (face and barycentric coordinates), except for warpdiff's rasterization ("face by
face"), which fills the whole G-buffer (hits, normals, tangents and colours). Mitsuba's LLVM variant also uses Embree,
with packets of rays. The package embreex passes single rays to Embree. embreex releases the interpreter's lock, so that
several threads can trace parts of the rays. The reference tests every ray against every triangle in float64.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp

from bench.truth import brute_force
from warpdiff.device.devices import resolve_device
from warpdiff.device.kernel_calls import launch
from warpdiff.kernels import bvh, compile_options
from warpdiff.scene import device_mesh
from warpdiff.scene.camera_rays import rays_for
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    import warpdiff as wd
    from warpdiff.scene.mesh_import import Surface

wp.set_module_options(compile_options.options())

# Least cosine between ray and normal at hits whose normals are compared. The value is limited by warpdiff, which
# rotates normals with cosines below 0.01 towards the viewer.
LEAST_COSINE = 0.02


class Rays(NamedTuple):
    """Rays of a picture, with the mesh and the camera.

    Origins and directions of the rays have the shape (n, 3). The origins are near the mesh.
    """

    surface: Surface
    view: wd.View
    origins: NDArray[np.float32]
    directions: NDArray[np.float32]


class Hits(NamedTuple):
    """Mask (n,) of rays that hit the mesh, and interpolated unit normals (n, 3), which may point to either side."""

    hit: NDArray[np.bool_]
    normal: NDArray[np.float64]


class Caster(NamedTuple):
    """A program that traces rays.

    ``trace(threads)`` traces all rays, and ``hits()`` returns the hits of the last call of ``trace``.
    """

    trace: Callable[[int], None]
    hits: Callable[[], Hits]


def missing() -> list[str]:
    """Return the reasons why programs are excluded from the comparison, one sentence per program."""
    reasons = []
    try:
        import embreex  # noqa: F401
    except ImportError:
        reasons.append("Embree is not installed: pip install embreex")
    try:
        import drjit
        import mitsuba  # noqa: F401
    except ImportError:
        return [*reasons, "Mitsuba is not installed: pip install mitsuba"]
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        reasons.append("Mitsuba finds no LLVM: install it, or set DRJIT_LIBLLVM_PATH to libLLVM.so")
    return reasons


def rays_of(mesh: Any, view: wd.View) -> Rays:
    """Return one ray through the centre of each pixel, with its origin moved close to the mesh in float64."""
    surface = prepare_surface(mesh)
    eye = np.asarray(view.eye, dtype=np.float64)
    size = {"width": view.width, "height": view.height, "fov_y_deg": view.fov_y_deg}
    origins, directions = brute_force.pixel_rays(eye, view.target, view.up, **size)
    origins = (origins - surface.centre) / surface.radius
    ahead = -np.einsum("ij,ij->i", origins, directions)
    origins = origins + np.maximum(ahead - 2.0, 0.0)[:, None] * directions
    return Rays(surface, view, np.float32(origins), np.float32(directions))


def casters(rays: Rays) -> dict[str, Caster]:
    """Return the available programs that trace rays, by name."""
    result = {"warpdiff, bare hits": _warp_query(rays), "warpdiff, face by face": _faces(rays)}
    absent = " ".join(missing())
    if "Mitsuba" not in absent:
        result["Mitsuba 3, bare hits"] = _mitsuba(rays)
    if "Embree is" not in absent:
        result["Embree, bare hits"] = _embree(rays)
    return result


def truth(rays: Rays, chosen: NDArray[np.int64]) -> tuple[Hits, NDArray[np.bool_]]:
    """Return the reference hits of the rays with the given indices, and a mask of rays whose hits are reliable.

    The hit of a ray is reliable if the ray neither passes near an edge nor grazes a face.
    """
    surface = rays.surface
    origins, directions = (np.float64(vectors[chosen]) for vectors in (rays.origins, rays.directions))
    vertices = surface.vertices.astype(np.float64)
    _, face, bary, margin = brute_force.intersect(origins, directions, vertices, surface.faces)
    normal = _interpolated(surface, face, bary)
    grazing = np.abs(np.einsum("ij,ij->i", normal, directions)) < LEAST_COSINE
    hit = face >= 0
    return Hits(hit, normal), (margin > 1e-5) & ~(hit & grazing)


def _interpolated(surface: Surface, face: Any, bary: Any) -> NDArray[np.float64]:
    """Return interpolated unit normals of hits in float64, from the hits' faces (n,) and barycentric coordinates.

    The face of a miss is −1, and the normal of a miss is arbitrary.
    """
    normal = np.einsum("kc,kcd->kd", np.float64(bary), surface.normals[surface.faces[face]].astype(np.float64))
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)


@wp.kernel
def query(
    # Mesh and rays, which this kernel reads. Thread 0 traces the ray with the index ``first``.
    mesh_id: wp.uint64, origins: wp.array(dtype=wp.vec3f), directions: wp.array(dtype=wp.vec3f), first: wp.int32,
    # Index of the face that each ray hits, and barycentric coordinates of the hit, which this kernel writes.
    face_out: wp.array(dtype=wp.int32), bary_out: wp.array(dtype=wp.vec2f),
):  # fmt: skip
    """Find the face that each ray hits, −1 for a miss, and the first two barycentric coordinates of the hit."""
    i = first + wp.tid()
    hit = wp.mesh_query_ray(mesh_id, origins[i], directions[i], bvh.FAR)
    face_out[i] = -1
    if hit.result:
        face_out[i] = hit.face
        bary_out[i] = wp.vec2f(hit.u, hit.v)


def _warp_query(rays: Rays) -> Caster:
    device = resolve_device(None)
    arrays = device_mesh.arrays_for(rays.surface, smooth=True, device=device).with_hierarchy()
    count = len(rays.origins)
    rays_in = [wp.array(vectors, dtype=wp.vec3f, device=device) for vectors in (rays.origins, rays.directions)]
    hits_out = [wp.empty(count, dtype=wp.int32, device=device), wp.zeros(count, dtype=wp.vec2f, device=device)]

    def trace(threads: int) -> None:
        launch(query, count, [arrays.mesh_id, *rays_in], hits_out, device=device, threads=threads)

    def hits() -> Hits:
        face, (b0, b1) = hits_out[0].numpy(), hits_out[1].numpy().T
        return Hits(face >= 0, _interpolated(rays.surface, face, np.stack([b0, b1, 1.0 - b0 - b1], axis=1)))

    return Caster(trace, hits)


def _faces(rays: Rays) -> Caster:
    camera_rays = rays_for(rays.surface, rays.view, device=resolve_device(None), threads=1)
    pixels = camera_rays.gbuffer.pixels

    def trace(threads: int) -> None:
        camera_rays.options["threads"] = threads
        camera_rays.launch(camera_rays.trace(0, 1))

    def hits() -> Hits:
        hit = pixels.hit.numpy() == 1
        # At pixels without a hit, the normals in the G-buffer are arbitrary. They are replaced by 0.
        return Hits(hit, np.where(hit[:, None], pixels.normal.numpy(), 0.0).astype(np.float64))

    return Caster(trace, hits)


def _mitsuba(rays: Rays) -> Caster:
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    surface = rays.surface
    mesh = mi.Mesh("surface", len(surface.vertices), len(surface.faces), has_vertex_normals=True)
    arrays = mi.traverse(mesh)
    arrays["vertex_positions"] = surface.vertices.ravel()
    arrays["vertex_normals"] = surface.normals.ravel()
    arrays["faces"] = surface.faces.ravel()
    arrays.update()
    world = mi.load_dict({"type": "scene", "surface": mesh})
    ray = mi.Ray3f(mi.Point3f(rays.origins.T), mi.Vector3f(rays.directions.T))
    dr.eval(ray)
    last: list[Any] = [None]

    def trace(threads: int) -> None:
        if dr.thread_count() != threads:
            dr.set_thread_count(threads)
        last[0] = world.ray_intersect_preliminary(ray)
        dr.eval(last[0])
        dr.sync_thread()

    def hits() -> Hits:
        hit = last[0].is_valid().numpy()
        # Mitsuba's two barycentric coordinates belong to the second and third corner. The coordinate of the first
        # corner is 1 minus their sum.
        b1, b2 = last[0].prim_uv.numpy()
        face = np.where(hit, last[0].prim_index.numpy(), 0)
        return Hits(hit, _interpolated(surface, face, np.stack([1.0 - b1 - b2, b1, b2], axis=1)))

    return Caster(trace, hits)


def _embree(rays: Rays) -> Caster:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    surface, world = rays.surface, EmbreeScene()
    TriangleMesh(world, surface.vertices, surface.faces)
    last: list[dict[str, Any]] = []

    def run(part: NDArray[np.int64]) -> dict[str, Any]:
        rows = slice(part[0], part[-1] + 1)
        return world.run(rays.origins[rows], rays.directions[rows], query="INTERSECT", output=1)

    def trace(threads: int) -> None:
        parts = np.array_split(np.arange(len(rays.origins)), threads)
        with ThreadPoolExecutor(max_workers=threads) as pool:
            last[:] = pool.map(run, parts)

    def hits() -> Hits:
        face, b1, b2 = (np.concatenate([part[name] for part in last]) for name in ("primID", "u", "v"))
        return Hits(face >= 0, _interpolated(surface, face, np.stack([1.0 - b1 - b2, b1, b2], axis=1)))

    return Caster(trace, hits)
