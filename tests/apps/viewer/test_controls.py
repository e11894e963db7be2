"""Controls of the viewer's page: they are made from descriptions of options, and error messages show their labels."""

import json

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.apps.viewer.controls import EXCLUDED, checked, controls, defaults, described, word
from warpdiff.core.options import describe
from warpdiff.core.wording import spelled
from warpdiff.request.settings import DisplaySettings, PictureSettings

KNOWN = controls(["m.obj"], ["h.npy"], ["s.exr"])
VALUES = defaults(KNOWN)


def test_every_option_of_pictures_has_a_control_or_is_excluded():
    options = {control.option.name for control in KNOWN.values() if control.call in ("picture", "display")}
    assert not options & set(EXCLUDED)
    assert options | set(EXCLUDED) == {*describe(PictureSettings), *describe(DisplaySettings)}


def test_initial_values_equal_the_defaults_of_the_library():
    assert wd.Coherence().sigma_um == VALUES["sigma_um"]
    assert wd.Coherence("source").angular_diameter_deg == VALUES["source_diameter_deg"]
    heightfield, up = wd.gratings.sinusoidal(2.0, 0.1), (0.0, 0.0, 1.0)
    colours = [
        wd.reflectance(heightfield, up, (0.3, 0.0, 0.9), tolerance=0.1, ior=ior) for ior in (None, VALUES["ior"])
    ]
    np.testing.assert_array_equal(*colours)


def test_controls_are_described_by_the_keys_of_json_schema():
    schemas = {schema["name"]: schema for schema in json.loads(json.dumps(described(KNOWN)))}
    assert (
        schemas["sigma_um"] | {"type": "number", "minimum": 1.0, "maximum": 100.0, "default": 16.25}
        == schemas["sigma_um"]
    )
    assert schemas["energy"]["enum"] == ["stam", "normalised"]
    assert schemas["shadows"]["type"] == "boolean"
    assert schemas["fingers_seed"]["type"] == "integer"
    assert schemas["masking"]["x-ui"]["shown_if"] == {"energy": ["stam"]}
    for name, schema in schemas.items():
        assert schema["title"], name
        assert schema["description"], name
        assert "``" not in schema["description"], name
        assert checked(KNOWN, {name: schema["default"]})[name] == schema["default"]


@pytest.mark.parametrize(
    ("values", "message"),
    [({"sigma_um": "x"}, "σ must be a number, got 'x'"),
     ({"sigma_um": 0.5}, "σ must be a finite number, at least 1 and at most 100, got 0.5"),
     ({"smooth": 1}, "smooth normals must be on or off, got 1"),
     ({"tolerance": 0.2}, "tolerance must be one of '1e-1', '3e-2', '1e-2', got 0.2"),
     ({"surface": ["fingers"]}, "height field must be one of 'h.npy', 'nano-fingers', "),
     ({"sigma": 2.0}, "there is no control 'sigma'"),
     ([], "the values of the controls must be a JSON object")],
)  # fmt: skip
def test_wrong_values_are_refused_by_the_labels_of_their_controls(values, message):
    with pytest.raises((ValueError, TypeError)) as error:
        checked(KNOWN, values)
    assert spelled(error.value, word(KNOWN, VALUES)).startswith(message)


@pytest.mark.parametrize(
    ("name", "value", "expected", "values"),
    [("tolerance", None, "tolerance", {}),
     ("sigma_um", None, "σ", {}),
     ("spacing_um[1]", None, "spacing along x", {"surface": "bumps"}),
     ("spacing_um", None, "spacing", {"surface": "bumps"}),
     ("length_um", None, "length along y", {"surface": "bumps"}),
     ("length_um", None, "length", {"surface": "disc"}),
     ("kind", "'replicas'", "coherence = replicas", {}),
     ("angular_diameter_deg", None, "angular diameter of the source", {"coherence": "source"}),
     ("lights[1].power", None, "power of the light", {"light": "point", "environment": "file 0"}),
     ("lights[0].to_light", None, "direction of the light", {}),
     ("lights", None, "light", {}),
     ("heightfield", None, "height field", {}),
     ("filled()", None, "filled()", {})],
)  # fmt: skip
def test_arguments_are_named_by_the_labels_of_their_controls(name, value, expected, values):
    assert word(KNOWN, VALUES | values)(name, value) == expected
