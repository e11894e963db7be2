"""Plain surfaces, which have no height field: the BRDF of glTF 2.0, appendix B, in NumPy, and objects for test scenes.

The test scenes also have a grating, because a picture requires a height field. It is outside of the picture.
"""

import math

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals

import warpdiff as wd
from warpdiff.optics import colorimetry

SIGMA_UM = 5.0
COHERENCE = wd.Coherence(sigma_um=SIGMA_UM)
WAVE = wd.gratings.sinusoidal(1.5, 0.1)
OPTIONS = {"coherence": COHERENCE, "tolerance": 0.1, "strict": False}
POINTS = OPTIONS | {"footprint": False, "refine": False}
VIEW = wd.View.orthographic((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), extent_y=2.2, width=96, height=16)
SURFACES = {"grating": WAVE, "*": None}


def white_luminance():
    """Return the luminance of a white matte surface that faces a light of power 1.

    It is the mean of λ²/(4π²σ²), weighted by S ȳ: the spectrum S of the light times the curve ȳ of the CIE observer. σ
    is the standard deviation of the coherence window.
    """
    um = 1e-3 * colorimetry.VISIBLE_NM
    return float(um**2 @ colorimetry.colour_products("D65")[:, 1]) / (4.0 * math.pi**2 * SIGMA_UM**2)


LEAST_ALPHA = 0.5 * math.sqrt(white_luminance())


def quad(x, own, bend=0.25, y=0.0):
    """Return a quad with sides of 2 and the material ``own``. Its normals are tilted outwards by ``bend``."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return trimesh.Trimesh(
        corners + np.array([x, y, 0.0]), [[0, 1, 2], [0, 2, 3]],
        vertex_normals=corners * (bend, bend, 0.0) + np.array([0.0, 0.0, 1.0]), process=False,
        visual=TextureVisuals(uv=corners[:, :2], material=own),
    )  # fmt: skip


def brdf(to_light, to_view, metallic, roughness, colour):
    """Return the BRDF of glTF 2.0 in 1/sr, shape (n, 3), with the height-correlated masking of Heitz 2014."""
    alpha2 = max(roughness**2, LEAST_ALPHA) ** 2
    half = to_light + to_view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    n_h, v_h = half[:, 2], np.sum(to_view * half, axis=-1)
    n_l, n_v = to_light[:, 2], to_view[:, 2]
    distribution = alpha2 / (math.pi * (n_h**2 * (alpha2 - 1.0) + 1.0) ** 2)
    lambdas = [0.5 * (np.sqrt(1.0 + alpha2 * (1.0 - c**2) / c**2) - 1.0) for c in (n_l, n_v)]
    shadowing = 1.0 / (1.0 + lambdas[0] + lambdas[1])
    base = np.array([round(255 * value) / 255 for value in colour])
    f0 = 0.04 * (1.0 - metallic) + base * metallic
    fresnel = f0 + (1.0 - f0) * ((1.0 - np.abs(v_h)) ** 5)[:, None]
    diffuse = (1.0 - fresnel) * base * (1.0 - metallic) / math.pi
    return diffuse + fresnel * (distribution * shadowing / (4.0 * n_l * n_v))[:, None]
