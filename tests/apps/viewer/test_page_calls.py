"""The viewer's settings as library calls: executed calls, Python lines and the command have the same arguments."""

import functools
import inspect
import shlex

import numpy as np
import pytest
import warp as wp
from PIL import Image

import warpdiff as wd
from warpdiff.apps import cli
from warpdiff.apps.viewer import controls as viewer_controls
from warpdiff.apps.viewer import page_calls
from warpdiff.apps.viewer.controls import checked, controls, word
from warpdiff.apps.viewer.page_calls import Call, NamedFiles, Scene
from warpdiff.apps.viewer.scene_objects import SceneObjects
from warpdiff.core.options import Option, describe
from warpdiff.core.wording import spelled

VALUES = checked(controls(), {"mesh": "disc", "surface": "blazed", "sigma_um": 4.0, "azimuth_deg": 20.0})
VIEW = wd.View((0.0, 1.0, 3.0), (-1e-8, 0.0, 0.0), width=8, height=6)
OF_PICTURE = {"height", "lock_exposure", "background"}


@pytest.fixture
def files(tmp_path):
    np.save(tmp_path / "h.npy", 1e-3 * np.add.outer(np.arange(8.0), np.arange(8.0) ** 2))
    skies = tmp_path / "s.exr", tmp_path / "r.hdr"
    levelled = ("levelled", (("order", 1),))
    return NamedFiles((tmp_path / "m.obj",), (tmp_path / "h.npy",), skies, (("pitch_um", (0.1, 0.2)),), (levelled,))


def extremes(control):
    """Return all values of a control with choices, or the two end values of a slider."""
    return list(control.labels) or ([True, False] if control.slider is None else list(control.slider[:2]))


def scenes(files):
    """Yield each control of the viewer with scenes in which it is visible and has one of its extreme values."""
    first = checked(files.controls, {"mesh": "snake", "surface": "fingers", "light": "directional"})
    for control in files.controls.values():
        shown = first | {name: values[0] for name, values in control.shown_if.items()}
        yield control, [Scene.of(shown | {control.name: value}, files) for value in extremes(control)]


def test_every_control_is_part_of_a_scene(files, tmp_path):
    for control, made in scenes(files):
        of_picture = control.call == "display" or control.name in OF_PICTURE
        assert len(set(map(str, made))) == (1 if of_picture else len(made)), control.name
    first = checked(files.controls, {"mesh": "snake", "surface": "fingers"})
    scene = Scene.of(first | {"surface": "file 0"}, files)
    assert isinstance(scene.heightfield.make(), wd.HeightField)
    path = f"{tmp_path}/h.npy"
    assert str(scene.heightfield) == f"wd.HeightField.load('{path}', pitch_um=(0.1, 0.2)).levelled(order=1)"
    assert Scene.of(first, files).mesh.make().faces.shape[1] == 3


@pytest.fixture
def recorded(monkeypatch, tmp_path):
    """Replace functions for gratings, meshes and environment lights by ones that return name and arguments."""

    def recorder(function):
        @functools.wraps(function)
        def record(*operands, **options):
            bound = inspect.signature(function).bind(*operands, **options)
            bound.apply_defaults()
            return function.__qualname__, bound.arguments

        return record

    for module, names in ((wd.gratings, viewer_controls.GRATINGS), (wd.meshes, viewer_controls.BODIES)):
        for name in names:
            monkeypatch.setattr(module, name, recorder(getattr(module, name)))
    for name in ("load", "clear_sky"):
        monkeypatch.setattr(wd.Environment, name, recorder(getattr(wd.Environment, name)))
    monkeypatch.chdir(tmp_path)


def operands_of(value):
    return (value.heights_um.tolist(), value.pitch_um) if isinstance(value, wd.HeightField) else value


def by_python(lines):
    """Execute Python lines of the page, and return the arguments that they pass to ``Renderer``."""
    names = {}
    recording = lines.partition("renderer.image()")[0].replace("wd.Renderer(", "(lambda *a, **k: (a, k))(")
    exec(recording, names)  # noqa: S102 (the viewer's own lines)
    (mesh, heightfield, lights, view), options = names["renderer"]
    lights = lights if isinstance(lights, list) else [lights]
    return mesh, operands_of(heightfield), lights, view, options


def by_command(command, monkeypatch):
    """Run a command of the page, and return the arguments that it passes to ``shade``."""
    calls = []

    def shade(mesh, heightfield, lights, view, **options):
        options.pop("progress")
        settings = {name: value for name, value in options.items() if value is not None}
        calls.append((mesh, operands_of(heightfield), lights, view, settings))
        raise InterruptedError

    monkeypatch.setattr(wd, "shade", shade)
    cli.main(shlex.split(command)[1:])
    (call,) = calls
    return call


@pytest.mark.usefixtures("recorded")
def test_python_and_command_line_have_the_same_arguments(files, monkeypatch):
    saving = {"display": "clip", "exposure": 1.5, "background": (0.1, 0.1, 0.1)}
    texts = {}
    for _, made in scenes(files):
        for scene in made:
            placed = scene.placed((1.0, 2.0, 3.0), 2.0)
            texts[placed.python(VIEW, 0.1, saving)] = placed.command(VIEW, 0.1, saving)
    assert len(texts) > 100
    for lines, command in texts.items():
        assert by_python(lines) == by_command(command, monkeypatch), command


def test_a_new_option_of_pictures_appears_in_python_lines_and_in_the_command(monkeypatch):
    def described(owner):
        options = describe(owner)
        if owner is not viewer_controls.PictureSettings:
            return options
        sparkle = Option("sparkle", "number", 0.5, "Strength of a probe.", ge=0.0, le=2.0)
        return options | {"sparkle": sparkle, "glitter": Option("glitter", "flag", default=True, help="Another probe.")}

    for module in (viewer_controls, page_calls):
        monkeypatch.setattr(module, "describe", described)
    values = checked(controls(), {"sparkle": 1.5, "glitter": False})
    scene = Scene.of(values, NamedFiles())
    assert (scene.shading["sparkle"], scene.shading["glitter"]) == (1.5, False)
    assert "    sparkle=1.5,\n    glitter=False,\n" in scene.python(VIEW, 0.1, {})
    assert " --sparkle 1.5 --no-glitter " in scene.command(VIEW, 0.1, {})
    assert "sparkle" not in scene.of(checked(controls(), {"sparkle": 0.5}), NamedFiles()).shading


def test_a_scene_has_a_light_or_an_environment_or_both(files):
    scene = Scene.of(checked(files.controls, {"light": "point"}), files).placed((0.0, 0.0, 0.0), 1.0)
    light = scene.light.make()
    assert light.power == pytest.approx(1e4 * np.dot(light.position, light.position))
    words = scene.command(VIEW, 0.1, {"background": (0, 0, 0)}).split()
    assert {"--light", "--environment", "--environment-behind"} < set(words)
    assert "--background" not in words
    assert scene.at(None).shading["shadows"] is False
    values = VALUES | {"light": "none"}
    with pytest.raises(ValueError, match="there is no light") as error:
        Scene.of(values, NamedFiles())
    assert spelled(error.value, word(controls(), values)) == (
        "there is no light: select a light, or an environment, which requires coherence = averaged"
    )


@pytest.mark.parametrize("values", [{}, {"coherence": "source"}])
def test_grating_maps_of_the_command_line_are_part_of_scene_python_lines_and_command(values, monkeypatch, tmp_path):
    """The viewer's renderer must have the grating map and coherence of the command line.

    So must the lines of Python and the command that the viewer prints to reproduce its picture.
    """
    Image.fromarray(np.array([[0, 64], [128, 255]], dtype=np.uint8)).save(tmp_path / "turn.png")
    path = str(tmp_path / "turn.png")
    dots = (("turn_deg", (path, 0.0, 90.0)), ("pitch_scale", 1.25))
    first = checked(
        controls(), {"mesh": "card", "surface": "bumps", "azimuth_deg": 10.0, "elevation_deg": 20.0} | values
    )
    scene = Scene.of(first, NamedFiles(dots=dots))
    made = scene.surface.make()
    np.testing.assert_allclose(made.turn_deg, 90.0 * np.array([[0, 64], [128, 255]]) / 255.0)
    assert scene.shading["coherence"].kind == values.get("coherence", "averaged")
    _, by_lines, _, _, options = by_python(scene.python(VIEW, 0.1, {}))
    _, by_words, _, _, settings = by_command(scene.command(VIEW, 0.1, {}), monkeypatch)
    for other in (by_lines, by_words):
        assert repr(other) == repr(made)
        np.testing.assert_array_equal(other.turn_deg, made.turn_deg)
        np.testing.assert_array_equal(other.cell.heights_um, made.cell.heights_um)
    assert options["coherence"] == settings["coherence"] == scene.shading["coherence"]
    objects = SceneObjects(device=wp.get_device("cpu"), threads=2)
    view = wd.View((0.0, 1.0, 3.0), (0.0, 0.0, 0.0), width=12, height=9)
    renderer = objects.renderer(scene, view, refine=False, report=lambda: None)
    monkeypatch.undo()
    expected = wd.Renderer(
        scene.mesh.make(), made, [scene.light.make()], view, refine=False, tolerance=scene.tolerance, **scene.shading
    )
    renderer.draw([scene.light.make()], view)
    expected.draw([scene.light.make()], view)
    np.testing.assert_array_equal(renderer.image().xyz, expected.image().xyz)
    assert renderer.image().xyz.max() > 0.0


def test_a_clear_sky_needs_no_file():
    sun = {"sun_azimuth_deg": 90.0, "sun_elevation_deg": 30.0, "environment_ground_albedo": 0.5, "light": "none"}
    values = VALUES | {"environment": "clear sky", "environment_scale": 2.0} | sun
    scene = Scene.of(values, NamedFiles())
    assert str(scene.sky) == "wd.Environment.clear_sky((0.8660254, 0.5, 0.0), ground_albedo=0.5, scale=2.0)"
    words = scene.command(VIEW, 0.1, {})
    assert "--environment clear-sky:sun_direction=0.8660254x0.5x0.0,ground_albedo=0.5 --environment-scale 2.0" in words
    assert Scene.of(VALUES, NamedFiles()).sky is None


def test_python_lines_and_the_command_describe_the_scene_that_the_viewer_renders():
    scene = Scene.of(VALUES | {"coherence": "source", "masking": False, "material": "mirror"}, NamedFiles())
    _, _, lights, view, options = by_python(scene.python(VIEW, 0.5, {}))
    assert (lights, view) == ([scene.light.make()], VIEW)
    assert options == {
        "tolerance": 0.5, "coherence": wd.Coherence("source", angular_diameter_deg=0.53), "ior": np.inf,
        "masking": False, "pigment": 0.05,
    }  # fmt: skip
    words = scene.command(VIEW, 0.5, {"display": "clip"}).split()
    assert words[:5] == ["warpdiff", "render", "disc", "--heightfield", "blazed:period_um=2.0,depth_um=0.25"]
    assert words[words.index("--ior") + 1] == "inf"
    assert words[words.index("--coherence") + 1] == "source"
    assert {"--no-masking", "--display"} < set(words)
    # With ``energy="normalised"`` the library applies no masking (shadowing between grooves). The scene therefore has
    # no option ``masking``.
    scene = Scene.of(VALUES | {"energy": "normalised", "masking": False}, NamedFiles())
    assert dict(scene.options).keys() == {"coherence", "energy", "pigment"}
    words = scene.command(VIEW, 0.5, {}).split()
    assert words[words.index("--energy") + 1] == "normalised"


def test_lights_of_a_scene_are_directional_or_points_and_have_a_size():
    wide = Scene.of(VALUES | {"light_diameter_deg": 2.0}, NamedFiles())
    assert wide.placed((1.0, 2.0, 3.0), 2.0) is wide
    assert wide.light.make().angular_diameter_deg == 2.0
    words = wide.command(VIEW, 0.5, {}).split()
    assert words[words.index("--light") + 1].endswith(",angular_diameter_deg=2.0")
    near = Scene.of(VALUES | {"light": "point", "distance": 3.0, "illuminant": "A"}, NamedFiles())
    light = near.placed((1.0, 2.0, 3.0), 2.0).light.make()
    away = np.subtract(light.position, (1.0, 2.0, 3.0))
    np.testing.assert_allclose(away, 6.0 * np.array(wide.light.make().to_light), atol=1e-5)
    assert (light.power, light.illuminant) == (36.0, "A")
    words = near.placed((1.0, 2.0, 3.0), 2.0).command(VIEW, 0.5, {}).split()
    position = "x".join(map(str, light.position))
    assert words[words.index("--light") + 1] == f"point:position={position},illuminant=A,power=36.0"


def test_python_lines_and_the_command_name_the_metal_of_a_scene():
    scene = Scene.of(VALUES | {"material": "Au", "ior": 2.0}, NamedFiles())
    assert scene.shading["material"] == wd.Material.metal("Au")
    assert "material=wd.Material.metal('Au')" in scene.python(VIEW, 0.5, {})
    words = scene.command(VIEW, 0.5, {}).split()
    assert words[words.index("--material") + 1] == "Au"
    assert "--ior" not in words


def test_a_call_as_python_text_gives_the_same_object_as_its_execution():
    call = Call("rotated", (1,), (), Call.of("HeightField", ((0.0, 0.1),), 0.5))
    assert str(call) == "wd.HeightField(((0.0, 0.1),), 0.5).rotated(1)"
    np.testing.assert_array_equal(call.make().heights_um, eval(str(call)).heights_um)  # noqa: S307 (the tested text)
