"""Commands of the command line. Each command computes a result, writes its files and prints their paths."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import warpdiff as wd
from warpdiff.apps import cli_inputs
from warpdiff.apps.cli_options import given
from warpdiff.apps.cli_tables import direction_of
from warpdiff.core import disk_cache, files, validation
from warpdiff.core.options import describe
from warpdiff.core.wording import ArgumentValueError, marked, ref, renaming
from warpdiff.image.picture_files import check_target
from warpdiff.optics.materials import check_reflection
from warpdiff.request.plan import plan_text
from warpdiff.request.settings import EvaluationSettings, PictureSettings, SinglePictureSettings

if TYPE_CHECKING:
    import argparse

    from numpy.typing import NDArray


# Largest port number of the protocol TCP.
_MOST_PORT = 65_535


def render(options: argparse.Namespace) -> None:
    """Render a picture of a mesh whose surface has a height field, and save it."""
    _check_output(options)
    settings = cli_inputs.settings_of(options, SinglePictureSettings) | {"wavelengths_nm": options.wavelengths_nm}
    if Path(options.output).suffix.lower() != ".exr":
        for name in ("layers", "wavelengths_nm"):
            if settings.get(name):
                raise ArgumentValueError(f"{ref(name)} is for .exr files, got --output {options.output}")
    environment = cli_inputs.environment_of(options)
    mesh, heightfield, view = cli_inputs.scene_of(options)
    lights = cli_inputs.lights_of(options, view, environment)
    image = wd.shade(mesh, heightfield, lights, view, **settings, progress=options.progress)
    background = None
    if environment is not None and options.environment_behind:
        # With a constant index of refraction, the colours of a picture are relative to the reflectance at normal
        # incidence. The environment that is visible behind the mesh is therefore divided by this reflectance, too.
        normal, _ = check_reflection(settings.get("ior"), settings["material"])
        background = environment.background(view) / np.float32(normal)
    _save(image, options, background)


def _check_output(options: argparse.Namespace) -> None:
    """Raise an error if the output file cannot be written, before rendering starts."""
    check_target(options.output, "--output")
    given(options, describe(wd.Image.save))
    if "background" in options:
        if Path(options.output).suffix.lower() != ".png":
            raise ArgumentValueError(f"--background is for .png files, got --output {options.output}")
        for component in options.background:
            validation.number(component, "background", least=0.0, most=1.0)


def _save(image: wd.Image, options: argparse.Namespace, background: NDArray[np.float32] | None = None) -> None:
    saving = given(options, describe(wd.Image.save)) | ({} if background is None else {"background": background})
    path = image.save(options.output, **saving)
    print(image.report)
    if image.plan is not None:
        print(plan_text(image.plan))
    print(path)


def sequence(options: argparse.Namespace) -> None:
    """Render the frames of a sequence."""
    from warpdiff.apps.sequences.sequence import FORMATS, check_files

    if options.scheduler is not None and importlib.util.find_spec("distributed") is None:
        raise ArgumentValueError("--scheduler requires Dask, which is not installed: pip install 'warpdiff[dask]'")
    motion = "--path" if options.path else "--light-to" if options.light_to else None
    for flag, is_set in (("--lights-turn", options.lights_turn), ("--lights-stay", options.lights_stay)):
        if is_set and motion:
            raise ArgumentValueError(f"{flag} is for --turns, not for {motion}: give one of them")
    saving = given(options, describe(wd.sequence))
    if "frames_per_second" in saving and "animation" not in saving:
        raise ArgumentValueError("--frames-per-second requires --animation: give both")
    for name in ("background", "bits"):
        if name in saving and ".png" not in saving.get("formats", FORMATS[:1]):
            raise ArgumentValueError(f"--{name} is for .png files, got --formats {' '.join(saving['formats'])}")
    # Files are checked here, because a ``Renderer`` is made before ``warpdiff.sequence`` checks the files. A new
    # renderer already draws a picture, for which an error about files should not wait.
    check_files(tuple(saving.get("formats", FORMATS[:1])), saving.get("animation"))
    files.check_new_folder(options.output)
    environment = cli_inputs.environment_of(options)
    turning = options.path is None and options.light_to is None and not options.lights_turn
    mesh, heightfield, view = cli_inputs.scene_of(options, turning=turning)
    lights = cli_inputs.lights_of(options, view, environment)
    count = 36 if options.count is None else options.count
    if options.path is not None:
        shots = wd.camera_path(options.path, lights, view, count=options.count)
    elif options.light_to is not None:
        shots = wd.light_sweep(lights, view, options.light_to, count=count)
    elif options.lights_turn:
        shots = wd.light_sweep(lights, view, turns=options.turns, count=count)
    else:
        shots = wd.turntable(lights, view, count=count, turns=options.turns, lights_follow=not options.lights_stay)
    settings = cli_inputs.settings_of(options, PictureSettings)
    renderer = wd.Renderer(mesh, heightfield, list(shots[0].lights), shots[0].view, **settings)
    with contextlib.ExitStack() as stack:
        client = None
        if options.scheduler is not None:
            from distributed import Client

            client = stack.enter_context(Client(options.scheduler))
        paths = wd.sequence(renderer, shots, options.output, **saving, client=client, progress=options.progress)
    print(plan_text(renderer.plan))
    print(f"{len(paths)} frames in {Path(options.output).resolve()}")
    if "animation" in options:
        print(options.animation)


def export_html(options: argparse.Namespace) -> None:
    """Write a web page that shows a mesh, which visitors can rotate."""
    from warpdiff.apps.web_page.export_html import SUFFIXES

    target = files.check_output(options.output, SUFFIXES)
    page = given(options, describe(wd.export_html))
    mesh, heightfield, view = cli_inputs.scene_of(options, turning=True)
    baking = given(options, describe(wd.bake)) | {
        "coherence": cli_inputs.coherence_of(options),
        "material": cli_inputs.material_of(options),
    }
    baking["illuminant"] = cli_inputs.illuminant_of(options.illuminant)
    lobes = wd.bake(heightfield, **baking, progress=options.progress)
    path = wd.export_html(target, mesh, lobes, cli_inputs.lights_of(options, view), view, **page)
    print(lobes)
    print(f"{path}, {path.stat().st_size / 1e6:.1f} MB")


def brdf(options: argparse.Namespace) -> None:
    """Compute a map of the reflectance over all view directions, and save the map."""
    _check_output(options)
    to_light = direction_of(options.incidence_deg, options.azimuth_deg, "--incidence-deg")
    image = wd.reflectance_map(
        cli_inputs.height_field_of(options), to_light, illuminant=cli_inputs.illuminant_of(options.illuminant),
        **cli_inputs.settings_of(options, wd.reflectance_map), progress=options.progress,
    )  # fmt: skip
    _save(image, options)


def report(options: argparse.Namespace) -> None:
    """Write the report of a height field."""
    from warpdiff.apps.report.report_data import DEFAULT_INCIDENCE_DEG, wave_azimuth_deg

    heightfield = cli_inputs.height_field_of(options)
    settings = cli_inputs.settings_of(options, EvaluationSettings)
    azimuth = options.azimuth_deg
    if azimuth is None and (options.incidence_deg is not None or options.view_deg is not None):
        azimuth = wave_azimuth_deg(heightfield)
    incidence = DEFAULT_INCIDENCE_DEG if options.incidence_deg is None else options.incidence_deg
    to_light = None if azimuth is None else direction_of(incidence, azimuth, "--incidence-deg")
    to_view = None if options.view_deg is None else direction_of(options.view_deg, azimuth, "--view-deg")
    # The default title of the report of a synthetic height field is the text with which the user named the height field
    # on the command line, such as ``fingers``.
    synthetic = options.heightfield or options.scan if heightfield.source is None else None
    result = wd.report(
        heightfield, options.output, to_light=to_light, to_view=to_view, wavelengths_nm=options.wavelengths_nm,
        sigmas_um=options.sigmas_um, compare=options.compare, illuminant=cli_inputs.illuminant_of(options.illuminant),
        title=given(options, describe(wd.report)).get("title", synthetic), progress=options.progress, **settings,
    )  # fmt: skip
    print(result)
    print(result.page)


def demo(options: argparse.Namespace) -> None:
    """Render the demonstration pictures."""
    from warpdiff.apps import demo

    shown = given(options, describe(wd.Image.save))
    paths = demo.run(
        options.output, data=options.data, scale=options.scale, **shown,
        say=lambda line: options.progress.print(line, sys.stdout), progress=options.progress,
    )  # fmt: skip
    print(f"{len(paths)} pictures in {Path(options.output).resolve()}")


def info(options: argparse.Namespace) -> None:
    """Print a summary of a height field, and a plan for all directions (method, number of wavelengths and so on)."""
    heightfield = cli_inputs.height_field_of(options)
    print(heightfield.summary())
    if heightfield.missing.any():
        print("\nMissing samples must be filled before rendering: --fill")
    else:
        plan = wd.plan(heightfield, **given(options, describe(EvaluationSettings)), strict=False)
        print(f"\nFor the whole hemisphere: {plan}")


def view(options: argparse.Namespace) -> None:
    """Start the viewer."""
    if importlib.util.find_spec("websockets") is None:
        raise ArgumentValueError("the page requires websockets, which is not installed: pip install 'warpdiff[view]'")
    from warpdiff.apps.viewer.page_calls import NamedFiles
    from warpdiff.apps.viewer.server import run

    if not 0 <= options.port <= _MOST_PORT:
        raise ArgumentValueError(f"--port must be 0 to {_MOST_PORT}, got {options.port}")
    device = given(options, {name: describe(EvaluationSettings)[name] for name in ("device", "threads")})
    loading = given(options, describe(wd.HeightField.load))
    inputs = {"mesh": options.mesh, "heightfield": options.heightfield, "--environment": options.environment}
    for name, paths in inputs.items():
        for path in paths:
            if not validation.path(path, name).is_file():
                raise marked(FileNotFoundError, f"{ref(name)}: there is no file {path!r}")
    of_files = [*loading, *(f"{method}()" for method, _ in cli_inputs.cleaning_of(options))]
    if of_files and not options.heightfield:
        raise ArgumentValueError(f"{ref(of_files[0])} requires {ref('heightfield')}: give both")
    # Each file is loaded once before the server starts, so that the terminal shows the errors of unreadable files.
    for path in options.heightfield:
        cli_inputs.cleaned_of(cli_inputs.scan_of(path, options), options)
    for path in options.environment:
        with renaming({"path": "--environment"}):
            wd.Environment.load(path)
    if dots := cli_inputs.dots_of(options.map):
        with renaming(cli_inputs.MAP_FLAGS):
            wd.GratingMap(wd.gratings.sinusoidal(1.0, 0.1), **dots)
    named = NamedFiles(
        tuple(map(Path, options.mesh)), tuple(map(Path, options.heightfield)), tuple(map(Path, options.environment)),
        tuple(loading.items()), tuple(cli_inputs.cleaning_of(options)), tuple(dots.items()),
    )  # fmt: skip
    run(
        named, host=options.host, port=options.port, opens_browser=not options.no_browser, **device,
        say=functools.partial(print, flush=True),
    )  # fmt: skip


def cache(options: argparse.Namespace) -> None:
    """Trim or clear the disk cache if a flag asks for it, and print its size."""
    if options.trim_mib is not None:
        validation.number(options.trim_mib, "--trim-mib", least=0.0)
    folder = disk_cache.cache_folder()
    if folder is None:
        print("the disk cache is disabled: WARPDIFF_CACHE_DIR is empty, or the user has no home folder")
        return
    if options.clear:
        disk_cache.clear(folder)
    elif options.trim_mib is not None:
        disk_cache.trim(folder, round(options.trim_mib * 2**20))
    entries = disk_cache.entries(folder)
    used = f", last used on {time.strftime('%Y-%m-%d', time.localtime(entries[0].used))}" if entries else ""
    total, most = sum(entry.size for entry in entries) / 2**20, disk_cache.MOST_BYTES / 2**20
    print(f"{folder}: {len(entries)} files, {total:.1f} MiB of at most {most:.0f} MiB{used}")
