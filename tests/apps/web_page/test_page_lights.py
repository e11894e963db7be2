"""Lights of exported pages, tested without a browser: supported kinds are written, others refused in one message."""

import json
import math
import re

import numpy as np
import pytest

import warpdiff as wd

VIEW = wd.View((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def lobes():
    return wd.bake(wd.gratings.sinusoidal(1.0, 0.1), coherence=wd.Coherence(sigma_um=0.6), delta_e=20.0)


def lights_of(path):
    """Return the lights that the JSON header of a page lists."""
    text = path.read_text(encoding="utf-8")
    return json.loads(re.search(r'id="header">(.*?)</script>', text, re.DOTALL)[1])["lights"]


def test_points_and_discs_are_written_as_one_lobe_each(lobes, square, tmp_path):
    lights = [
        wd.DirectionalLight((0.0, 3.0, 4.0), power=2.0),
        wd.DirectionalLight((0.0, 0.0, 1.0), angular_diameter_deg=5.0),
        wd.PointLight((1.0, 2.0, 3.0), power=7.0),
    ]
    point, disc, lamp = lights_of(wd.export_html(tmp_path / "page.html", square, lobes, lights, VIEW))
    assert point == {"to_light": pytest.approx([0.0, 0.6, 0.8]), "position": None, "power": 2.0, "deviation": 0.0}
    # A uniform disc of radius r has a variance of r²/4 along each axis, so its standard deviation is r/2.
    assert disc["deviation"] == pytest.approx(math.radians(2.5) / 2.0)
    assert (lamp["position"], lamp["power"], lamp["deviation"]) == ([1.0, 2.0, 3.0], 7.0, 0.0)


class Spotlight(wd.PointLight):
    """A kind of light that a user could define as a subclass, and that pages do not support."""


def test_other_lights_are_refused_in_one_message_that_names_them(lobes, square, tmp_path):
    wide = wd.DirectionalLight((0.0, 0.0, 1.0), angular_diameter_deg=10.0)
    sky = wd.Environment(np.ones((2, 4, 3)))
    lights = [wd.PointLight((0.0, 2.0, 3.0)), wide, sky, sky, Spotlight((0.0, 0.0, 9.0))]
    with pytest.raises(ValueError, match="must be point lights, or directional lights of at most 5°") as caught:
        wd.export_html(tmp_path / "page.html", square, lobes, lights, VIEW)
    names, remedies = str(caught.value).partition(" got ")[2].split("; use ")
    assert names == "lights[1] (10°), lights[2] (Environment), lights[3] (Environment), lights[4] (Spotlight)"
    assert remedies == (
        "several lights for a wide disc, or lobes of a source; a DirectionalLight for a sky's sun, or render a "
        "sequence under the sky; a PointLight or a DirectionalLight for other kinds"
    )
    with pytest.raises(ValueError, match=r"got lights\[0\] \(Environment\); use a DirectionalLight for a sky's sun"):
        wd.export_html(tmp_path / "page.html", square, lobes, sky, VIEW)
    assert not list(tmp_path.iterdir())
