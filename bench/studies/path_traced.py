"""Baked lobes in Mitsuba 3: beside ``shade`` under a directional light, and path-traced in an environment.

``python -m bench.studies.path_traced`` says how far the two are apart (ΔE2000 of interior pixels) and draws a
compact disc that leans against a wall under a sky with two windows: its colours fall on floor and wall.

Needs ``pip install 'warpdiff[mitsuba]'``, and for the variants that compile an LLVM of 17 or newer, which
``DRJIT_LIBLLVM_PATH`` names.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import warpdiff as wd
from warpdiff.image import display_transform
from warpdiff.optics import colorimetry, reflectance_factors

SIGMA_UM = 5.0
WAVELENGTHS = np.arange(380.0, 781.0)
MEAN_SHOWN = 0.7


def main() -> None:
    """Compare, and draw."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--variant", default="llvm_ad_spectral", help="of Mitsuba (llvm_ad_spectral)")
    parser.add_argument("--output", default="path_traced.png", help="the picture")
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--samples", type=int, default=512, help="paths a pixel of the picture")
    parser.add_argument("--compared", type=int, default=2048, help="paths a pixel where it is compared; 0 does not")
    options = parser.parse_args()
    import mitsuba as mi

    mi.set_variant(options.variant)
    wd.register_mitsuba_bsdf()
    with tempfile.TemporaryDirectory() as folder:
        if options.compared:
            compare(mi, Path(folder), options.compared)
        if options.samples:
            draw(mi, Path(folder), options)


def compare(mi, folder: Path, samples: int) -> None:
    """ΔE2000 of a tube under a directional light, by ``shade`` and by Mitsuba."""
    window, normal = wd.Coherence(sigma_um=SIGMA_UM), 0.04
    skin = wd.gratings.fingers(size_um=25.6, pitch_um=0.08)
    file = wd.bake_spectrum(skin, coherence=window, size=1024).save(folder / "fingers.npz")
    body, to_light = wd.meshes.tube(), (0.3, 1.0, 0.8)
    view = wd.View((0.0, 1.5, 4.0), (0.0, 0.0, 0.0), fov_y_deg=14, width=64, height=48)
    exact = wd.shade(body, skin, wd.DirectionalLight(to_light), view, coherence=window, tolerance=1e-2, pigment=0.0)
    # Irradiance E with which Mitsuba's absolute radiance, ρ R(0) E / Ω, is that of the relative reflectance under D65.
    solid_angle = reflectance_factors.light_solid_angle(1e-3 * WAVELENGTHS, window, 1.0)
    light = _light_of(colorimetry.colour_products("D65"))
    film = {
        "type": "hdrfilm", "width": view.width, "height": view.height, "pixel_format": "xyz",
        "component_format": "float32", "rfilter": {"type": "gaussian", "stddev": 0.5},
    }  # fmt: skip
    scene = mi.load_dict(
        {
            "type": "scene", "integrator": {"type": "path", "max_depth": 2},
            "sensor": _sensor(mi, view, film, samples),
            "body": _mesh(mi, body, {"type": "warpdiff", "filename": str(file)}),
            "light": {
                "type": "directional", "direction": [-each for each in to_light],
                "irradiance": _spectrum(light * solid_angle / normal),
            },
        }
    )  # fmt: skip
    begin = time.perf_counter()
    found = np.array(mi.render(scene))[..., :3].astype(np.float64)
    seconds = time.perf_counter() - begin
    inside = (exact.coverage > 0.999) & exact.lit
    inside[1:-1, 1:-1] &= inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:]
    exposure = exact.auto_exposure
    shown = [display_transform.shown(exposure * each, "aces", "srgb") for each in (found, exact.xyz.astype(np.float64))]
    seen = (colorimetry.rgb_to_xyz(colorimetry.srgb_decode(each)) for each in shown)
    differences = colorimetry.colour_difference(*seen)[inside]
    ratio = found[..., 1][inside].sum() / exact.xyz[..., 1][inside].sum()
    print(
        f"Mitsuba {mi.variant()}, {samples} paths a pixel, {seconds:.0f} s: ΔE2000 to shade over {inside.sum()} "
        f"interior pixels, median {np.median(differences):.2f}, P95 {np.percentile(differences, 95):.2f}, "
        f"P99 {np.percentile(differences, 99):.2f}; sum of Y {ratio:.4f} of it"
    )


def draw(mi, folder: Path, options: argparse.Namespace) -> None:
    """A compact disc in an environment."""
    window = wd.Coherence(sigma_um=SIGMA_UM)
    disc = wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08)
    file = wd.bake_spectrum(disc, coherence=window, size=1024).save(folder / "disc.npz")
    width, height = options.width, options.width * 9 // 16
    view = wd.View((0.6, 1.4, 4.2), (0.0, 0.62, 0.0), fov_y_deg=32, width=width, height=height)
    film = {
        "type": "hdrfilm", "width": width, "height": height, "pixel_format": "xyz", "component_format": "float32",
        "rfilter": {"type": "gaussian", "stddev": 0.5},
    }  # fmt: skip
    # A dim sky with two bright windows, row 0 above.
    sky = np.full((64, 128, 3), 0.25, dtype=np.float32)
    sky[8:26, 22:36] = (16.0, 15.0, 13.0)
    sky[12:24, 92:100] = (9.0, 10.0, 12.0)
    to_world = mi.ScalarTransform4f
    lean = to_world().translate([0.0, 0.66, 0.0]).rotate([1, 0, 0], -15.0).rotate([0, 1, 0], 8.0)
    scene = mi.load_dict(
        {
            "type": "scene", "integrator": {"type": "path", "max_depth": 5},
            "sensor": _sensor(mi, view, film, options.samples),
            "disc": _mesh(
                mi, _leaned(wd.meshes.disc(), lean), {"type": "twosided", "bsdf": {
                    "type": "warpdiff", "filename": str(file), "ior": 20.0}}
            ),
            "floor": {
                "type": "rectangle", "to_world": to_world().rotate([1, 0, 0], -90.0).scale(6.0),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}},
            },
            "wall": {
                "type": "rectangle", "to_world": to_world().translate([0.0, 0.0, -0.45]).scale(6.0),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.6, 0.58]}},
            },
            "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky), "scale": 1.0},
        }
    )  # fmt: skip
    begin = time.perf_counter()
    found = np.zeros((height, width, 3))
    # Passes of a size that memory allows.
    passes = -(-options.samples // 64)
    for seed in range(passes):
        found += np.array(mi.render(scene, spp=min(64, options.samples), seed=seed))[..., :3] / passes
    seconds = time.perf_counter() - begin
    shown = display_transform.shown(MEAN_SHOWN / found[..., 1].mean() * found, "aces", "srgb")
    import PIL.Image

    PIL.Image.fromarray(np.rint(255.0 * shown).astype(np.uint8)).save(options.output)
    print(f"{options.output}: {width} × {height}, {options.samples} paths a pixel, {seconds:.0f} s")


def _leaned(body, transform):
    """A mesh that was moved."""
    body.apply_transform(np.array(transform.matrix, dtype=np.float64).reshape(4, 4))
    return body


def _sensor(mi, view: wd.View, film: dict, samples: int) -> dict:
    """Mitsuba's camera for a view."""
    return {
        "type": "perspective", "fov": view.fov_y_deg, "fov_axis": "y", "film": film,
        "to_world": mi.ScalarTransform4f().look_at(list(view.eye), list(view.target), list(view.up)),
        "sampler": {"type": "independent", "sample_count": samples},
    }  # fmt: skip


def _mesh(mi, body, bsdf: dict):
    """Mitsuba's mesh of one of ours, with its normals and texture coordinates."""
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    result = mi.Mesh(
        "body", len(body.vertices), len(body.faces), props, has_vertex_normals=True, has_vertex_texcoords=True
    )
    params = mi.traverse(result)
    params["vertex_positions"] = np.asarray(body.vertices, dtype=np.float32).ravel()
    params["vertex_normals"] = np.asarray(body.vertex_normals, dtype=np.float32).ravel()
    params["vertex_texcoords"] = np.asarray(body.visual.uv, dtype=np.float32).ravel()
    params["faces"] = np.asarray(body.faces, dtype=np.uint32).ravel()
    params.update()
    return result


def _light_of(products: np.ndarray) -> np.ndarray:
    """The illuminant, such that Mitsuba's XYZ of it is that of the products S·x̄ȳz̄ (over the 1 nm sum of S·ȳ)."""
    import mitsuba as mi

    observer = np.array([np.array(mi.cie1931_xyz(float(each))).ravel() for each in WAVELENGTHS])
    # XYZ = ∫ L x̄ȳz̄ dλ / ∫ ȳ dλ there.
    return products.sum(axis=1) / observer.sum(axis=1) / mi.MI_CIE_Y_NORMALIZATION


def _spectrum(values: np.ndarray) -> dict:
    """Values at every nanometre, 0 beyond."""
    wavelengths = [379.0, *WAVELENGTHS, 781.0]
    return {
        "type": "irregular", "wavelengths": ", ".join(f"{each:g}" for each in wavelengths),
        "values": ", ".join(f"{each:.9g}" for each in [0.0, *values, 0.0]),
    }  # fmt: skip


if __name__ == "__main__":
    main()
