"""Bad input: one row an input, with the message it gets, before any kernel runs and before any file is touched."""

from __future__ import annotations

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
# For one direction, which nothing is searched for: each worker imports this file.
PLAN = wd.plan(HF, UP, UP)
CENTRED_PLAN = wd.plan(HF, UP, UP, coherence=wd.Coherence("centred"))
IMAGE = wd.Image(
    xyz=np.ones((3, 4, 3), np.float32), mask=np.ones((3, 4), bool), illuminated=np.ones((3, 4), bool),
    coverage=np.ones((3, 4), np.float32), error=np.zeros((3, 4), np.float32), plan=PLAN,
)  # fmt: skip
TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def bare(vertices=TRIANGLE, faces=((0, 1, 2),)) -> trimesh.Trimesh:
    """A mesh without texture coordinates."""
    return trimesh.Trimesh(vertices, faces, process=False)


EVALUATE = {
    "reflectance": lambda heightfield=HF, **options: wd.reflectance(heightfield, UP, UP, **options),
    "spectral_reflectance": lambda heightfield=HF, **options: wd.spectral_reflectance(
        heightfield, UP, UP, [500.0], **options
    ),
    "brdf": lambda heightfield=HF, **options: wd.brdf(heightfield, UP, UP, [500.0], **options),
    "reflectance_map": lambda heightfield=HF, **options: wd.reflectance_map(heightfield, UP, **({"size": 4} | options)),
    "plan": lambda heightfield=HF, **options: wd.plan(heightfield, UP, UP, **options),
    "shade": lambda heightfield=HF, **options: wd.shade(MESH, heightfield, LIGHT, VIEW, **options),
}

# Operands and options that several functions take: each row is tried with every function that takes it.
SHARED = [
    ("heightfield", np.zeros((8, 8)), TypeError, r"heightfield must be a warpdiff\.HeightField, got ndarray"),
    ("heightfield", "scan.png", TypeError, r"heightfield must be a warpdiff\.HeightField, got str"),
    ("heightfield", None, TypeError, r"heightfield must be a warpdiff\.HeightField, got NoneType"),
    ("tolerance", 0.0, ValueError, r"tolerance must be a finite number, at least 1e-05 and at most 0\.5, got 0\.0"),
    ("tolerance", 0.6, ValueError, r"tolerance must be a finite number, at least 1e-05 and at most 0\.5, got 0\.6"),
    ("tolerance", math.nan, ValueError, "tolerance must be a finite number"),
    ("tolerance", True, TypeError, "tolerance must be a number, got bool"),
    ("tolerance", "low", TypeError, "tolerance must be a number, got str"),
    ("tolerance", None, TypeError, "tolerance must be a number, got NoneType"),
    ("method", "jacobi", ValueError, "method must be one of 'auto', 'low-rank', .*got 'jacobi'"),
    ("method", None, ValueError, "method must be one of 'auto'.* got None"),
    ("method", ["taylor"], ValueError, r"method must be one of 'auto'.* got \['taylor'\]"),
    (
        "integration", "order-wise", ValueError,
        "integration must be one of 'auto', 'sampled', 'table', got 'order-wise'",
    ),
    ("coherence", "averaged", TypeError, r"coherence must be a warpdiff\.Coherence, got str"),
    ("coherence", 16.25, TypeError, r"coherence must be a warpdiff\.Coherence, got float"),
    ("ior", 1.0, ValueError, "ior must be a number, more than 1, got 1.0"),
    ("ior", 0.5, ValueError, "ior must be a number, more than 1, got 0.5"),
    ("ior", -math.inf, ValueError, "ior must be a number, more than 1, got -inf"),
    ("ior", math.nan, ValueError, "ior must be a number, more than 1, got nan"),
    ("ior", True, TypeError, "ior must be a number, got bool"),
    ("ior", "glass", TypeError, "ior must be a number, got str"),
    ("material", "gold", TypeError, r"material must be a warpdiff\.Material, got str"),
    ("material", 1.5, TypeError, r"material must be a warpdiff\.Material, got float"),
    ("energy", "exact", ValueError, "energy must be one of 'stam', 'normalised', got 'exact'"),
    ("masking", "no", TypeError, "masking must be True or False, got 'no'"),
    ("masking", None, TypeError, "masking must be True or False, got None"),
    ("strict", "no", TypeError, "strict must be True or False, got 'no'"),
    ("strict", 0, TypeError, "strict must be True or False, got 0"),
    ("plan", 9, TypeError, r"plan must be a warpdiff\.Plan, got int"),
    ("plan", "taylor", TypeError, r"plan must be a warpdiff\.Plan.* got str"),
    ("device", "gpu", ValueError, "device must be 'cpu', or 'cuda' on a machine with a CUDA device, got 'gpu'"),
    ("device", "cuda:99", ValueError, "device must be 'cpu', or 'cuda' on a machine with a CUDA device, got 'cuda:99'"),
    ("device", 5, TypeError, "device must be a string, got int"),
    ("threads", 0, ValueError, "threads must be an integer, at least 1, got 0"),
    ("threads", -2, ValueError, "threads must be an integer, at least 1, got -2"),
    ("threads", 1.5, TypeError, "threads must be an integer, got float"),
    ("threads", True, TypeError, "threads must be an integer, got bool"),
    ("progress", "bar", TypeError, "progress must be True, a callable or None, got str"),
    ("illuminant", "D66", ValueError, "illuminant must be one of .*D65.* got 'D66'"),
    (
        "illuminant", 6500, TypeError,
        "illuminant must be the name of a CIE illuminant, such as 'D65', or a warpdiff.Spectrum, got int",
    ),
    ("illuminant", "ISO 7589 Photographic Daylight", ValueError, "illuminant must cover 380 to 780 nm"),
    ("size", 1, ValueError, "size must be an integer, at least 2, got 1"),
    ("size", -512, ValueError, "size must be an integer, at least 2, got -512"),
    ("size", 64.0, TypeError, "size must be an integer, got float"),
    ("size", (64, 64), TypeError, "size must be an integer, got tuple"),
    ("pigment", -1.0, ValueError, "pigment must be a finite number, at least 0, got -1.0"),
    ("pigment", math.inf, ValueError, "pigment must be a finite number, at least 0, got inf"),
    ("pigment", "brown", TypeError, "pigment must be a number, got str"),
    ("shadows", "off", TypeError, "shadows must be True or False, got 'off'"),
    ("smooth", 2, TypeError, "smooth must be True or False, got 2"),
    ("footprint", "on", TypeError, "footprint must be True or False, got 'on'"),
    ("refine", 1, TypeError, "refine must be True or False, got 1"),
    ("samples_per_pixel", 0, ValueError, "samples_per_pixel must be an integer, at least 1.*, got 0"),
    ("samples_per_pixel", 4.0, TypeError, "samples_per_pixel must be an integer, got float"),
    ("tangents", np.ones((3, 3)), ValueError, r"tangents must have shape \(\d+, 3\).* got \(3, 3\)"),
    ("tangents", "radial", TypeError, "tangents must be an array of real numbers, got str"),
    ("tangents", np.zeros_like(MESH.vertices), ValueError, "tangents must define a direction along the surface"),
    ("tangents", np.full_like(MESH.vertices, math.nan), ValueError, "tangents must be finite"),
    ("layers", "normal", TypeError, "layers must be a tuple or list of 'normal', 'depth', 'geometry', got 'normal'"),
    ("layers", None, TypeError, "layers must be a tuple or list of"),
    ("layers", ["albedo"], ValueError, "layers must be one of 'normal', 'depth', 'geometry', got 'albedo'"),
]  # fmt: skip

# Everything else; each call is given an empty folder.
SINGLE = [
    # Height fields
    (lambda _: wd.HeightField([[math.nan]], 0.1), ValueError, "heights_um must have at least one height, got 1 NaN"),
    (lambda _: wd.HeightField([[-math.inf]], 0.1), ValueError, "heights_um must be finite, got 1 infinite"),
    (lambda _: wd.HeightField([0.0, 1.0], 0.1), ValueError, r"heights_um must be a 2-D array, got shape \(2,\)"),
    (lambda _: wd.HeightField(np.zeros((2, 3, 4)), 0.1), ValueError, r"heights_um must be a 2-D array.*\(2, 3, 4\)"),
    (lambda _: wd.HeightField(np.zeros((0, 3)), 0.1), ValueError, "heights_um must have at least one sample"),
    (lambda _: wd.HeightField([[0.0], [0.0, 1.0]], 0.1), TypeError, "heights_um must be an array of real numbers"),
    (lambda _: wd.HeightField([[1j]], 0.1), TypeError, "heights_um must be an array of real numbers"),
    (lambda _: wd.HeightField([["high"]], 0.1), TypeError, "heights_um must be an array of real numbers"),
    (lambda _: wd.HeightField([[0.0]], 0.0), ValueError, "pitch_um must be a finite number, more than 0, got 0.0"),
    (lambda _: wd.HeightField([[0.0]], -0.1), ValueError, "pitch_um must be a finite number, more than 0, got -0.1"),
    (lambda _: wd.HeightField([[0.0]], math.nan), ValueError, "pitch_um must be a finite number, more than 0, got nan"),
    (lambda _: wd.HeightField([[0.0]], (0.1, 0.0)), ValueError, r"pitch_um\[1\] must be a finite number, more than 0"),
    (lambda _: wd.HeightField([[0.0]], (1, 1, 1)), ValueError, r"pitch_um must be one number or a pair \(y, x\)"),
    (lambda _: wd.HeightField([[0.0]], "fine"), TypeError, "pitch_um must be a number, got str"),
    (lambda d: wd.HeightField.load(d / "no.png", extent_um=1), FileNotFoundError, "path: there is no file .*no.png"),
    (lambda d: wd.HeightField.load(text(d / "a.png"), extent_um=1), ValueError, "path: .* cannot be read as an image"),
    (lambda d: wd.HeightField.load(text(d / "a.npy"), extent_um=1), ValueError, "path: .* cannot be read as .npy"),
    (lambda d: wd.HeightField.load(saved(d / "a.npy")), ValueError, "exactly one of extent_um .* pitch_um .* neither"),
    # Windows, lights, views
    (lambda _: wd.Coherence(kind="laser"), ValueError, "kind must be one of 'averaged', .* got 'laser'"),
    (lambda _: wd.Coherence(kind=None), ValueError, "kind must be one of 'averaged', .* got None"),
    (lambda _: wd.Coherence(sigma_um=0.0), ValueError, "sigma_um must be a finite number, at least 1e-15, got 0.0"),
    (lambda _: wd.Coherence(sigma_um=-1), ValueError, "sigma_um must be a finite number, at least 1e-15, got -1"),
    (
        lambda _: wd.Coherence(sigma_um=math.inf),
        ValueError,
        "sigma_um must be a finite number, at least 1e-15, got inf",
    ),
    (lambda _: wd.Coherence(sigma_um="wide"), TypeError, "sigma_um must be a number, got str"),
    (lambda _: wd.Coherence(centre_um=(1, 1)), ValueError, "centre_um is for kind='centred', not 'averaged'"),
    (
        lambda _: wd.Coherence("source", 5.0),
        ValueError,
        "sigma_um is for kind='averaged' or kind='centred', not 'source'",
    ),
    (
        lambda _: wd.Coherence("source", angular_diameter_deg=0),
        ValueError,
        "angular_diameter_deg must be .* at least 1e-15",
    ),
    (
        lambda _: wd.Coherence("source", angular_diameter_deg=-1.0),
        ValueError,
        "angular_diameter_deg must be .* at least 1e-15",
    ),
    (
        lambda _: wd.Coherence("source", angular_diameter_deg=40.0),
        ValueError,
        "angular_diameter_deg must be .* at most 30, got 40",
    ),
    (
        lambda _: wd.Coherence("source", angular_diameter_deg=math.nan),
        ValueError,
        "angular_diameter_deg must be a finite",
    ),
    (lambda _: wd.Coherence("source", angular_diameter_deg="sun"), TypeError, "angular_diameter_deg must be a number"),
    (
        lambda _: wd.Coherence("centred", angular_diameter_deg=1),
        ValueError,
        "angular_diameter_deg is for kind='source'",
    ),
    (lambda _: wd.Coherence("replicas"), ValueError, r"periods must be given for kind='replicas': a pair \(y, x\)"),
    (
        lambda _: wd.Coherence("replicas", periods=3),
        ValueError,
        r"periods must be a pair \(y, x\) of integers, got 3",
    ),
    (lambda _: wd.Coherence("replicas", periods=(1, 2, 3)), ValueError, r"periods must be a pair .* got \(1, 2, 3\)"),
    (
        lambda _: wd.Coherence("replicas", periods=(0, 3)),
        ValueError,
        r"periods\[0\] must be an integer, at least 1 and at most 100000, got 0",
    ),
    (lambda _: wd.Coherence("replicas", periods=(1.5, 2)), TypeError, r"periods\[0\] must be an integer, got float"),
    (lambda _: wd.Coherence("replicas", periods=(True, 2)), TypeError, r"periods\[0\] must be an integer, got bool"),
    (
        lambda _: wd.Coherence("replicas", periods=(-1, 2)),
        ValueError,
        r"periods\[0\] must be an integer, at least 1 and at most 100000, got -1",
    ),
    (lambda _: wd.Coherence("replicas", periods="12"), ValueError, r"periods must be a pair .* got '12'"),
    (lambda _: wd.Coherence("replicas", periods=()), ValueError, r"periods must be a pair .* got \(\)"),
    (lambda _: wd.Coherence("replicas", 5.0, periods=(1, 2)), ValueError, "sigma_um is for .*, not 'replicas'"),
    (lambda _: wd.Coherence("source", periods=(1, 2)), ValueError, "periods is for kind='replicas', not 'source'"),
    (lambda _: wd.Coherence("source", centre_um=(0, 0)), ValueError, "centre_um is for kind='centred', not 'source'"),
    (lambda _: wd.Coherence(angular_diameter_deg=0.5), ValueError, "angular_diameter_deg is for kind='source', not"),
    (lambda _: wd.Coherence("source", angular_diameter_deg=math.inf), ValueError, "angular_diameter_deg must be .* 30"),
    (lambda _: wd.Coherence("source", angular_diameter_deg=True), TypeError, "angular_diameter_deg must be a number"),
    (lambda _: wd.Coherence("replicas", periods=(1, 1.5)), TypeError, r"periods\[1\] must be an integer, got float"),
    (
        lambda _: wd.Coherence("replicas", periods=(1, 10**6)),
        ValueError,
        r"periods\[1\] must be an integer, at least 1 and at most 100000, got 1000000",
    ),
    (lambda _: wd.Coherence("averaged", periods=(1, 2)), ValueError, "periods is for kind='replicas', not 'averaged'"),
    (lambda _: wd.Coherence("centred", centre_um=3.0), ValueError, r"centre_um must be a pair \(y, x\), got"),
    (lambda _: wd.Coherence("centred", centre_um=(0, math.nan)), ValueError, "centre_um must be finite"),
    (lambda _: wd.DirectionalLight((0, 0, 0)), ValueError, "to_light must not contain zero vectors"),
    (
        lambda _: wd.DirectionalLight(UP, power=-1),
        ValueError,
        r"power must be a finite number, at least 0 and at most 1e\+12, got -1",
    ),
    (lambda _: wd.View(UP, UP), ValueError, "eye and target must be two different points"),
    (lambda _: wd.View(UP, (0, 0, 0), width=0), ValueError, "width must be an integer, at least 1, got 0"),
    (lambda _: wd.View(UP, (0, 0, 0), height=-480), ValueError, "height must be an integer, at least 1, got -480"),
    # Directions and wavelengths
    (lambda _: wd.reflectance(HF, [0, 0, 0], UP), ValueError, "to_light must not contain zero vectors, got 1"),
    (lambda _: wd.reflectance(HF, UP, [UP, [0, 0, 0]]), ValueError, "to_view must not contain zero vectors, got 1"),
    (lambda _: wd.reflectance(HF, [math.nan, 0, 1], UP), ValueError, "to_light must be finite, got 1 NaN"),
    (lambda _: wd.reflectance(HF, UP, [0, 0, math.inf]), ValueError, "to_view must be finite, got 1 NaN or infinite"),
    (lambda _: wd.reflectance(HF, [0, 1], UP), ValueError, r"to_light must have shape \(3,\) or \(n, 3\), got \(2,\)"),
    (
        lambda _: wd.reflectance(HF, UP, [[UP]]),
        ValueError,
        r"to_view must have shape \(3,\) or \(n, 3\), got \(1, 1, 3",
    ),
    (lambda _: wd.reflectance(HF, "up", UP), TypeError, "to_light must be an array of real numbers, got str"),
    (lambda _: wd.reflectance(HF, None, UP), TypeError, "to_light must be an array of real numbers, got NoneType"),
    (lambda _: wd.reflectance(HF, [UP, [0, 1]], UP), TypeError, "to_light must be an array of real numbers, got list"),
    (lambda _: wd.reflectance(HF, [UP] * 2, [UP] * 3), ValueError, "to_light and to_view must hold .* got 2 and 3"),
    (lambda _: wd.spectral_reflectance(HF, [UP] * 2, [UP] * 3, 500), ValueError, "the same number of directions"),
    (lambda _: wd.plan(HF, [UP] * 2, [UP] * 3), ValueError, "to_light and to_view must hold the same number"),
    (lambda _: wd.plan(HF, [0, 0, 0]), ValueError, "to_light must not contain zero vectors"),
    (lambda _: wd.plan(HF, None, [0, 0, 0]), ValueError, "to_view must not contain zero vectors"),
    (lambda _: wd.brdf(HF, UP, UP, []), ValueError, r"wavelengths_nm must have shape \(m,\), got \(0,\)"),
    (lambda _: wd.brdf(HF, UP, UP, [[500.0]]), ValueError, r"wavelengths_nm must have shape \(m,\), got \(1, 1\)"),
    (lambda _: wd.brdf(HF, UP, UP, [math.nan]), ValueError, "wavelengths_nm must be finite"),
    (lambda _: wd.brdf(HF, UP, UP, -500.0), ValueError, "wavelengths_nm must lie within 100 to 10000 nm"),
    (
        lambda _: wd.spectral_reflectance(HF, UP, UP, 0.5),
        ValueError,
        "wavelengths_nm .* give wavelengths in nanometres",
    ),
    (lambda _: wd.spectral_reflectance(HF, UP, UP, "blue"), TypeError, "wavelengths_nm must be an array of real"),
    (lambda _: wd.reflectance_map(HF, [1, 0, 0]), ValueError, r"to_light must lie above the horizon \(z > 0\)"),
    (lambda _: wd.reflectance_map(HF, [0, 0, -1]), ValueError, r"to_light must lie above the horizon \(z > 0\)"),
    (
        lambda _: wd.reflectance_map(HF, UP, samples_per_pixel=8),
        ValueError,
        "samples_per_pixel must be a square number",
    ),
    (
        lambda _: wd.reflectance_map(HF, UP, samples_per_pixel=0),
        ValueError,
        "samples_per_pixel must be at least 1|samples",
    ),
    (
        lambda _: wd.reflectance_map(HF, [UP, UP]),
        ValueError,
        r"to_light must have shape \(3,\) for a map, got \(2, 3\)",
    ),
    # Meshes, lights and views of a picture
    (lambda d: shade(d / "no.obj"), FileNotFoundError, "the mesh file .*no.obj' does not exist"),
    (lambda d: shade(text(d / "a.txt")), ValueError, "mesh must be a file that trimesh can read"),
    (lambda d: shade(text(d / "a.obj")), ValueError, "mesh must "),
    (lambda _: shade(None), TypeError, "mesh must be a trimesh.Trimesh, a trimesh.Scene or a path, got NoneType"),
    (lambda _: shade(TRIANGLE), TypeError, "mesh must be a trimesh.Trimesh, .* got ndarray"),
    (lambda _: shade(trimesh.Trimesh()), ValueError, "mesh must have vertices, got none"),
    (lambda _: shade(trimesh.Scene()), ValueError, "mesh must have triangles, got a scene or file without any"),
    (lambda _: shade(bare(faces=np.zeros((0, 3), int))), ValueError, "mesh must have faces, got 3 vertices and no"),
    (lambda _: shade(bare(TRIANGLE * math.nan)), ValueError, "mesh must have finite vertices, got 3"),
    (lambda _: shade(bare(faces=[[0, 1, 3]])), ValueError, "mesh must have face indices within 0 to 2"),
    (lambda _: shade(bare()), ValueError, "mesh has neither texture coordinates nor tangents; give tangents"),
    (
        lambda _: shade(bare(TRIANGLE * [1, 0, 0]), tangents=np.ones((3, 3))),
        ValueError,
        "mesh must have a face with an area, got 1 without",
    ),
    (
        lambda _: shade(light=[]),
        TypeError,
        r"lights must be a DirectionalLight, .* or a non-empty sequence .* got \[\]",
    ),
    (
        lambda _: shade(light=None),
        TypeError,
        "lights must be a Directional.* or a non-empty sequence .* got None",
    ),
    (lambda _: shade(light=(0, 0, 1)), TypeError, r"lights\[0\] must be a warpdiff.Light, got int"),
    (lambda _: shade(light=[LIGHT, UP]), TypeError, r"lights\[1\] must be a warpdiff.Light, got list"),
    (
        lambda _: shade(light=wd.DirectionalLight(UP, illuminant="D66")),
        ValueError,
        r"lights\[0\].illuminant must be one of .* got 'D66'",
    ),
    (lambda _: shade(view="front"), TypeError, "view must be a warpdiff.View, got str"),
    # Plans
    (lambda _: dataclasses.replace(PLAN, terms=0), ValueError, "terms must be an integer, at least 1, got 0"),
    (lambda _: dataclasses.replace(PLAN, terms=129), ValueError, "terms must be 1 to 128, got 129"),
    (lambda _: dataclasses.replace(PLAN, terms=9.0), TypeError, "terms must be an integer, got float"),
    (
        lambda _: dataclasses.replace(PLAN, least_weight=0.0),
        ValueError,
        "least_weight must be a finite number, more than 0",
    ),
    (lambda _: dataclasses.replace(PLAN, least_weight=1.0), ValueError, "least_weight must be less than 1, got 1"),
    (lambda _: dataclasses.replace(PLAN, least_weight=2), ValueError, "least_weight must be less than 1, got 2: no"),
    (
        lambda _: dataclasses.replace(PLAN, least_weight=-1e-9),
        ValueError,
        "least_weight must be a finite number, more than 0",
    ),
    (lambda _: dataclasses.replace(PLAN, least_weight=math.nan), ValueError, "least_weight must be a finite number"),
    (lambda _: dataclasses.replace(PLAN, least_weight="small"), TypeError, "least_weight must be a number, got str"),
    (lambda _: dataclasses.replace(PLAN, bandwidth_um=3.0), ValueError, r"bandwidth_um must be three numbers .* got 3"),
    (lambda _: dataclasses.replace(PLAN, bandwidth_um=(1, 2, math.nan)), ValueError, "bandwidth_um must be finite"),
    (lambda _: dataclasses.replace(PLAN, bandwidth_um="wide"), TypeError, "bandwidth_um must be an array of real"),
    (lambda _: dataclasses.replace(PLAN, subdivisions=1.5), TypeError, "subdivisions must be an integer, got float"),
    (
        lambda _: dataclasses.replace(PLAN, max_order_rate=-1.0),
        ValueError,
        "max_order_rate must be a finite number, at least 0",
    ),
    (lambda _: dataclasses.replace(PLAN, min_w=math.nan), ValueError, "min_w must be a finite number, at least 0"),
    (lambda _: dataclasses.replace(PLAN, lambda_max_nm=math.inf), ValueError, "lambda_max_nm must be a finite number"),
    (
        lambda _: dataclasses.replace(PLAN, bandwidth_um=(1.0, 2.0)),
        ValueError,
        "bandwidth_um must be three numbers >= 0",
    ),
    (
        lambda _: dataclasses.replace(PLAN, bandwidth_um=(1, -2, 3)),
        ValueError,
        "bandwidth_um must be three numbers >= 0",
    ),
    (lambda _: dataclasses.replace(PLAN, bandwidth_um=(1, 2, 0)), ValueError, "bandwidth_um must be .* the last > 0"),
    (
        lambda _: dataclasses.replace(PLAN, subdivisions=0),
        ValueError,
        "subdivisions must be an integer, at least 1, got 0",
    ),
    (lambda _: dataclasses.replace(PLAN, adaptive="no"), TypeError, "adaptive must be True or False, got 'no'"),
    (
        lambda _: dataclasses.replace(CENTRED_PLAN, method="power", rings_per_octave=0),
        ValueError,
        "method='power' expands powers, but coefficients of kind='centred' add as amplitudes: use one of 'auto'",
    ),
    (
        lambda _: wd.reflectance(HF, UP, UP, method="power", coherence=wd.Coherence("replicas", periods=(2, 2))),
        ValueError,
        "method='power' expands powers, but coefficients of kind='replicas' add as amplitudes: use one of 'auto'",
    ),
    (
        lambda _: dataclasses.replace(PLAN, wavelengths=1),
        ValueError,
        "wavelengths must be an integer, at least 2, got 1",
    ),
    (
        lambda _: dataclasses.replace(PLAN, method="auto"),
        ValueError,
        "method must be one of 'low-rank', 'power', 'taylor', 'taylor-uncentred', 'jacobi-anger', 'direct'",
    ),
    (lambda _: dataclasses.replace(PLAN, coherence=None), TypeError, "coherence must be a warpdiff.Coherence"),
    (lambda _: dataclasses.replace(PLAN, tolerance=2.0), ValueError, "tolerance must be a finite number"),
    (
        lambda _: wd.reflectance(HF, UP, UP, plan=PLAN, coherence=wd.Coherence("centred")),
        ValueError,
        "coherence differs from the coherence of plan",
    ),
    (
        lambda _: shade(plan=PLAN, coherence=wd.Coherence("centred")),
        ValueError,
        "coherence differs from the coherence of",
    ),
    (
        lambda _: wd.reflectance(HF, UP, UP, plan=dataclasses.replace(PLAN, wavelengths=0)),
        ValueError,
        "plan has no wavelengths",
    ),
    (lambda _: shade(plan=dataclasses.replace(PLAN, wavelengths=0)), ValueError, "plan has no wavelengths"),
    (
        lambda _: wd.reflectance(wd.HeightField(np.zeros((9, 9)), 10.0), UP, UP, coherence=wd.Coherence(sigma_um=0.1)),
        ValueError,
        "sigma_um=0.1 is too short for a patch of 90 × 90 µm",
    ),
]

# What has a unit and a magnitude that nothing has, or asks for arrays that fit nowhere.
SINGLE += [
    (lambda _: wd.HeightField([[1e16, 0.0]], 0.1), ValueError, r"heights_um must lie within ±1e\+15, got 1e\+16"),
    (
        lambda _: wd.HeightField([[0.0]], 1e16),
        ValueError,
        r"pitch_um must be a finite number, more than 0 and at most 1e\+15, got 1e\+16",
    ),
    (lambda _: wd.HeightField([[0.0]], 1e-16), ValueError, "pitch_um must be at least 1e-15, got 1e-16"),
    (lambda _: wd.HeightField([[0.0]], np.ma.masked), TypeError, "pitch_um must be a number, got MaskedConstant"),
    (lambda _: HF.cropped(0.2, offset_um=np.ma.masked), ValueError, r"offset_um must be a pair \(y, x\) or None"),
    (lambda _: HF.resampled(1e-14), MemoryError, "a field of 8 × 40000000000000 samples .* a pitch_um along y that is"),
    (lambda _: wd.View((1e16, 0, 0), UP), ValueError, r"eye must lie within ±1e\+15, got 1e\+16"),
    (lambda _: wd.Coherence("centred", centre_um=(0, -1e16)), ValueError, r"centre_um must lie within ±1e\+15"),
    (
        lambda _: wd.Coherence("source", angular_diameter_deg=5e-324),
        ValueError,
        "angular_diameter_deg must be a finite number, at least 1e-15",
    ),
    (
        lambda _: wd.gratings.sinusoidal(10**400, 0.1),
        ValueError,
        r"period_um must be a finite number, more than 0, got 1000",
    ),
    (
        lambda _: wd.gratings.blazed(1e-14, 0.1),
        ValueError,
        "period_um must be a finite number, at least 6.4e-14, got 1e-14",
    ),
    (lambda _: wd.gratings.blazed(1e15, 0.1), MemoryError, "a field of 1 × 25.* take .* of period_um, or of samples"),
    (lambda _: wd.gratings.disc(tracks=2**40), MemoryError, "a field of 640 × .* take .* of tracks, of length_um"),
    (
        lambda _: wd.gratings.disc(tracks=2**63),
        ValueError,
        "tracks must be an integer, at least 1 and at most 9223372036854775807",
    ),
    (
        lambda _: wd.gratings.bumps(pitch_um=1e-12),
        MemoryError,
        "a field of .* take .* of spacing_um, or a larger pitch",
    ),
    (
        lambda _: wd.gratings.fingers(size_um=1e10),
        MemoryError,
        "a field of .* take .* of size_um, or a larger pitch_um",
    ),
    (lambda _: wd.meshes.tube(segments_along=2**40), MemoryError, "a mesh of .* faces .* take .* of segments_along"),
    (lambda _: wd.meshes.disc(segments=2**40), MemoryError, "a mesh of .* faces .* take .* of segments, or of rings"),
    (lambda _: wd.meshes.snake(segments=2**20), MemoryError, "a snake of 27 × 130 scales .* or .* of segments"),
    (lambda _: wd.meshes.snake(length=1e4), ValueError, "length must be 16 to 1000 radii"),
    (lambda _: wd.order_efficiencies(wd.HeightField([[0.0, 0.1]], 1e15), UP, [500.0]), MemoryError, "a cell of 1 × 2"),
    (
        lambda _: shade(bare(TRIANGLE * 1e-300), tangents=np.ones((3, 3))),
        ValueError,
        r"mesh must have a radius of 1e-15 to 1e\+15, got ",
    ),
    (
        lambda _: shade(samples_per_pixel=2**40),
        ValueError,
        "samples_per_pixel must be an integer, at least 1 and at most 65536, got 1099511627776",
    ),
    (lambda _: shade(layers=np.array(3.0)), TypeError, "layers must be a tuple or list of"),
    (lambda _: wd.HeightField.load(None, pitch_um=0.1), TypeError, "path must be a string or a path, got NoneType"),
    (lambda _: wd.HeightField.load("a\0b", pitch_um=0.1), ValueError, r"path must be a name that .* got 'a\\x00b'"),
    (lambda _: wd.HeightField.load("\ud800", pitch_um=0.1), ValueError, "path must be a name that a file can have"),
    (lambda _: wd.HeightField.load("x" * 5000, pitch_um=0.1), ValueError, "path must be a name that a file can have"),
    (lambda _: shade("a\0b"), ValueError, r"mesh must be a name that a file can have, got 'a\\x00b'"),
    (lambda _: IMAGE.save("x" * 5000 + ".png"), ValueError, "path must be a name that a file can have"),
    (lambda _: dataclasses.replace(PLAN, aliasing=None), TypeError, "aliasing must be a number, got NoneType"),
    (lambda _: dataclasses.replace(PLAN, refined_share="x"), TypeError, "refined_share must be a number, got str"),
    (lambda _: dataclasses.replace(PLAN, errors=None), TypeError, "errors must be an array of real numbers"),
    (lambda _: dataclasses.replace(PLAN, errors=[1.0]), ValueError, r"errors must be a pair of numbers, got \[1.0\]"),
    (lambda _: dataclasses.replace(PLAN, is_measured=None), TypeError, "is_measured must be True or False, got None"),
    (
        lambda _: dataclasses.replace(PLAN, validation_size=-1),
        ValueError,
        "validation_size must be an integer, at least 0, got -1",
    ),
    (
        lambda _: dataclasses.replace(PLAN, max_uv=3.0),
        ValueError,
        r"max_uv must be a finite number, at least 0 and at most 2\.001",
    ),
    (
        lambda _: dataclasses.replace(PLAN, lambda_min_nm=0.0),
        ValueError,
        "lambda_min_nm must be a finite number, at least 100",
    ),
]

SAVES = [
    ("out.jpg", {}, ValueError, "path must end in .exr or .png, got 'out.jpg'"),
    ("out", {}, ValueError, "path must end in .exr or .png, got 'out'"),
    ("nowhere/out.png", {}, FileNotFoundError, "path: the folder .*nowhere does not exist; create it first"),
    ("old.png", {"exposure": 0.0}, ValueError, "exposure must be a finite number, more than 0, got 0.0"),
    ("old.png", {"exposure": -2.0}, ValueError, "exposure must be a finite number, more than 0, got -2.0"),
    ("old.exr", {"exposure": math.inf}, ValueError, "exposure must be a finite number, more than 0, got inf"),
    ("old.exr", {"exposure": math.nan}, ValueError, "exposure must be a finite number, more than 0, got nan"),
    ("old.png", {"exposure": "auto"}, TypeError, "exposure must be a number, got str"),
    ("old.png", {"exposure": True}, TypeError, "exposure must be a number, got bool"),
    (
        "old.png", {"exposure_stops": 1e9}, ValueError,
        "exposure_stops must be a finite number, at least -30 and at most 30",
    ),
    ("old.png", {"exposure_from": 2.0}, TypeError, "exposure_from must be a warpdiff.Image, got float"),
    ("old.png", {"exposure": 1.0, "exposure_from": IMAGE}, ValueError, "exposure and exposure_from exclude each other"),
    ("old.png", {"display": "ACES"}, ValueError, "display must be one of 'aces', 'colorimetric', 'clip', got 'ACES'"),
    ("old.png", {"gamut": "p3"}, ValueError, "gamut must be one of 'srgb', 'display-p3', got 'p3'"),
    ("old.png", {"background": "white"}, TypeError, "background must be an array of real numbers, got str"),
    ("old.png", {"background": (255, 255, 255)}, ValueError, "background must be a colour of components from 0 to 1"),
    ("old.exr", {"background": (1, 1, 1)}, ValueError, "background must be None for .exr files"),
    ("old.png", {"bits": 12}, ValueError, "bits must be 8 or 16, got 12"),
    ("old.png", {"bits": "8"}, TypeError, "bits must be an integer, got str"),
    ("old.png", {"bits": True}, TypeError, "bits must be an integer, got bool"),
]  # fmt: skip


def shade(mesh=MESH, light=LIGHT, view=VIEW, **options):
    """A picture with one argument changed."""
    return wd.shade(mesh, HF, light, view, **options)


def text(path):
    """A file that is not what its name says."""
    path.write_text("this is a line of prose\n")
    return path


def saved(path):
    """A file of two heights."""
    np.save(path, [[0.0, 0.1]])
    return path


def options_of(name: str) -> set[str]:
    """Keyword-only parameters of a public function, and ``heightfield``."""
    parameters = inspect.signature(getattr(wd, name)).parameters.values()
    return {each.name for each in parameters if each.kind is each.KEYWORD_ONLY} | {"heightfield"}


@pytest.fixture
def no_kernel(monkeypatch):
    """The names of kernels that were launched, which must stay empty."""
    launched = []
    monkeypatch.setattr(wp, "launch", lambda kernel, *_, **__: launched.append(kernel))
    yield
    assert not launched


def test_the_rows_cover_every_function_and_option():
    # Others have no plan to be named, and their rows in files of their own.
    functions = [name for name in wd.__all__ if inspect.isfunction(getattr(wd, name))]
    assert set(EVALUATE) == {name for name in functions if "method" in inspect.signature(getattr(wd, name)).parameters}
    assert {row[0] for row in SHARED} == set().union(*(options_of(name) for name in EVALUATE))


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
def test_options(function, option, value, error, message):
    with pytest.raises(error, match=message):
        EVALUATE[function](**{option: value})


@pytest.mark.parametrize("function", EVALUATE)
@pytest.mark.parametrize("kind", ["centred", "replicas"])
@pytest.mark.usefixtures("no_kernel")
def test_powers_are_no_basis_for_amplitudes(function, kind):
    """The message lists what is legal: all but what was asked for."""
    coherence = wd.Coherence(kind, periods=(2, 2) if kind == "replicas" else None)
    with pytest.raises(ValueError, match=f"method='power' .* kind='{kind}'") as refused:
        EVALUATE[function](method="power", coherence=coherence)
    legal = str(refused.value).partition("use one of ")[2]
    assert legal == "'auto', 'low-rank', 'taylor', 'taylor-uncentred', 'jacobi-anger', 'direct'"


@pytest.mark.parametrize("option", ["device", "threads", "progress", "masking"])
@pytest.mark.usefixtures("no_kernel")
def test_the_direct_method_checks_what_it_has_no_use_for(option):
    with pytest.raises((TypeError, ValueError), match=f"{option} must be"):
        wd.reflectance(HF, UP, UP, method="direct", **{option: "bad"})


@pytest.mark.parametrize(
    ("call", "error", "message"), [pytest.param(*row, id=f"{index}") for index, row in enumerate(SINGLE)]
)
@pytest.mark.usefixtures("no_kernel")
def test_arguments(call, error, message, tmp_path, monkeypatch):
    # Of systems that do not tell as well.
    monkeypatch.setattr(memory, "available", lambda: 4e9)
    with pytest.raises(error, match=message):
        call(tmp_path)


def test_heights_of_another_unit_are_refused_before_kernels_are_asked_for():
    with pytest.raises(
        ValueError, match=r"heightfield has a height range of 4e.14 µm, which is .* wavelengths of path"
    ):
        wd.shade(MESH, wd.HeightField.of_known_scale([[0.0, 4e14]], 0.1), LIGHT, VIEW)


@pytest.mark.parametrize(("name", "options", "error", "message"), SAVES)
def test_saving(name, options, error, message, tmp_path):
    for old in ("old.png", "old.exr"):
        (tmp_path / old).write_text("precious")
    with pytest.raises(error, match=message):
        IMAGE.save(tmp_path / name, **options)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(
        ("old.png", "old.exr"), "precious"
    )


@pytest.mark.parametrize("path", [None, 5, b"out.png"])
def test_saving_to_what_is_no_path(path):
    with pytest.raises(TypeError, match="path must be a string or a path, got"):
        IMAGE.save(path)
