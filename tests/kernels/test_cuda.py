"""CUDA: every kernel compiles for the Hopper architecture (sm_90) without a GPU. GPU and CPU give the same results."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere, relative_errors, slow

import warpdiff as wd
from warpdiff import kernels
from warpdiff.kernels import (
    base_colours,
    bvh,
    coefficient_sum,
    colour_lookup,
    dot_transforms,
    light_samples,
    pixel_contrast,
    plain_textures,
    primary_hits,
    shadow_rays,
    spectrum_sampling,
    subdivision,
    tile_lists,
    transparency,
)

SM = 90
# Compute capabilities for which kernels are compiled. For the Ampere architecture (80), the test is marked as slow, and
# compiles only the kernels that every picture launches.
SMS = (80, 90)
ARCHITECTURES = [slow(80), SM]
# Modules of the package ``kernels`` without a kernel. Their functions are compiled with the kernels that call them.
FUNCTIONS_ONLY = {
    "atomics",
    "compile_options",
    "footprints",
    "indices",
    "sample_frames",
    "sample_sequence",
    "shading_frames",
    "structs",
}
# Modules of the package ``kernels`` that contain only constants, for code that does not import Warp.
WITHOUT_WARP = {"refinement_levels", "thresholds", "quadratic_spline"}
KERNELS = {
    "base_colours": {"sample_base_colours"},
    "bvh": {"trace_bvh"},
    "primary_hits": {"rasterize", "intersect_known_faces", "place_samples", "make_shading_frames"},
    "shadow_rays": {"count", "fill", "trace_shadow_rays", "project"},
    "transparency": {"pass_transparent", "trace_shadow_rays_through"},
    "light_samples": {"balance_energy", "pixel_footprints", "scattering_vectors", "select_finish",
                      "add_light_rotation", "add_light_extent", "add_source_extent"},
    "plain_reflection": {"add_plain_reflection", "add_emission"},
    "plain_textures": {"sample_plain_textures"},
    "plain_samples": {"sample_plain_sky", "draw_plain_disc", "choose_plain_lights"},
    "disc_samples": {"draw_disc"},
    "dot_transforms": {
        "find_dots", "mark_edges_of_dots", "scale_gains", "signals_of_dots", "transform_samples", "weigh_gains",
    },
    "light_choice": {"choose_lights"},
    "sky_samples": {"mirror_deflections", "sample_sky"},
    "pixel_contrast": {"estimate_errors"},
    "subdivision": {"accumulate", "select_levels", "raise_levels", "resolve_pixels", "splat_cells"},
    "coefficient_sum": {"integrate", "sample"},
    "tile_lists": {"count_marks", "luminance_floor", "advance_batch", "running_max", "compact_level", "dilate_marks",
                   "mark_shared", "copy_batch", "luminance_histogram"},
    "colour_lookup": {"blur", "integrate", "interpolate"},
    "lobe_sums": {"sum_lobes", "differentiate_lobes", "evaluate_polynomials", "spread_pairs"},
    "polar_sums": {"sample_spectrum_rings", "spread_pixels_to_rings", "spread_spectrum_rings", "sum_rings_of_pixels"},
    "spectrum_sampling": {"add_product", "gather", "project", "project_lines", "resample"},
}  # fmt: skip
# Kernels whose compilation is tested. They sum Fourier coefficients from a table. Each entry has the number of terms of
# the series of a coefficient, the coherence model, and whether the table has powers |H|² (True) or amplitudes H
# (False).
FORMS = [
    (8, "averaged", True), slow(24, "averaged", False), slow(24, "centred", False), slow(8, "source", True),
    slow(24, "source", False), slow(24, "replicas", False),
]  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def compiler():
    """Skip the tests if this build of Warp has no CUDA compiler; Warp's packages for Linux and Windows contain it."""
    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    missing = set(SMS) - set(wp.get_cuda_supported_archs())
    if missing:
        pytest.skip(f"this build of Warp has no CUDA compiler for sm_{missing.pop()}")


@pytest.fixture
def cuda() -> str:
    """Return the name of the first CUDA device; skip the test if none exists."""
    if not wp.is_cuda_available():
        pytest.skip("no CUDA device on this machine")
    return "cuda"


def compile_to_ptx(module, folder: Path, arch: int = SM) -> str:
    """Return the PTX of the kernels of a Python module or of a Warp module."""
    paths = wp.compile_aot_module(module, device=None, arch=arch, module_dir=folder, use_ptx=True)
    assert [path.suffix for path in paths] == [".ptx"]
    ptx = Path(paths[0]).read_text()
    assert f".target sm_{arch}" in ptx
    return ptx


def entry_points(ptx: str) -> set[str]:
    """Return the names of the kernels in PTX, without hashes and without the name of the enclosing function."""
    entries = re.findall(r"\.visible \.entry (\w+)_[0-9a-f]+_cuda_kernel_forward", ptx)
    assert "_cuda_kernel_backward" not in ptx, "kernels must have enable_backward=False"
    return {name.rpartition("locals__")[2] for name in entries}


def test_every_kernel_module_is_listed_in_this_file():
    folder = Path(kernels.__file__).parent
    names = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    assert names == set(KERNELS) | FUNCTIONS_ONLY | WITHOUT_WARP, "list new kernel modules in this file"
    for name in names:
        declared = re.findall(r"@wp\.kernel.*\n\s*def (\w+)", (folder / f"{name}.py").read_text())
        assert set(declared) == KERNELS.get(name, set()), f"kernels/{name}.py: list new kernels in this file"


@pytest.mark.parametrize("arch", ARCHITECTURES)
@pytest.mark.parametrize(
    "module",
    [
        bvh, primary_hits, light_samples, pixel_contrast, plain_textures, subdivision, shadow_rays, tile_lists,
        base_colours, transparency, dot_transforms,
    ],
    ids=lambda item: item.__name__,
)  # fmt: skip
def test_modules_compile(module, arch, tmp_path):
    assert entry_points(compile_to_ptx(module, tmp_path, arch)) == KERNELS[module.__name__.rpartition(".")[2]]


@pytest.mark.parametrize(("lanes", "form", "powers"), FORMS)
@pytest.mark.parametrize("name", sorted(KERNELS["coefficient_sum"]))
def test_spectral_kernels_compile_and_stay_in_registers(name, lanes, form, powers, tmp_path):
    ptx = compile_to_ptx(getattr(coefficient_sum.kernels(lanes, form, powers), name).module, tmp_path)
    assert entry_points(ptx) == {name}
    # An array indexed by a variable would need local memory, which slows a kernel. PTX declares it as a ``depot``. Only
    # kernels for replicated patches have such an array: 28 bytes in CUDA's sine for large arguments, which these
    # kernels never compute.
    depots = re.findall(r"__local_depot\d+\[(\d+)\]", ptx)
    assert depots == (["28"] if form == "replicas" else [])


@pytest.mark.parametrize("arch", ARCHITECTURES)
@pytest.mark.parametrize(
    ("name", "source"),
    # The kernels ``blur`` and ``interpolate`` are the same for coherence windows and for light sources.
    [("integrate", False), *(slow(name, False) for name in ("blur", "interpolate")),
     *((name, True) for name in sorted(KERNELS["colour_lookup"]))],
)  # fmt: skip
def test_kernels_of_table_look_ups_compile_and_stay_in_registers(name, source, arch, tmp_path):
    ptx = compile_to_ptx(getattr(colour_lookup.lookup(8, source), name).module, tmp_path, arch)
    assert entry_points(ptx) == {name}
    assert "__local_depot" not in ptx


@pytest.mark.parametrize(("lanes", "powers", "nodes"), [(8, True, 8), slow(8, False, 16)])
def test_kernels_that_fill_a_table_compile(lanes, powers, nodes, tmp_path):
    resample = spectrum_sampling.resampler(lanes, powers, nodes).resample
    assert entry_points(compile_to_ptx(resample.module, tmp_path)) == {"resample"}
    assert entry_points(compile_to_ptx(spectrum_sampling.gatherer(nodes).gather.module, tmp_path)) == {"gather"}
    for name in ("project", "project_lines"):
        ptx = compile_to_ptx(getattr(spectrum_sampling.projector(nodes, 8), name).module, tmp_path)
        assert entry_points(ptx) == {name}
        assert "__local_depot" not in ptx


@pytest.mark.parametrize(
    "coherence",
    [wd.Coherence("averaged", 3.25), wd.Coherence("centred", 3.25), wd.Coherence("source", angular_diameter_deg=2.0),
     wd.Coherence("replicas", periods=(2, 5))],
    ids=lambda item: item.kind,
)  # fmt: skip
def test_reflectance_equals_that_of_the_cpu(coherence, cuda, rng):
    heightfield = wd.gratings.fingers(size_um=6.4, seed=1)
    lights, views = hemisphere(rng, 200), hemisphere(rng, 200)
    plan = wd.plan(heightfield, coherence=coherence)
    expected = wd.reflectance(heightfield, lights, views, plan=plan, device="cpu")
    result = wd.reflectance(heightfield, lights, views, plan=plan, device=cuda)
    assert np.max(relative_errors(result, expected)) < 1e-3


def test_shade_equals_that_of_the_cpu(cuda):
    mesh = wd.meshes.tube(segments_along=64, segments_around=32)
    heightfield = wd.gratings.fingers(size_um=6.4, seed=1)
    coherence = wd.Coherence(sigma_um=3.25)
    light = wd.DirectionalLight((0.3, 0.5, 1.0))
    view = wd.View((0.0, 0.0, 8.0), (0.0, 0.0, 0.0), width=64, height=48)
    expected = wd.shade(mesh, heightfield, light, view, coherence=coherence)
    result = wd.shade(mesh, heightfield, light, view, device=cuda, plan=expected.plan)
    # Some pixels may differ between GPU and CPU, because rounding decides whether a ray through the edge of a face hits
    # the face.
    assert np.mean(result.mask != expected.mask) < 0.01
    both = result.mask & expected.mask
    assert np.percentile(relative_errors(result.xyz[both], expected.xyz[both]), 99.0) < 1e-2


def test_pictures_of_a_recorded_graph_equal_those_of_shade(cuda):
    mesh = wd.meshes.tube(segments_along=64, segments_around=32)
    heightfield = wd.gratings.fingers(size_um=12.8, seed=4)
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=96, height=72)
    light = wd.DirectionalLight((0.1, 0.9, 1.2))
    renderer = wd.Renderer(
        mesh, heightfield, light, view, coherence=wd.Coherence(sigma_um=3.25), tolerance=3e-2, device=cuda
    )
    assert renderer.plan.footprint
    for angle in (0.3, -0.2):
        light = wd.DirectionalLight((0.1 + angle, 0.9, 1.2))
        view = dataclasses.replace(view, eye=(3.1 * np.sin(angle), 1.6, 3.1 * np.cos(angle)))
        assert renderer.draw(light, view).device.is_cuda
        result = renderer.image()
        expected = wd.shade(mesh, heightfield, light, view, plan=renderer.plan, device=cuda)
        np.testing.assert_array_equal(result.xyz, expected.xyz)
        np.testing.assert_array_equal(result.illuminated, expected.illuminated)
