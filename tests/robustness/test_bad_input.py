"""Invalid arguments: each one raises the expected error before a kernel runs and before a file changes."""

import dataclasses
import inspect
import math

import numpy as np
import pytest
import trimesh
import warp as wp

import warpdiff as wd
from warpdiff.core import memory

UP = [0.0, 0.0, 1.0]
HF = wd.HeightField(np.zeros((8, 8)), 0.05)
LIGHT = wd.DirectionalLight((0.0, 0.0, 1.0))
VIEW = wd.View((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), width=4, height=3)
MESH = wd.meshes.disc(segments=8, rings=1)
# The plan (method, number of wavelengths and so on) is for a single direction. It is therefore made without a search
# for these numbers, and quickly; every process of the tests imports this file.
PLAN = wd.plan(HF, UP, UP)
CENTRED_PLAN = wd.plan(HF, UP, UP, coherence=wd.Coherence("centred"))
IMAGE = wd.Image(
    xyz=np.ones((3, 4, 3), np.float32), mask=np.ones((3, 4), bool), illuminated=np.ones((3, 4), bool),
    coverage=np.ones((3, 4), np.float32), error=np.zeros((3, 4), np.float32), plan=PLAN,
)  # fmt: skip
TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def bare(vertices=TRIANGLE, faces=((0, 1, 2),)) -> trimesh.Trimesh:
    """Return a mesh without texture coordinates."""
    return trimesh.Trimesh(vertices, faces, process=False)


EVALUATE = {
    "reflectance": lambda heightfield=HF, **options: wd.reflectance(heightfield, UP, UP, **options),
    "spectral_reflectance": lambda heightfield=HF, **o: wd.spectral_reflectance(heightfield, UP, UP, [500.0], **o),
    "reflectance_spectra": lambda heightfield=HF, **o: wd.reflectance_spectra(heightfield, UP, UP, [500.0], **o),
    "brdf": lambda heightfield=HF, **options: wd.brdf(heightfield, UP, UP, [500.0], **options),
    "reflectance_map": lambda heightfield=HF, **options: wd.reflectance_map(heightfield, UP, **({"size": 4} | options)),
    "plan": lambda heightfield=HF, **options: wd.plan(heightfield, UP, UP, **options),
    "report": lambda heightfield=HF, **options: wd.report(heightfield, "not_written", **options),
    "shade": lambda heightfield=HF, **options: wd.shade(MESH, heightfield, LIGHT, VIEW, **options),
}

# Invalid values of arguments that several functions share: argument, value, class and message of the error. Each value
# is tested with every function that has the argument. test_refusals.py has further invalid values.
SHARED = [
    ("heightfield", np.zeros((8, 8)), TypeError, r"heightfield must be a warpdiff\.HeightField, got ndarray"),
    ("heightfield", "scan.png", TypeError, r"heightfield must be a warpdiff\.HeightField, got str"),
    ("heightfield", None, TypeError, r"heightfield must be a warpdiff\.HeightField, got NoneType"),
    ("ior", -math.inf, ValueError, "ior must be a number, more than 1, got -inf"),
    ("material", "gold", TypeError, r"material must be a warpdiff\.Material, got str"),
    ("material", 1.5, TypeError, r"material must be a warpdiff\.Material, got float"),
    ("device", "gpu", ValueError, "device must be 'cpu', or 'cuda' on a machine with a CUDA device, got 'gpu'"),
    ("device", "cuda:99", ValueError, "device must be 'cpu', or 'cuda' on a machine with a CUDA device, got 'cuda:99'"),
    ("progress", "bar", TypeError, "progress must be True, a callable or None, got str"),
    ("illuminant", "D66", ValueError, "illuminant must be one of .*D65.* got 'D66'"),
    ("illuminant", 6500, TypeError, "illuminant must be the name of a CIE illuminant, such as 'D65', or a .* got int"),
    ("illuminant", "ISO 7589 Photographic Daylight", ValueError, "illuminant must cover 380 to 780 nm"),
    ("tangents", np.ones((3, 3)), ValueError, r"tangents must have shape \(\d+, 3\).* got \(3, 3\)"),
    ("tangents", "radial", ValueError, "tangents must be one of 'x', 'y', 'z', 'around-x'.*, got 'radial'"),
    ("tangents", b"x", TypeError, "tangents must be an array of real numbers, or one of 'x', .*, got bytes b'x'"),
    (
        "tangents",
        np.zeros_like(MESH.vertices),
        ValueError,
        "got none at any vertex: give another direction",
    ),
    ("tangents", np.full_like(MESH.vertices, math.nan), ValueError, "tangents must be finite"),
]

# Calls with invalid values of arguments that the list ``SHARED`` does not contain, and the expected messages. Each call
# gets the path of an empty folder.
VALUE_ERRORS = [
    # Calls with invalid height fields, and the errors that they raise
    (lambda _: wd.HeightField([[math.nan]], 0.1), "heights_um must have at least one height, got 1 NaN"),
    (lambda _: wd.HeightField([[-math.inf]], 0.1), "heights_um must be finite, got 1 infinite"),
    (lambda _: wd.HeightField([0.0, 1.0], 0.1), r"heights_um must be a 2-D array, got shape \(2,\)"),
    (lambda _: wd.HeightField(np.zeros((2, 3, 4)), 0.1), r"heights_um must be a 2-D array.*\(2, 3, 4\)"),
    (lambda _: wd.HeightField(np.zeros((0, 3)), 0.1), "heights_um must have at least one sample"),
    (lambda _: wd.HeightField([[0.0]], 0.0), "pitch_um must be a finite number, more than 0, got 0.0"),
    (lambda _: wd.HeightField([[0.0]], (0.1, 0.0)), r"pitch_um\[1\] must be a finite number, more than 0"),
    (lambda d: wd.HeightField.load(text(d / "a.png"), extent_um=1), "path: .* cannot be read as an image"),
    (lambda d: wd.HeightField.load(text(d / "a.npy"), extent_um=1), "path: .* cannot be read as .npy"),
    # Calls with invalid coherence models, lights and views, and the errors that they raise
    (lambda _: wd.Coherence("replicas", periods=3), r"periods must be a pair \(y, x\) of integers, got 3"),
    (lambda _: wd.Coherence("replicas", periods=(1, 2, 3)), r"periods must be a pair .* got \(1, 2, 3\)"),
    (lambda _: wd.Coherence("replicas", periods="12"), r"periods must be a pair .* got '12'"),
    (lambda _: wd.Coherence("replicas", periods=()), r"periods must be a pair .* got \(\)"),
    (lambda _: wd.Coherence("replicas", periods=(0, 3)), r"periods\[0\] must be .* 1 and at most 100000, got 0"),
    (lambda _: wd.Coherence("replicas", periods=(1, 10**6)), r"periods\[1\] must be .* at most 100000, got 1000000"),
    (lambda _: wd.Coherence("centred", centre_um=3.0), r"centre_um must be a pair \(y, x\), got"),
    (lambda _: wd.Coherence("centred", centre_um=(0, math.nan)), "centre_um must be finite"),
    # Calls with invalid directions and wavelengths, and the errors that they raise
    (lambda _: wd.reflectance(HF, [0, 0, 0], UP), "to_light must not contain zero vectors, got 1"),
    (lambda _: wd.reflectance(HF, UP, [UP, [0, 0, 0]]), "to_view must not contain zero vectors, got 1"),
    (lambda _: wd.reflectance(HF, [math.nan, 0, 1], UP), "to_light must be finite, got 1 NaN"),
    (lambda _: wd.reflectance(HF, UP, [0, 0, math.inf]), "to_view must be finite, got 1 NaN or infinite"),
    (lambda _: wd.reflectance(HF, [0, 1], UP), r"to_light must have shape \(3,\) or \(n, 3\), got \(2,\)"),
    (lambda _: wd.reflectance(HF, UP, [[UP]]), r"to_view must have shape \(3,\) or \(n, 3\), got \(1, 1, 3"),
    (lambda _: wd.reflectance(HF, [UP] * 2, [UP] * 3), "to_light and to_view must hold .* got 2 and 3"),
    (lambda _: wd.spectral_reflectance(HF, [UP] * 2, [UP] * 3, 500), "the same number of directions"),
    (lambda _: wd.plan(HF, [UP] * 2, [UP] * 3), "to_light and to_view must hold the same number"),
    (lambda _: wd.plan(HF, [0, 0, 0]), "to_light must not contain zero vectors"),
    (lambda _: wd.plan(HF, None, [0, 0, 0]), "to_view must not contain zero vectors"),
    (lambda _: wd.brdf(HF, UP, UP, []), r"wavelengths_nm must have shape \(m,\), got \(0,\)"),
    (lambda _: wd.brdf(HF, UP, UP, [[500.0]]), r"wavelengths_nm must have shape \(m,\), got \(1, 1\)"),
    (lambda _: wd.brdf(HF, UP, UP, [math.nan]), "wavelengths_nm must be finite"),
    (lambda _: wd.brdf(HF, UP, UP, -500.0), "wavelengths_nm must lie within 100 to 10000 nm"),
    (lambda _: wd.spectral_reflectance(HF, UP, UP, 0.5), "wavelengths_nm .* give wavelengths in nanometres"),
    (lambda _: wd.reflectance_map(HF, [0, 0, -1]), r"to_light must lie above the horizon \(z > 0\)"),
    (lambda _: wd.reflectance_map(HF, [UP, UP]), r"to_light must have shape \(3,\) for a map, got \(2, 3\)"),
    # Calls with invalid meshes and lights of a picture, and the errors that they raise
    (lambda d: shade(text(d / "a.txt")), "mesh must be a file of the formats .gltf"),
    (lambda d: shade(text(d / "a.obj")), "mesh must "),
    (lambda _: shade(trimesh.Trimesh()), "mesh must have vertices, got none"),
    (lambda _: shade(trimesh.Scene()), "mesh must have triangles, got a scene or file without any"),
    (lambda _: shade(bare(faces=np.zeros((0, 3), int))), "mesh must have faces, got 3 vertices and no"),
    (lambda _: shade(bare(TRIANGLE * math.nan)), "mesh must have finite vertices, got 3"),
    (lambda _: shade(bare(faces=[[0, 1, 3]])), "mesh must have face indices within 0 to 2"),
    (lambda _: shade(bare()), "mesh has neither texture coordinates nor tangents; give tangents"),
    (lambda _: shade(bare(TRIANGLE * [1, 0, 0]), tangents=np.ones((3, 3))), "mesh must have a face with an area, got"),
    (lambda _: shade(light=wd.DirectionalLight(UP, illuminant="D66")), r"lights\[0\].illuminant must be .* got 'D66'"),
    # Calls with invalid plans (methods and their numbers of wavelengths), and the errors that they raise
    (lambda _: dataclasses.replace(CENTRED_PLAN, method="power", rings_per_octave=0),
     "method='power' cannot be used with kind='centred', whose coefficients add as amplitudes, not as powers:"),
    (lambda _: wd.reflectance(HF, UP, UP, plan=PLAN, coherence=wd.Coherence("centred")),
     "coherence differs from the coherence of plan"),
    (lambda _: shade(plan=PLAN, coherence=wd.Coherence("centred")), "coherence differs from the coherence of plan"),
    (lambda _: wd.reflectance(HF, UP, UP, plan=changed(wavelengths=0)), "plan has no wavelengths"),
    (lambda _: shade(plan=changed(wavelengths=0)), "plan has no wavelengths"),
    (lambda _: wd.reflectance(wd.HeightField(np.zeros((9, 9)), 10.0), UP, UP, coherence=wd.Coherence(sigma_um=0.1)),
     "sigma_um=0.1 is too short for a patch of 90 × 90 µm"),
    # Calls with values outside of the supported magnitudes, and the errors that they raise
    (lambda _: wd.HeightField([[1e16, 0.0]], 0.1), r"heights_um must lie within ±1e\+15, got 1e\+16"),
    (lambda _: wd.HeightField([[0.0]], 1e16), r"pitch_um must be .*, more than 0 and at most 1e\+15, got 1e\+16"),
    (lambda _: wd.HeightField([[0.0]], 1e-16), "pitch_um must be at least 1e-15, got 1e-16"),
    (lambda _: HF.cropped(0.2, offset_um=np.ma.masked), r"offset_um must be a pair \(y, x\) or None"),
    (lambda _: wd.View((1e16, 0, 0), UP), r"eye must lie within ±1e\+15, got 1e\+16"),
    (lambda _: wd.Coherence("centred", centre_um=(0, -1e16)), r"centre_um must lie within ±1e\+15"),
    (lambda _: wd.gratings.sinusoidal(10**400, 0.1), "period_um must be a finite number, more than 0, got 1000"),
    (lambda _: wd.gratings.blazed(1e-14, 0.1), "period_um must be a finite number, at least 6.4e-14, got 1e-14"),
    (lambda _: wd.gratings.disc(tracks=2**63), "tracks must be an integer, at least 1 and at most 9223372036854775807"),
    (lambda _: wd.meshes.snake(length=1e4), "length must be 16 to 1000 radii"),
    (lambda _: shade(bare(TRIANGLE * 1e-300), tangents=np.ones((3, 3))), r"mesh must have a radius of 1e-15 to 1e\+15"),
    (lambda _: wd.HeightField.load("a\0b", pitch_um=0.1), r"path must be a name that .* got 'a\\x00b'"),
    (lambda _: wd.HeightField.load("\ud800", pitch_um=0.1), "path must be a name that a file can have"),
    (lambda _: wd.HeightField.load("x" * 5000, pitch_um=0.1), "path must be a name that a file can have"),
    (lambda _: shade("a\0b"), r"mesh must be a name that a file can have, got 'a\\x00b'"),
    (lambda _: IMAGE.save("x" * 5000 + ".png"), "path must be a name that a file can have"),
]  # fmt: skip
TYPE_ERRORS = [
    (lambda _: wd.HeightField([[0.0], [0.0, 1.0]], 0.1), "heights_um must be an array of real numbers"),
    (lambda _: wd.HeightField([[1j]], 0.1), "heights_um must be an array of real numbers"),
    (lambda _: wd.HeightField([["high"]], 0.1), "heights_um must be an array of real numbers"),
    (lambda _: wd.HeightField([[0.0]], np.ma.masked), "pitch_um must be a number, got MaskedConstant"),
    (lambda _: wd.Coherence("replicas", periods=(1.5, 2)), r"periods\[0\] must be an integer, got float"),
    (lambda _: wd.Coherence("replicas", periods=(True, 2)), r"periods\[0\] must be an integer, got bool"),
    (lambda _: wd.Coherence("replicas", periods=(1, 1.5)), r"periods\[1\] must be an integer, got float"),
    (lambda _: wd.reflectance(HF, "up", UP), "to_light must be an array of real numbers, got str"),
    (lambda _: wd.reflectance(HF, None, UP), "to_light must be an array of real numbers, got NoneType"),
    (lambda _: wd.reflectance(HF, [UP, [0, 1]], UP), "to_light must be an array of real numbers, got list"),
    (lambda _: wd.spectral_reflectance(HF, UP, UP, "blue"), "wavelengths_nm must be an array of real"),
    (lambda _: shade(None), "mesh must be a trimesh.Trimesh, a trimesh.Scene or a path, got NoneType"),
    (lambda _: shade(TRIANGLE), "mesh must be a trimesh.Trimesh, .* got ndarray"),
    (
        lambda _: shade(light=[]),
        r"lights must be a light, such as a DirectionalLight, or a non-empty sequence .* got \[\]",
    ),
    (
        lambda _: shade(light=None),
        "lights must be a light, such as a DirectionalLight, or a non-empty sequence .* got None",
    ),
    (lambda _: shade(light=(0, 0, 1)), r"lights\[0\] must be a .*, got int"),
    (lambda _: shade(light=[LIGHT, UP]), r"lights\[1\] must be a .*, got list"),
    (lambda _: shade(layers=np.array(3.0)), "layers must be a tuple or list of"),
    (lambda _: wd.HeightField.load(None, pitch_um=0.1), "path must be a string or a path, got NoneType"),
]
MEMORY_ERRORS = [
    (lambda _: HF.resampled(1e-14), "a field of 8 × 40000000000000 samples .* a pitch_um along y that is"),
    (lambda _: wd.gratings.blazed(1e15, 0.1), "a field of 1 × 25.* take .* of period_um, or of samples"),
    (lambda _: wd.gratings.disc(tracks=2**40), "a field of 640 × .* take .* of tracks, of length_um"),
    (lambda _: wd.gratings.bumps(pitch_um=1e-12), "a field of .* take .* of spacing_um, or a larger pitch"),
    (lambda _: wd.gratings.fingers(size_um=1e10), "a field of .* take .* of size_um, or a larger pitch_um"),
    (lambda _: wd.meshes.tube(segments_along=2**40), "a mesh of .* faces .* take .* of segments_along"),
    (lambda _: wd.meshes.disc(segments=2**40), "a mesh of .* faces .* take .* of segments, or of rings"),
    (lambda _: wd.meshes.snake(segments=2**20), "a snake of 27 × 130 scales .* or .* of segments"),
    (lambda _: wd.order_efficiencies(wd.HeightField.of_known_scale([[0.0, 0.1]], 1e15), UP, [500.0]), "of 1 × 2"),
]
MISSING_FILES = [
    (lambda d: wd.HeightField.load(d / "no.png", extent_um=1), "path: there is no file .*no.png"),
    (lambda d: shade(d / "no.obj"), "the mesh file .*no.obj' does not exist"),
]
CALLS = {ValueError: VALUE_ERRORS, TypeError: TYPE_ERRORS, MemoryError: MEMORY_ERRORS, FileNotFoundError: MISSING_FILES}
# Invalid values of the fields of a plan (method, number of wavelengths and so on), with the expected message.
PLANS = [
    ("terms", 129, "terms must be 1 to 128, got 129"),
    ("least_weight", 2, "least_weight must be less than 1, got 2: no"),
    ("bandwidth_um", 3.0, r"bandwidth_um must be three numbers .* got 3"),
    ("bandwidth_um", (1.0, 2.0), "bandwidth_um must be three numbers >= 0"),
    ("bandwidth_um", (1, -2, 3), "bandwidth_um must be three numbers >= 0"),
    ("bandwidth_um", (1, 2, 0), "bandwidth_um must be .* the last > 0"),
    ("lambda_max_nm", math.inf, "lambda_max_nm must be a finite number"),
    ("method", "auto", "method must be one of 'low-rank', 'power', 'taylor', 'taylor-uncentred', 'jacobi-anger', "),
    ("max_uv", 3.0, r"max_uv must be a finite number, at least 0 and at most 2\.001"),
]  # fmt: skip

# Calls of ``Image.save`` with invalid arguments, and the errors that they raise. The other invalid arguments follow
# from the descriptions of the options, and are tested in test_refusals.py.
SAVES = [
    ("out.jpg", {}, ValueError, "path must end in .exr or .png, got 'out.jpg'"),
    ("out", {}, ValueError, "path must end in .exr or .png, got 'out'"),
    ("nowhere/out.png", {}, FileNotFoundError, "path: the folder '.*nowhere' does not exist; create it first"),
    ("old.png", {"exposure": 0.0}, ValueError, "exposure must be a finite number, more than 0, got 0.0"),
    ("old.exr", {"exposure": math.inf}, ValueError, "exposure must be a finite number, more than 0, got inf"),
    ("old.png", {"exposure_from": 2.0}, TypeError, "exposure_from must be a warpdiff.Image, got float"),
    ("old.png", {"exposure": 1.0, "exposure_from": IMAGE}, ValueError, "exposure and exposure_from exclude each other"),
    ("old.png", {"display": "ACES"}, ValueError, "display must be one of 'aces', 'colorimetric', 'clip', got 'ACES'"),
    ("old.png", {"background": "white"}, TypeError, "background must be an array of real numbers, got str"),
    ("old.png", {"background": (255, 255, 255)}, ValueError, "background must be a colour of components from 0 to 1"),
    ("old.exr", {"background": (1, 1, 1)}, ValueError, "background must be None for .exr files"),
    ("old.exr", {"bits": 16}, ValueError, r"bits is for \.png files, got 16 for an \.exr file"),
]


def changed(**fields):
    """Return a copy of the plan ``PLAN`` with other values in some of its fields."""
    return dataclasses.replace(PLAN, **fields)


def shade(mesh=MESH, light=LIGHT, view=VIEW, **options):
    """Render a small picture with the given arguments and defaults for the others."""
    return wd.shade(mesh, HF, light, view, **options)


def text(path):
    """Write a text file under a name with the suffix of another format, and return its path."""
    path.write_text("this is a line of prose\n")
    return path


def options_of(name: str) -> set[str]:
    """Return the names of the keyword-only parameters of a public function, and the name ``heightfield``."""
    parameters = inspect.signature(getattr(wd, name)).parameters.values()
    return {option.name for option in parameters if option.kind is option.KEYWORD_ONLY} | {"heightfield"}


@pytest.fixture
def no_kernel(monkeypatch):
    """Fail the test if it launches a kernel, because invalid arguments must be refused before."""
    launched = []
    monkeypatch.setattr(wp, "launch", lambda kernel, *_, **__: launched.append(kernel))
    yield
    assert not launched


def test_every_function_with_an_option_method_is_called():
    functions = [name for name in wd.__all__ if inspect.isfunction(getattr(wd, name))]
    assert set(EVALUATE) == {name for name in functions if "method" in inspect.signature(getattr(wd, name)).parameters}


@pytest.mark.parametrize(
    ("function", "option", "value", "error", "message"),
    [
        pytest.param(name, *row, id=f"{name}-{row[0]}-{index}")
        for index, row in enumerate(SHARED)
        for name in EVALUATE
        if row[0] in options_of(name)
    ],
)
@pytest.mark.usefixtures("no_kernel")
def test_invalid_shared_options_are_refused(function, option, value, error, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        EVALUATE[function](**{option: value})


@pytest.mark.parametrize("function", EVALUATE)
@pytest.mark.parametrize("kind", ["centred", "replicas"])
@pytest.mark.usefixtures("no_kernel")
def test_power_series_are_refused_for_coherences_that_add_amplitudes(function, kind):
    """``method="power"`` must be refused for coherences that add amplitudes, with a list of the allowed methods."""
    coherence = wd.Coherence(kind, periods=(2, 2) if kind == "replicas" else None)
    with pytest.raises(ValueError, match=f"method='power' .* kind='{kind}'") as refused:
        EVALUATE[function](method="power", coherence=coherence)
    legal = str(refused.value).partition("use one of ")[2]
    assert legal == "'auto', 'low-rank', 'taylor', 'taylor-uncentred', 'jacobi-anger', 'direct'"


@pytest.mark.parametrize("option", ["device", "threads", "progress", "masking"])
@pytest.mark.usefixtures("no_kernel")
def test_the_direct_method_checks_options_that_it_ignores(option):
    with pytest.raises((TypeError, ValueError), match=f"{option} must be"):
        wd.reflectance(HF, UP, UP, method="direct", **{option: "bad"})


@pytest.mark.parametrize(
    ("error", "call", "message"),
    [
        pytest.param(error, *row, id=f"{error.__name__}-{index}")
        for error, rows in CALLS.items()
        for index, row in enumerate(rows)
    ],
)
@pytest.mark.usefixtures("no_kernel")
def test_invalid_arguments_are_refused(error, call, message, tmp_path, monkeypatch):
    # Set the free memory to a fixed value, because some systems do not report it.
    monkeypatch.setattr(memory, "available", lambda: 4e9)
    with pytest.raises(error, match=message):
        call(tmp_path)


@pytest.mark.parametrize(("field", "value", "message"), PLANS)
def test_invalid_fields_of_plans_are_refused(field, value, message):
    with pytest.raises(ValueError, match=message):
        changed(**{field: value})


def test_heights_of_another_unit_are_refused_before_kernels_are_compiled():
    with pytest.raises(ValueError, match=r"heightfield has a height range of 4e.14 µm, which is .* wavelengths of"):
        wd.shade(MESH, wd.HeightField.of_known_scale([[0.0, 4e14]], 0.1), LIGHT, VIEW)


@pytest.mark.parametrize(("name", "options", "error", "message"), SAVES)
def test_refused_saving_changes_no_files(name, options, error, message, tmp_path):
    for old in ("old.png", "old.exr"):
        (tmp_path / old).write_text("precious")
    with pytest.raises(error, match=message):
        IMAGE.save(tmp_path / name, **options)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "old.png": "precious",
        "old.exr": "precious",
    }


@pytest.mark.parametrize("path", [None, 5, b"out.png"])
def test_saving_refuses_invalid_paths(path):
    with pytest.raises(TypeError, match="path must be a string or a path, got"):
        IMAGE.save(path)
