"""The viewer's page in a real browser; see ``make test-browser`` for the requirements.

The tests operate the page's controls, and compare the pixels of its canvas. A plan states how colours are computed: the
method, the number of wavelengths, the number of series terms and so on.
"""

import base64
import io
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image

import warpdiff as wd
from warpdiff.apps import cli

sync_api = pytest.importorskip("playwright.sync_api", reason="make test-browser installs Playwright")

pytestmark = pytest.mark.browser
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
FLAGS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
]
# Time limit of each step of a test in milliseconds. It is long because test machines may be busy.
WAIT_MS = 240_000
# Size of the browser window in pixels. Next to the panel of controls, 320 × 240 pixels remain for the picture.
SMALL = {"width": 640, "height": 240}


class Viewer:
    """A viewer server in a separate process."""

    def __init__(self, *arguments, cache, port=0):
        environment = os.environ | {"WARPDIFF_CACHE_DIR": str(cache)}
        command = [sys.executable, "-m", "warpdiff", "view", "--no-browser", "--port", str(port), *map(str, arguments)]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment, text=True
        )
        line = self.process.stdout.readline()
        match = re.match(r"(http://\S+:(\d+)/\S*)", line)
        assert match, (line, self.process.stderr.read())
        self.url, self.port = match[1], int(match[2])

    def end(self):
        """Interrupt the server, and return its error output."""
        self.process.send_signal(signal.SIGINT)
        error = self.process.communicate(timeout=30)[1]
        assert self.process.returncode == 130, error
        return error


@pytest.fixture(scope="module", autouse=True)
def _default_interruption():
    """Give SIGINT Python's default handler during the test.

    Programs such as nohup ignore SIGINT, and a server would inherit this setting and could not be interrupted.
    """
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def served(cache):
    """Return a function that starts servers. Servers that still run after the test are killed."""
    made = []

    def begin(*arguments, **options):
        made.append(Viewer(*arguments, cache=cache, **options))
        return made[-1]

    yield begin
    for viewer in made:
        viewer.process.kill()


@pytest.fixture(scope="module")
def waves(tmp_path_factory):
    path = tmp_path_factory.mktemp("heights") / "waves.npy"
    np.save(path, 0.1 * np.sin(2.0 * np.pi * np.arange(40) / 20)[None, :] * np.ones((40, 1)))
    return path


@pytest.fixture(scope="module")
def viewer(cache, waves):
    made = Viewer("--heightfield", waves, "--pitch-um", "0.05", cache=cache)
    yield made
    errors = made.end()
    assert "Traceback" not in errors, errors


@pytest.fixture(scope="module")
def chromium():
    if CHROMIUM is None:
        pytest.fail("there is no Chromium: install it (Debian: apt-get install chromium), or name it in CHROMIUM")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


class Page:
    """A browser page, with the lines of its console."""

    def __init__(self, browser, url, size=SMALL):
        self.context = browser.new_context(viewport=size)
        self.page = self.context.new_page()
        self.console = []
        self.page.on("console", lambda message: self.console.append(message.text))
        self.page.on("pageerror", lambda error: self.console.append(str(error)))
        self.page.goto(url)

    def rest(self):
        """Wait until the page shows the final picture of its settings, and return the pixels."""
        self.page.wait_for_function(
            "() => { const c = document.getElementById('picture').dataset;"
            "return c.error || (c.last === 'true' && c.generation === c.requested); }",
            timeout=WAIT_MS,
        )
        assert not self.page.eval_on_selector("#picture", "c => c.dataset.error")
        return self.pixels()

    def pixels(self):
        """Return the pixels of the canvas that shows the picture, (height, width, 3)."""
        url = self.page.eval_on_selector("#picture", "c => c.toDataURL('image/png')")
        image = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2])))
        return np.asarray(image.convert("RGB")).astype(int)

    def set(self, name, value):
        """Set a control of the page as a user does."""
        field = self.page.locator(f"#set-{name}")
        kind = field.evaluate("field => field.type")
        if kind == "checkbox":
            field.set_checked(value)
        elif kind == "select-one":
            field.select_option(label=value)
        else:
            field.fill(str(value))
            field.press("Enter")
            field.evaluate("field => field.blur()")

    def drag(self, dx, dy, button="left", steps=4):
        box = self.page.locator("#stage").bounding_box()
        x, y = box["x"] + 20, box["y"] + 20
        self.page.mouse.move(x, y)
        self.page.mouse.down(button=button)
        self.page.mouse.move(x + dx, y + dy, steps=steps)
        self.page.mouse.up(button=button)

    def close(self):
        self.context.close()
        assert not self.console


@pytest.fixture
def page(chromium, viewer):
    made = Page(chromium, viewer.url)
    # The page opens with the first file of the command line, so the mesh and surface of the tests are selected here.
    for name, value in {"mesh": "tube", "surface": "nano-fingers", "height": "240", "tolerance": "1e-1"}.items():
        made.set(name, value)
    yield made
    made.close()


def changed(pixels, before):
    return np.mean(np.abs(pixels - before).max(axis=2) > 8)


def test_the_picture_follows_the_settings_and_is_restored_with_them(page):
    # With automatic exposure, materials that differ only in brightness would have the same picture. The exposure is
    # therefore locked.
    page.set("lock_exposure", True)
    first = page.rest()
    assert first.shape == (240, 320, 3)
    assert first.std() > 10.0
    for name, value, back in (
        ("azimuth_deg", -60, 150),
        ("sigma_um", 2, 16.25),
        ("surface", "blazed", "nano-fingers"),
        ("surface", "waves.npy", "nano-fingers"),
        ("mesh", "disc", "tube"),
        ("along", "world x", "around the body"),
        ("material", "gold", "dielectric"),
        ("pigment", 1.5, 0.05),
        ("illuminant", "incandescent, A", "daylight, D65"),
        ("exposure_stops", -2, 0),
        ("display", "clipped", "ACES 2.0"),
    ):
        page.set(name, value)
        pixels = page.rest()
        # The pigment is the strength of the base colour of a mesh. The test mesh has no base colour, so that the
        # control "pigment" must not change its picture.
        assert (changed(pixels, first) > 2e-3) == (name != "pigment"), name
        page.set(name, back)
        np.testing.assert_array_equal(page.rest(), first, err_msg=name)


def test_the_camera_orbits_pans_and_zooms_and_is_framed_again(page):
    first = page.rest()
    for move in (
        lambda: page.drag(50, 10),
        lambda: page.drag(30, 20, button="right"),
        lambda: page.page.mouse.wheel(0, -200),
        lambda: page.page.locator("#picture").press("ArrowLeft"),
    ):
        before = page.rest()
        move()
        assert changed(page.rest(), before) > 0.01
    page.page.locator("#reset").click()
    np.testing.assert_array_equal(page.rest(), first)


def test_the_light_is_dragged_by_its_handle(page):
    before = page.rest()
    azimuth = page.page.locator("#set-azimuth_deg").input_value()
    box = page.page.locator("#light").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x - 60, y + 10, steps=5)
    page.page.mouse.up()
    pixels = page.rest()
    assert changed(pixels, before) > 0.01
    assert page.page.locator("#set-azimuth_deg").input_value() != azimuth
    box = page.page.locator("#light").bounding_box()
    assert np.hypot(box["x"] + box["width"] / 2 - (x - 60), box["y"] + box["height"] / 2 - (y + 10)) < 2.0


def test_the_final_picture_equals_that_of_its_python_lines(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page.set("sigma_um", 8)
    page.set("tolerance", "3e-2")
    page.drag(-40, 15)
    pixels = page.rest()
    lines = page.page.locator("#python").text_content()
    made = {}
    exec(lines, made)  # noqa: S102 (the viewer's own lines)
    saved = np.asarray(Image.open("picture.png").convert("RGB")).astype(int)
    assert np.abs(pixels - saved).max() <= 1
    # The page shows Python lines that draw its picture by a `Renderer`. The function ``shade`` must draw the same
    # picture if it uses the plan (method, number of wavelengths and so on) of this renderer.
    single = re.sub(
        r"tolerance=[^,]+,|coherence=.*\n", "", lines.replace("renderer = wd.Renderer(", "image = wd.shade(")
    )
    single = single.replace("\n)", "\n    plan=plan,\n)").replace("renderer.image()", "image")
    exec(single, {"plan": made["renderer"].plan})  # noqa: S102
    saved = np.asarray(Image.open("picture.png").convert("RGB")).astype(int)
    assert np.abs(pixels - saved).max() <= 1
    # The page also shows a command line that draws its picture. This command makes its own plan (method, number of
    # wavelengths and so on), for the directions of this one picture. Its pixels therefore agree only approximately with
    # those of the page.
    command = shlex.split(page.page.locator("#command").text_content())
    assert command[:2] == ["warpdiff", "render"]
    assert cli.main(command[1:]) == 0
    saved = np.asarray(Image.open("picture.png").convert("RGB")).astype(int)
    assert saved.shape == pixels.shape
    assert np.percentile(np.abs(pixels - saved), 99.0) <= 8


def test_pictures_are_saved(page):
    pixels = page.rest()
    with page.page.expect_download() as download:
        page.page.locator("#png").click()
    saved = np.asarray(Image.open(download.value.path()).convert("RGB")).astype(int)
    np.testing.assert_allclose(saved, pixels, atol=2)
    with page.page.expect_download() as download:
        page.page.locator("#exr").click()
    assert download.value.suggested_filename == "warpdiff.exr"
    assert download.value.path().read_bytes()[:4] == b"\x76\x2f\x31\x01"


def test_angles_and_the_map_belong_to_the_clicked_position(page):
    page.rest()
    page.page.wait_for_function("() => document.getElementById('map').dataset.generation", timeout=WAIT_MS)
    first = page.page.locator("#angles").text_content()
    box = page.page.locator("#stage").bounding_box()
    page.page.mouse.click(box["x"] + 80, box["y"] + 130)
    page.rest()
    page.page.wait_for_function(
        "first => document.getElementById('angles').textContent !== first", arg=first, timeout=WAIT_MS
    )
    assert re.search(r"light: θ \d+\.\d°, φ -?\d+\.\d°\s*view: θ \d", page.page.locator("#angles").text_content())


def test_a_reload_shows_the_same(page):
    page.set("azimuth_deg", 20)
    page.drag(40, 0)
    before = page.rest()
    page.page.reload()
    np.testing.assert_array_equal(page.rest(), before)


def test_an_error_of_one_page_does_not_reach_another_page(page, chromium, viewer):
    other = Page(chromium, viewer.url)
    for name, value in {"mesh": "disc", "surface": "nano-fingers", "height": "240", "tolerance": "1e-1"}.items():
        other.set(name, value)
    first, second = page.rest(), other.rest()
    assert changed(first, second) > 0.1
    # Bumps with this width are wider than their spacing, so the page shows an error instead of a picture.
    other.set("surface", "bumps")
    other.set("bumps_width_um", 2)
    other.page.wait_for_function("() => document.getElementById('picture').dataset.error", timeout=WAIT_MS)
    assert "spacing along x must be at least width along x = 2" in other.page.locator("#notice").text_content()
    page.set("azimuth_deg", -20)
    assert changed(page.rest(), first) > 2e-3
    other.set("surface", "nano-fingers")
    np.testing.assert_array_equal(other.rest(), second)
    other.close()


def test_an_environment_illuminates_the_mesh_and_is_its_background(chromium, served, waves, tmp_path):
    import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)

    radiance = np.full((8, 16, 3), 0.3, dtype=np.float32)
    radiance[:, 8:] = 0.6, 0.4, 0.3
    out = oiio.ImageOutput.create(str(tmp_path / "sky.hdr"))
    out.open(str(tmp_path / "sky.hdr"), oiio.ImageSpec(16, 8, 3, "float"))
    out.write_image(radiance)
    out.close()
    wd.meshes.tube().export(tmp_path / "body.obj")
    files = tmp_path / "body.obj", "--heightfield", waves, "--pitch-um", "0.05", "--environment", tmp_path / "sky.hdr"
    server = served(*files)
    made = Page(chromium, server.url)
    simple = {
        "height": "240", "tolerance": "1e-1", "environment_directions": "256", "shadows": False,
        "material": "perfect mirror",
    }  # fmt: skip
    for name, value in simple.items():
        made.set(name, value)
    first = made.rest()
    assert not made.page.locator("#light").is_visible()
    # The sky behind the mesh has different colours on the left and on the right.
    assert np.ptp(first[0], axis=0)[0] > 10
    made.set("environment_rotation_deg", 150)
    assert changed(made.rest(), first) > 0.2
    made.set("environment_rotation_deg", 0)
    np.testing.assert_array_equal(made.rest(), first)
    made.set("environment_behind", False)
    plain = made.rest()
    assert np.ptp(plain[0]) == 0
    made.set("light", "directional")
    illuminated = made.rest()
    assert changed(illuminated, plain) > 0.05
    assert made.page.locator("#light").is_visible()
    assert "DirectionalLight" in made.page.locator("#python").text_content()
    made.set("environment", "clear sky with a sun")
    assert not made.page.locator("#set-environment_rotation_deg").is_visible()
    outdoors = made.rest()
    made.set("sun_elevation_deg", 20)
    assert changed(made.rest(), outdoors) > 0.01
    assert "wd.Environment.clear_sky((" in made.page.locator("#python").text_content()
    made.set("environment", "none")
    assert not made.page.locator("#set-environment_scale").is_visible()
    assert changed(made.rest(), illuminated) > 0.01
    assert "--environment" not in made.page.locator("#command").text_content()
    made.set("light", "none")
    made.page.wait_for_function("() => document.getElementById('picture').dataset.error", timeout=WAIT_MS)
    assert "there is no light" in made.page.locator("#notice").text_content()
    made.close()
    server.end()


def test_the_page_reconnects_to_a_restarted_server(chromium, served):
    server = served()
    made = Page(chromium, server.url)
    for name, value in {"mesh": "tube", "height": "240", "tolerance": "1e-1"}.items():
        made.set(name, value)
    before = made.rest()
    server.end()
    made.page.wait_for_function("() => !document.body.dataset.connected", timeout=WAIT_MS)
    assert "Disconnected" in made.page.locator("#notice").text_content()
    server = served(port=server.port)
    made.page.wait_for_function("() => document.body.dataset.connected", timeout=WAIT_MS)
    made.set("azimuth_deg", 10)
    assert changed(made.rest(), before) > 0.01
    server.end()
    # While no server runs, the browser logs refused connections. These lines are removed from the console, which must
    # otherwise be empty.
    made.console = [line for line in made.console if "ERR_CONNECTION_REFUSED" not in line]
    made.close()


def test_from_other_machines_the_page_requires_its_token(chromium, served):
    server = served("--host", "0.0.0.0")  # noqa: S104 (the test needs an open address)
    made = Page(chromium, f"http://127.0.0.1:{server.port}/?{server.url.partition('?')[2]}")
    made.page.wait_for_function("() => document.getElementById('picture').dataset.count", timeout=WAIT_MS)
    made.close()
    server.end()


def test_touch_orbits_and_pinches(chromium, viewer):
    context = chromium.new_context(viewport=SMALL, has_touch=True)
    page = context.new_page()
    page.goto(viewer.url)
    page.wait_for_function("() => document.getElementById('picture').dataset.count", timeout=WAIT_MS)
    camera = "() => JSON.parse(sessionStorage.getItem('warpdiff view')).camera"
    session = context.new_cdp_session(page)

    def touch(kind, *points):
        session.send(
            "Input.dispatchTouchEvent",
            {"type": kind, "touchPoints": [{"x": x, "y": y, "id": id_} for id_, (x, y) in enumerate(points)]},
        )

    before = page.evaluate(camera)
    touch("touchStart", (60, 60))
    for k in range(5):
        touch("touchMove", (60 + 8 * k, 60))
    touch("touchEnd")
    time.sleep(0.3)
    orbited = page.evaluate(camera)
    assert not np.allclose(orbited["eye"], before["eye"])
    np.testing.assert_allclose(orbited["target"], before["target"])
    touch("touchStart", (60, 60), (120, 60))
    for k in range(5):
        touch("touchMove", (60 - 4 * k, 60), (120 + 4 * k, 60))
    touch("touchEnd")
    time.sleep(0.3)
    pinched = page.evaluate(camera)
    apart = [np.linalg.norm(np.subtract(camera["eye"], camera["target"])) for camera in (orbited, pinched)]
    assert apart[1] < 0.8 * apart[0]
    context.close()


def test_stored_values_that_are_no_longer_valid_are_dropped(chromium, viewer):
    context = chromium.new_context(viewport=SMALL)
    page = context.new_page()
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    stored = {"values": {"mesh": "file 7", "gone": 3, "sigma_um": "x"}, "camera": None, "generation": 5}
    page.add_init_script(f"sessionStorage.setItem('warpdiff view', {json.dumps(json.dumps(stored))})")
    page.goto(viewer.url)
    page.wait_for_function("() => document.getElementById('picture').dataset.count", timeout=WAIT_MS)
    assert not errors
    assert wd.Coherence().sigma_um == float(page.locator("#set-sigma_um").input_value())
    context.close()
