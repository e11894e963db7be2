"""The exported page in headless Chromium; see ``make test-browser`` for the requirements.

Meshes, canvases and numbers of frames are small, and each call renders few frames, because software WebGL is slow.
"""

import base64
import io
import os
import shutil

import numpy as np
import PIL.Image
import pytest

import warpdiff as wd
from warpdiff.optics import colorimetry

sync_api = pytest.importorskip("playwright.sync_api", reason="make test-browser installs Playwright")

pytestmark = pytest.mark.browser
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
# Chromium runs without a graphics device and without network.
FLAGS = (
    "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run "
    "--disable-background-networking --disable-component-update --disable-sync"
)
WIDTH, HEIGHT, FRAMES, AT_ONCE = 96, 72, 1024, 16
# Time limit of each step of a test in milliseconds. It is long because test machines may be busy.
WAIT_MS = 240_000
WINDOW = wd.Coherence(sigma_um=8.0)
VIEWS = [
    wd.View((0.4, 1.2, 1.5), (0.4, 0.05, 0.25), fov_y_deg=22, width=WIDTH, height=HEIGHT),
    wd.View((-1.2, 1.0, 1.0), (-0.6, 0.1, 0.0), fov_y_deg=25, width=WIDTH, height=HEIGHT),
    wd.View((0.9, 1.4, -0.9), (0.5, 0.1, 0.1), fov_y_deg=20, width=WIDTH, height=HEIGHT),
]
LIGHTS = [(0.3, 1.0, 0.4), (-0.4, 1.0, 0.1), (0.2, 1.0, -0.6)]
PIGMENT = 0.1


@pytest.fixture(scope="module")
def skin():
    return wd.gratings.fingers(size_um=25.6, pitch_um=0.08)


@pytest.fixture(scope="module")
def body():
    return wd.meshes.snake(scale_rows=11, ventrals=40, segments=3)


@pytest.fixture(scope="module")
def page(skin, body, tmp_path_factory):
    lobes = wd.bake(skin, coherence=WINDOW, delta_e=2.0)
    light = wd.DirectionalLight(LIGHTS[0])
    target = tmp_path_factory.mktemp("page") / "snake.html"
    return wd.export_html(target, body, lobes, light, VIEWS[0], pigment=PIGMENT, title="A <snake> & its skin")


@pytest.fixture(scope="module")
def chromium():
    with sync_api.sync_playwright() as playwright:
        yield playwright.chromium


def opened(chromium, path, *more):
    """Open a page. Return the browser, the opened page, and a list to which console messages are added."""
    browser = chromium.launch(executable_path=CHROMIUM, args=[*FLAGS.split(), *more])
    shown = browser.new_page(viewport={"width": 240, "height": 200})
    shown.set_default_timeout(WAIT_MS)
    said = []
    shown.on("console", lambda message: said.append((message.type, message.text)))
    shown.on("pageerror", lambda error: said.append(("error", str(error))))
    shown.goto(path.as_uri())
    return browser, shown, said


@pytest.fixture(scope="module")
def shown(page, chromium):
    """Return the exported page, opened in a browser, with a list of its console messages as ``said``."""
    browser, shown, said = opened(chromium, page)
    shown.evaluate("warpdiff.ready")
    shown.said = said
    yield shown
    browser.close()


RENDER = """(wanted) => {
    const { width, height, xyz } = warpdiff.render(wanted), bytes = new Uint8Array(xyz.buffer);
    let text = "";
    for (let k = 0; k < bytes.length; k += 32768) text += String.fromCharCode(...bytes.subarray(k, k + 32768));
    return [width, height, btoa(text)];
}"""


def render(shown, frames, **wanted):
    """Let the page render ``frames`` frames. Return XYZ and coverage of their mean picture, with row 0 at the top."""
    done = 0
    while done < frames:
        width, height, text = shown.evaluate(
            RENDER, {**wanted, "frames": min(AT_ONCE, frames - done), "more": done > 0}
        )
        done += AT_ONCE
    return np.frombuffer(base64.b64decode(text), dtype=np.float32).reshape(height, width, 4)[::-1]


def of_view(view, to_light):
    camera = {"eye": view.eye, "target": view.target, "up": view.up, "fov_y_deg": view.fov_y_deg}
    lights = [{"to_light": to_light, "power": 1.0}]
    return {"view": camera, "lights": lights, "width": view.width, "height": view.height}


def canvas(shown):
    """Return the pixels of the page's canvas, scaled to 0 to 1."""
    text = shown.evaluate("document.getElementById('canvas').toDataURL('image/png')")
    with PIL.Image.open(io.BytesIO(base64.b64decode(text.partition(",")[2]))) as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.float64) / 255.0


def colour_difference(shown, other):
    xyz = (colorimetry.rgb_to_xyz(colorimetry.srgb_decode(each)) for each in (shown, other))
    return colorimetry.colour_difference(*xyz)


@pytest.mark.parametrize("index", range(3))
def test_the_final_picture_equals_that_of_shade(shown, skin, body, index):
    """The page must show the picture of ``shade``, with a small median and 99th percentile of ΔE2000.

    Colours are compared in pixels whose rays all hit the mesh, at illuminated points.
    """
    view, to_light = VIEWS[index], LIGHTS[index]
    light = wd.DirectionalLight(to_light)
    exact = wd.shade(body, skin, light, view, coherence=WINDOW, pigment=PIGMENT, tolerance=3e-2)
    larger = wd.View(view.eye, view.target, fov_y_deg=view.fov_y_deg, width=4 * WIDTH, height=4 * HEIGHT)
    fine = wd.shade(body, skin, light, larger, coherence=WINDOW, pigment=0.0, tolerance=0.3, refine=False)
    interior = (fine.mask & fine.illuminated).reshape(HEIGHT, 4, WIDTH, 4).all(axis=(1, 3))
    assert interior.sum() > 1000
    result = render(shown, FRAMES, exposure=exact.auto_exposure, **of_view(view, to_light))
    differences = colour_difference(canvas(shown), exact.display()[..., :3])[interior]
    assert np.percentile(differences, 99.0) <= 3.0
    assert np.median(differences) <= 0.75
    # The picture of ``shade`` has a tolerance of 3 %, so the sum of Y may differ by this much.
    assert result[..., 1][interior].sum() == pytest.approx(exact.xyz[..., 1][interior].sum(), rel=0.03)
    assert np.abs(result[..., 3] - exact.coverage).mean() < 0.01


def test_a_point_light_equals_that_of_shade(shown, skin, body):
    """Under a point light, the page must show the picture of ``shade``, up to noise.

    The page renders only a few frames, so that its pixels are noisy. The test therefore limits the median of the colour
    differences, and compares the sums of Y over the pixels.
    """
    view, place = VIEWS[1], (-0.2, 1.2, 1.2)
    options = {"coherence": WINDOW, "pigment": PIGMENT, "tolerance": 3e-2}
    exact = wd.shade(body, skin, wd.PointLight(place, power=2.0), view, **options)
    request = of_view(view, place) | {"lights": [{"position": place, "power": 2.0}]}
    result = render(shown, 64, exposure=exact.auto_exposure, **request)
    pixels = canvas(shown)
    inside = (exact.coverage > 0.999) & exact.illuminated
    dark = (exact.coverage > 0.999) & ~exact.illuminated
    assert min(inside.sum(), 20 * dark.sum()) > 1000
    assert np.median(colour_difference(pixels, exact.display()[..., :3])[inside]) <= 1.0
    assert result[..., 1][inside].sum() == pytest.approx(exact.xyz[..., 1][inside].sum(), rel=0.03)
    assert np.median(result[..., 1][dark]) < 0.05 * np.median(result[..., 1][inside])
    # Under a directional light that is as bright in the picture centre, the picture must be clearly different.
    # Otherwise the test could not detect a page that ignores the position of the point light.
    far = of_view(view, place) | {"lights": [{"to_light": place, "power": 2.0 / np.dot(place, place)}]}
    render(shown, 16, **far)
    assert np.median(colour_difference(canvas(shown), exact.display()[..., :3])[inside]) > 3.0


def test_pictures_are_restored_with_light_view_and_exposure(shown):
    first = of_view(VIEWS[0], LIGHTS[0])
    before = render(shown, 2, exposure=1e5, **first)
    pixels = canvas(shown)
    for changed in (of_view(VIEWS[1], LIGHTS[0]), of_view(VIEWS[0], LIGHTS[1])):
        assert not np.array_equal(render(shown, 2, **changed), before)
    render(shown, 2, exposure=4e5, **first)
    assert canvas(shown).mean() > pixels.mean()
    assert np.array_equal(render(shown, 2, exposure=1e5, **first), before)
    assert np.array_equal(canvas(shown), pixels)


STATE = "structuredClone({ ...warpdiff.state })"


def distance(state):
    return np.linalg.norm(np.subtract(state["view"]["eye"], state["view"]["target"]))


def test_dragging_rotates_body_and_light(shown):
    """The mouse must rotate the mesh and the light by dragging, change the distance by its wheel, and move the slider.

    The slider changes the exposure, and the reset button returns to the first view.
    """
    shown.evaluate("warpdiff.render({ width: 64, height: 48, frames: 1 }).width")
    state = shown.evaluate(STATE)

    def drag(selector, by):
        box = shown.locator(selector).bounding_box()
        x, y = box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0
        shown.mouse.move(x, y)
        shown.mouse.down()
        shown.mouse.move(x + by[0], y + by[1])
        shown.mouse.up()
        return shown.evaluate(STATE)

    rotated = drag("#canvas", (15, 6))
    assert rotated["view"]["eye"] != state["view"]["eye"]
    assert distance(rotated) == pytest.approx(distance(state))
    illuminated = drag("#pad", (20, -12))
    assert illuminated["lights"] != state["lights"]
    shown.mouse.move(120, 40)
    shown.mouse.wheel(0, -60)
    shown.wait_for_function(
        f"Math.hypot(...warpdiff.state.view.eye) !== {np.linalg.norm(illuminated['view']['eye'])!r}"
    )
    near = shown.evaluate(STATE)
    assert distance(near) < distance(illuminated)
    shown.locator("#stops").fill("1")
    assert shown.evaluate("warpdiff.state.exposure") == pytest.approx(2.0 * near["exposure"])
    shown.wait_for_function("warpdiff.state.frames >= 3")
    shown.locator("#reset").click()
    assert shown.evaluate("warpdiff.state.view.eye") == list(VIEWS[0].eye)
    shown.evaluate("warpdiff.render({ width: 64, height: 48, frames: 1 }).width")


def test_a_page_is_within_its_size_limit_and_complete(shown, page):
    assert shown.evaluate("warpdiff.fetches") <= 64
    assert shown.title() == "A <snake> & its skin"
    text = page.read_text(encoding="utf-8")
    assert "http://" not in text
    assert "https://" not in text
    assert "src=" not in text
    assert "Resolution in (u, v): 0.0039" in shown.locator("#description").inner_text()


def test_the_console_stays_empty(shown):
    # Chromium warns when a script reads pixels from the graphics memory. Only the tests do this, not the page.
    assert not [each for each in shown.said if "GPU stall due to ReadPixels" not in each[1]]


def test_without_webgl_2_a_message_is_shown(page, chromium):
    browser, shown, _ = opened(chromium, page, "--disable-3d-apis")
    assert "This page needs WebGL 2, which this browser does not offer" in shown.locator("#failed").inner_text()
    assert shown.locator("#failed").is_visible()
    browser.close()


# At the edges of facets, pixels have large errors. The test therefore limits only the median error of the pixels and
# the error of the sum of XYZ over the pixels.
@pytest.mark.filterwarnings("ignore:.*of the pixels see more than")
@pytest.mark.parametrize(
    ("reflection", "material"), [({"ior": 2.0}, None), ({}, wd.Material.metal("Au"))], ids=["glass", "gold"]
)
def test_mirrored_textures_facets_and_two_lights_are_shown_as_by_shade(reflection, material, skin, chromium, tmp_path):
    """The page must render mirrored textures, facets and several lights as ``shade`` does.

    The other tests use none of these.
    """
    body = wd.meshes.tube(segments_along=24, segments_around=16)
    body.visual.uv[:, 0] *= -1.0
    view = wd.View((0.0, 2.0, 3.0), (0.0, 0.0, 0.0), fov_y_deg=8, width=64, height=48)
    lights = [
        wd.DirectionalLight((0.5, 1.0, 0.3)),
        wd.DirectionalLight((-0.5, 1.0, 0.2), power=0.5, angular_diameter_deg=4.0),
    ]
    lobes = wd.bake(skin, coherence=WINDOW, delta_e=4.0, material=material)
    options = {"smooth": False, "masking": False, **reflection}
    path = wd.export_html(tmp_path / "tube.html", body, lobes, lights, view, **options)
    with pytest.raises(ValueError, match=r"lights\[1\].position must be at least 1.1 radii of the mesh"):
        wd.export_html(tmp_path / "in.html", body, lobes, [lights[0], wd.PointLight((0, 0.1, 0))], view, **options)
    exact = wd.shade(body, skin, lights, view, coherence=WINDOW, tolerance=3e-2, material=material, **options)
    browser, shown, said = opened(chromium, path)
    shown.evaluate("warpdiff.ready")
    result = render(shown, 64, width=64, height=48)
    browser.close()
    assert not [each for each in said if "GPU stall due to ReadPixels" not in each[1]]
    inside = (exact.coverage > 0.999) & exact.illuminated
    of_light, of_page = exact.xyz[inside], result[..., :3][inside]
    assert np.median(np.linalg.norm(of_page - of_light, axis=1) / np.linalg.norm(of_light, axis=1)) < 0.05
    np.testing.assert_allclose(of_page.sum(axis=0), of_light.sum(axis=0), rtol=0.05)
