"""The command line as users run it: exit codes, files, messages and progress."""

import argparse
import functools
import os
import subprocess
import sys

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
import pytest
from conftest import slow, write_image

import warpdiff as wd
from warpdiff.apps import cli, cli_inputs, cli_progress
from warpdiff.core import disk_cache

BRDF = "brdf --heightfield blazed -o x.png"
SMALL = ["--tolerance", "0.1", "--sigma-um", "5"]


def run(line, *more):
    """Run a command line, given as a text and as further words that may contain spaces, and return its exit code."""
    return cli.main([*line.split(), *map(str, more)])


def test_render_writes_a_picture(tmp_path, capsys):
    target = tmp_path / "disc.exr"
    assert run("render disc --heightfield blazed --width 24 --height 16", *SMALL, "-o", target) == 0
    spec = oiio.ImageInput.open(str(target)).spec()
    assert (spec.width, spec.height) == (24, 16)
    out = capsys.readouterr().out
    assert str(target) in out
    assert "Low-rank basis" in out


def test_render_draws_a_mesh_file_with_a_height_file(tmp_path, fuze_path):
    heights = tmp_path / "h.npy"
    np.save(heights, 0.1 * np.sin(2.0 * np.pi * np.arange(32) / 32)[None, :] * np.ones((32, 1)))
    target = tmp_path / "fuze.png"
    line = "render --pitch-um 0.05 --width 20 --height 30 --up 0 0 1 --light 1 1 1 --light -1 1 1 --no-shadows"
    assert run(line, "--no-smooth", fuze_path, "--heightfield", heights, *SMALL, "-o", target) == 0
    pixels = oiio.ImageBuf(str(target)).get_pixels(oiio.FLOAT)
    assert 0.05 < pixels[..., 3].mean() < 0.9


def test_a_picture_under_a_sky_and_a_point_light_equals_that_of_the_library(tmp_path):
    polar, azimuth = (np.arange(8) + 0.5) / 8, (np.arange(16) + 0.5) / 16
    radiance = np.stack([*np.broadcast_arrays(polar[:, None], azimuth, 1.0 - polar[:, None])], axis=-1)
    write_image(tmp_path / "sky.exr", radiance.astype(np.float32))
    line = "render disc --heightfield blazed --tolerance 0.5 --sigma-um 1 --width 16 --height 12 --eye 0 1 3"
    line += " --target 0 0 0 --light point:position=1x2x1,power=3 --no-refine --environment-rotation-deg 40"
    line += " --environment-scale 2 --environment-directions 16"
    sky_file = ["--environment", tmp_path / "sky.exr"]
    assert run(line, *sky_file, "-o", tmp_path / "under.exr") == 0
    assert run(line, *sky_file, "--environment-behind", "-o", tmp_path / "under.png") == 0
    result = oiio.ImageBuf(str(tmp_path / "under.exr")).get_pixels(oiio.FLOAT)
    sky = wd.Environment(radiance, rotation_deg=40.0, scale=2.0, directions=16)
    view = wd.View((0, 1, 3), (0, 0, 0), fov_y_deg=40, width=16, height=12)
    lights = [wd.PointLight((1, 2, 1), power=3.0), sky]
    exact = wd.shade(
        wd.meshes.disc(), wd.gratings.blazed(2.0, 0.25), lights, view, coherence=wd.Coherence(sigma_um=1.0),
        tolerance=0.5, refine=False,
    )  # fmt: skip
    exact.save(tmp_path / "exact.exr")
    exact.save(tmp_path / "exact.png", background=sky.background(view) / np.float32(0.04))
    assert np.array_equal(result, oiio.ImageBuf(str(tmp_path / "exact.exr")).get_pixels(oiio.FLOAT))
    shown, same = (oiio.ImageBuf(str(tmp_path / name)).get_pixels() for name in ("under.png", "exact.png"))
    assert np.abs(shown - same).max() < 0.01


def test_a_sequence_is_written_and_resumed(tmp_path, capsys):
    folder, film = tmp_path / "turn", tmp_path / "turn.webp"
    line = "sequence disc:segments=16,rings=1 --heightfield blazed:period_um=2.5,depth_um=0.2 --width 24 --height 16"
    command = [*SMALL, "--count", 3, "-o", folder]
    assert run(line, *command, "--animation", film) == 0
    frames = {path: path.read_bytes() for path in folder.glob("frame_*.png")}
    assert len(frames) == 3
    assert film.is_file()
    assert "3 frames in" in capsys.readouterr().out
    last = sorted(frames)[-1]
    last.unlink()
    assert run(line, *command) == 0
    assert {path: path.read_bytes() for path in folder.glob("frame_*.png")} == frames
    assert run(line, *command, "--lights-stay") == 2
    assert "another sequence" in capsys.readouterr().err
    assert run(line, *command, "--light-to", 0, 1, 1, "--overwrite") == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [(["--lights-turn", "--turns", 0.5], lambda lights, view: wd.light_sweep(lights, view, turns=0.5, count=4)),
     (["--lights-stay"], lambda lights, view: wd.turntable(lights, view, count=4, lights_follow=False)),
     (["--light-to", 0, 1, 1], lambda lights, view: wd.light_sweep(lights, view, (0, 1, 1), count=4))],
)  # fmt: skip
def test_sequences_accept_every_kind_of_light(words, expected, monkeypatch, capsys):
    """The shots (lights and camera per frame) from the command line must equal those of the library's functions."""
    drawn = []
    monkeypatch.setattr(wd, "Renderer", lambda *_, **__: argparse.Namespace(plan="plan"))
    monkeypatch.setattr(wd, "sequence", lambda _, shots, *__, **___: drawn.extend(shots) or [])
    line = "sequence disc --heightfield blazed --count 4 -o turn --light point:position=0x2x1,power=3"
    line += " --light directional:to_light=0x1x0,angular_diameter_deg=4"
    sky = ["--environment", "clear-sky:sun_direction=0.0x1.0x1.0,ground_albedo=0.5", "--environment-scale", 2]
    lights = [wd.PointLight((0, 2, 1), power=3.0), wd.DirectionalLight((0, 1, 0), angular_diameter_deg=4.0)]
    if "--light-to" not in words:
        line += " " + " ".join(map(str, sky))
        lights.append(wd.Environment.clear_sky((0, 1, 1), ground_albedo=0.5, scale=2.0))
    assert run(line, *words) == 0
    shots = expected(lights, wd.View.fit(wd.meshes.disc(), turning="--lights-stay" in words))
    assert len(drawn) == 4
    for shot, same in zip(drawn, shots, strict=True):
        assert shot.view == same.view
        assert shot.lights[:2] == same.lights[:2]
        assert list(map(repr, shot.lights)) == list(map(repr, same.lights))
        for light, other in zip(shot.lights[2:], same.lights[2:], strict=True):
            assert np.array_equal(light.radiance_rgb, other.radiance_rgb)
            assert (light.rotation_deg, light.scale) == (other.rotation_deg, 2.0)
    for wrong, message in (
        ("clear-sky:sun_direction=0x-1x0", "sun_direction must be above the horizon"),
        ("clear-sky:sun=x", "sun must be a number"),
        ("clear-sky:height=3", "its parameters are sun_direction, sun, ground_albedo, scale, directions"),
        ("clear-sky --environment-rotation-deg 3", "--environment-rotation-deg is for files, got clear-sky: give its"),
    ):
        assert run(f"sequence disc --heightfield blazed -o turn --environment {wrong}") == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [["--port", "70000"], ["no.obj"], ["--heightfield", "no.png"], ["--host", "256.1.1.1"], ["--threads", "0"],
     ["--environment", "no.exr"], ["--environment", __file__], ["--pitch-um", "0.1"], ["--level", "1"]],
)  # fmt: skip
def test_a_viewer_that_cannot_start_reports_the_reason(arguments, monkeypatch, capsys):
    # The viewer's drawing thread would outlive the command and would draw during later tests. The method with which
    # this thread prepares its work is therefore replaced by a function that does nothing.
    monkeypatch.setattr("warpdiff.apps.viewer.session.Studio._prepare", lambda _: None)
    assert cli.main(["view", "--no-browser", *arguments]) in (1, 2)
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("warpdiff view:")
    assert "Traceback" not in error


def test_brdf_writes_a_map(tmp_path):
    target = tmp_path / "map.png"
    line = "brdf --heightfield sinusoidal:period_um=1.5,depth_um=0.1 --incidence-deg 20 --size 32"
    assert run(line, *SMALL, "-o", target) == 0
    assert oiio.ImageInput.open(str(target)).spec().width == 32


@pytest.mark.parametrize(
    ("options", "said"),
    [(["--coherence", "centred", "--sigma-um", "5"], "centred window with σ = 5 µm"),
     (["--coherence", "source"], "source of 0.53° in diameter"),
     (["--coherence", "source", "--source-diameter-deg", "2"], "source of 2° in diameter"),
     (["--coherence", "replicas", "--periods", "1", "12"], "1 × 12 periods"),
     (["--method", "power"], "Chebyshev series of the powers")],
)  # fmt: skip
def test_the_plan_reports_the_requested_coherence_and_method(options, said, tmp_path, capsys):
    assert run("brdf --heightfield blazed --tolerance 0.1 --size 6", *options, "-o", tmp_path / "map.exr") == 0
    assert said in capsys.readouterr().out


@pytest.mark.parametrize(
    "name",
    [slow(name) if name == "fingers" else name for name in cli_inputs.GRATINGS if name not in ("dvd", "blu-ray", "cd")],
)
def test_info_describes_each_grating(name, monkeypatch, capsys):
    # The command ``info`` makes a plan (method, number of wavelengths and so on). With a short coherence window, this
    # is several seconds faster.
    monkeypatch.setattr(wd, "plan", functools.partial(wd.plan, coherence=wd.Coherence(sigma_um=3.0)))
    assert cli.main(["info", "--heightfield", name, "--tolerance", "0.1"]) == 0
    out = capsys.readouterr().out
    assert "pitch" in out
    assert "hemisphere" in out


def test_info_reports_the_number_of_samples_of_a_cleaned_scan(scan_path, capsys):
    line = "info --extent-um 65 --height-range-um 0.375 --crop-um 6 --level 2 --despike --periodic --heightfield"
    assert run(line, scan_path) == 0
    assert "123 × 123 samples" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (f"{BRDF} --coherence laser", "--coherence must be one of 'averaged', 'centred', 'source', 'replicas'"),
        ("demo --data no/such/folder", "does not exist"),
        ("demo --display film", "--display must be one of 'aces', 'colorimetric', 'clip', got 'film'"),
        ("brdf --heightfield nothing -o x.png --display film", "--display must be one of"),
        ("brdf --heightfield nothing -o x.png --gamut film", "--gamut must be one of 'srgb', 'display-p3'"),
        ("render disc --heightfield blazed:period_um -o x.png", "period_um"),
    ],
)
def test_invalid_input_has_exit_code_2(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli_progress, "_FIRST_S", 600.0)
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_messages_name_the_arguments_of_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    heights = np.add.outer(np.zeros(9), np.arange(40.0) ** 2) * 1e-4
    np.save("slope.npy", heights)
    np.save("gaps.npy", np.where(heights > 0.1, np.nan, heights))
    assert run("brdf --heightfield gaps.npy --pitch-um 0.1 -o map.png") == 2
    error = capsys.readouterr().err
    assert "--heightfield must have all samples" in error
    assert "--fill" in error
    assert "--crop-um" in error
    assert run("brdf --heightfield slope.npy --pitch-um 0.1 --periodic --size 4 -o b.exr", *SMALL) == 0
    assert "warning: --periodic changed heights" in capsys.readouterr().err


@pytest.mark.permanent("closed, full or ASCII streams, no home folder, files that a mesh references")
@pytest.mark.parametrize(
    "arguments",
    [BRDF, "render tube --heightfield blazed -o tube.exr", "demo"],
)
def test_an_unwritable_folder_is_reported_before_rendering(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # The root user may write everywhere, so the check of file permissions is replaced.
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr("warpdiff.device.devices.load", lambda *_: pytest.fail("kernels are loaded"))
    assert run(arguments) == 2
    assert "is not writable; use another one" in capsys.readouterr().err


@pytest.mark.parametrize(("line", "message"), [
    ("render tube -o a.png --layers normal", "--layers is for .exr files, got --output a.png"),
    ("render tube -o a.png --wavelengths-nm 500", "--wavelengths-nm is for .exr files, got --output a.png"),
    ("render tube -o a.exr --layers lihgt", "'light', got 'lihgt'; did you mean 'light'?"),
    ("render tube -o a.exr --layers light.1", "--layers must name one of the --light, light.0 to light.0, got"),
    ("render tube -o a.exr --wavelengths-nm 500 400", "--wavelengths-nm must increase in steps of at least 1e-05 nm"),
    ("render tube -o a.jpg", "--output must end in .exr or .png, got 'a.jpg'"),
    ("render tube -o folder.png", "--output must be a file, got the folder 'folder.png'; name a file in it"),
    ("sequence tube -o turn --animation a.avi", "--animation must end in .webp"),
    ("sequence tube -o turn --animation absent/a.webp", "--animation: the folder 'absent' does not exist"),
    ("sequence tube -o file.txt", "--output: 'file.txt' is a file; name a folder"),
    ("sequence tube -o file.txt/turn", "file.txt' is a file; name a folder"),
    ("sequence tube -o turn --light-to 1 0 0 --lights-stay",
     "--lights-stay is for --turns, not for --light-to: give one of them"),
    ("sequence tube -o turn --path a.csv --lights-stay", "--lights-stay is for --turns, not for --path: give one of"),
    ("sequence tube -o turn --path a.csv --lights-turn", "--lights-turn is for --turns, not for --path: give one of"),
    ("sequence tube -o turn --frames-per-second 12", "--frames-per-second requires --animation: give both"),
    ("sequence tube -o turn --formats .exr --background 1 1 1", "--background is for .png files, got --formats .exr"),
    ("sequence tube -o turn --formats .exr --bits 16", "--bits is for .png files, got --formats .exr"),
    ("render tube -o a.png --pitch-um 0.1", "--pitch-um is for files, got --heightfield 'blazed': omit it"),
    ("render tube -o a.png --surface *=plain --map turn_deg=20", "--map changes --heightfield, which no part has with"),
    ("info --unit nm", "--unit is for files, got --heightfield 'blazed': omit it"),
    ("export-html absent/a.html", "OUT: the folder 'absent' does not exist"),
    ("export-html folder.html", "OUT must be a file, got the folder 'folder.html'"),
    ("brdf -o absent/a.png", "--output: the folder 'absent' does not exist"),
])  # fmt: skip
def test_outputs_are_checked_before_anything_is_drawn(line, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("folder.png", "folder.html"):
        (tmp_path / name).mkdir()
    (tmp_path / "file.txt").write_text("text")
    before = sorted(tmp_path.rglob("*"))
    for name in ("warpdiff.render.shade.prepare_surface", "warpdiff.render.renderer.prepare_surface",
                 "warpdiff.evaluate.reflectance._Call", "warpdiff.baked.bake_lobes.plan_for"):  # fmt: skip
        monkeypatch.setattr(name, lambda *_, **__: pytest.fail("work has begun"))
    assert run(f"{line} --heightfield blazed") == 2
    assert message in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def test_render_writes_layers_and_spectra(tmp_path):
    line = "render tube --heightfield blazed --width 16 --height 9 --layers normal light --wavelengths-nm 450 550"
    assert run(line, *SMALL, "-o", tmp_path / "a.exr") == 0
    image = wd.Image.load(tmp_path / "a.exr")
    assert list(image.layers) == ["normal", "light.0"]
    assert image.wavelengths_nm.tolist() == [450.0, 550.0]


def test_failure_has_exit_code_1_and_interruption_130(monkeypatch, tmp_path, capsys):
    def fail(*_args, **_options):
        raise OSError("disk full")

    def interrupt(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("warpdiff.Image.save", fail)
    assert run(f"{BRDF} --size 4") == 1
    assert "disk full" in capsys.readouterr().err
    monkeypatch.setattr("warpdiff.Image.save", interrupt)
    assert run(f"{BRDF} --size 4") == 130


def test_the_cache_is_shown_trimmed_and_cleared(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path / "kept"))
    monkeypatch.setattr(disk_cache, "_LEAST_SECONDS", 0.0)

    def shown(*options):
        assert cli.main(["cache", *options]) == 0
        return capsys.readouterr().out

    assert f"{tmp_path / 'kept'}: 0 files, 0.0 MiB" in shown()
    for index in range(4):
        disk_cache.cached_on_disk(index, np.zeros(1), lambda: {"rows": np.zeros(2**17)})
    (tmp_path / "kept" / "mine.npz").touch()
    assert "4 files, 4.0 MiB" in shown()
    assert "2 files, 2.0 MiB" in shown("--trim-mib", "2.5")
    assert "0 files, 0.0 MiB" in shown("--clear")
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["mine.npz"]
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", "")
    assert "the disk cache is disabled" in shown()
    assert cli.main(["cache", "--trim-mib", "-1"]) == 2


def run_without_home(code, folder, **environment):
    """Run Python code in a process whose user has no home folder."""
    homes = ("HOME", "XDG_CACHE_HOME", "WARP_CACHE_PATH")
    names = {key: value for key, value in os.environ.items() if key not in homes}
    names |= {"TMPDIR": str(folder)} | environment
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, env=names, capture_output=True, text=True, check=False)


@pytest.mark.permanent("closed, full or ASCII streams, no home folder, files that a mesh references")
def test_a_user_without_a_home_folder_can_run_commands(tmp_path):
    done = run_without_home(
        "import pwd\ndef none(_): raise KeyError\npwd.getpwuid = none\n"
        "from warpdiff.device.devices import resolve_device; resolve_device(None); import warp\n"
        "from pathlib import Path; assert Path(warp.config.kernel_cache_dir).is_absolute()", tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "the user has no home folder" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.permanent("closed, full or ASCII streams, no home folder, files that a mesh references")
def test_an_unwritable_kernel_cache_is_not_reported_as_a_device_error(tmp_path):
    (tmp_path / "file").touch()
    code = "import sys; from warpdiff.apps import cli; sys.exit(cli.main(['info', '--heightfield', 'lamellar']))"
    done = run_without_home(code, tmp_path, WARP_CACHE_PATH=str(tmp_path / "file"))
    assert done.returncode == 1
    assert "Warp cannot write compiled kernels" in done.stderr
    assert "WARP_CACHE_PATH" in done.stderr
    assert "device must" not in done.stderr


def test_warnings_are_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cli_progress, "_FIRST_S", 600.0)
    heights = tmp_path / "h.npy"
    np.save(heights, np.zeros((8, 8)))
    assert cli.main(["info", "--heightfield", str(heights), "--pitch-um", "0.5"]) == 0
    error = capsys.readouterr().err
    assert error.startswith("warpdiff: warning: a pitch of 0.5 µm")
    assert error.count("\n") == 1


def test_python_m_warpdiff_runs_the_command_line(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "warpdiff", "brdf", "--heightfield", "blazed", "--sigma-um", "1", "--method", "direct",
         "--size", "4", "-o", "map.exr"],
        cwd=tmp_path, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONIOENCODING": "utf-8"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("map.exr\n")
