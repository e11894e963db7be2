"""Function ``sequence``, which renders the frames of a sequence in this process or by Dask workers."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Unpack, get_args

import numpy as np
from annotated_types import Interval, Unit

from warpdiff.apps.sequences import animation as animated
from warpdiff.apps.sequences.frames import FrameJob, FrameRenderer, draw_by_workers, draw_frame
from warpdiff.apps.sequences.shots import Shot
from warpdiff.core import files, openimageio, validation
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.grating_map import GratingMap
from warpdiff.image.display_transform import MEAN_SHOWN, exposure_factor
from warpdiff.image.picture_files import ends_as_png
from warpdiff.lights.base import LobeLight
from warpdiff.lights.environment import Environment
from warpdiff.render.renderer import Renderer  # noqa: TC001 (the decorator ``checked`` needs the class at run time)
from warpdiff.request.settings import Display, DisplaySettings
from warpdiff.request.signatures import accepts, checked

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from warpdiff.request.keywords import DisplayKeywords

Format = Literal[".png", ".exr"]
FORMATS: tuple[Format, ...] = get_args(Format)
# Version number in the hash of a sequence. It must increase when a new release renders other frames from the same
# arguments; frames of the old release are then not reused.
_VERSION = 2
_MANIFEST = "sequence.json"
# Number of small frames from which automatic exposure is measured, and length of their longer side in pixels. Both are
# limited because the measurement must be much faster than one frame. If the length is doubled, the measurement requires
# four times the time.
_METERED, _METERED_WIDTH = 16, 160


@checked
@accepts(DisplaySettings)
def sequence(
    renderer: Renderer, shots: Sequence[Shot], folder: str | os.PathLike[str], *,
    formats: Collection[Format] = (FORMATS[0],), animation: str | os.PathLike[str] | None = None,
    frames_per_second: Annotated[float, Interval(gt=0.0, le=1000.0), Unit("1/s")] = 24.0,
    background: tuple[float, float, float] | None = None, overwrite: bool = False, client: Any = None,
    progress: Progress = None, **settings: Unpack[DisplayKeywords],
) -> list[Path]:  # fmt: skip
    """Draw shots one after the other into files ``frame_0000.png``, …, all with the same exposure.

    Automatic exposure is the geometric mean of the automatic exposures of up to 16 small, unrefined frames.

    An interrupted sequence resumes at the next missing frame when the function is called again with the same arguments.
    Partial files are never left behind. A hash of renderer, shots and options in the folder detects frames of other
    sequences. On machines of one type the frames are identical to the bit, whichever process draws them::

        shots = wd.turntable(light, view, count=72)
        wd.sequence(wd.Renderer(mesh, heightfield, light, view, tolerance=3e-2), shots, "turn", animation="turn.webp")

    Args:
        renderer: Renderer that draws the frames.
        shots: Lights and camera of each frame; views have the size of the renderer's pictures.
        folder: Folder of the frames; it is created if it does not exist.
        formats: File formats of each frame: ``".png"``, ``".exr"``, or both.
        animation: Animated file of the PNG frames: ``.webp``, ``.png`` (APNG) or ``.gif``. None writes no animation.
        frames_per_second: Frame rate of the animation.
        background: Encoded colour (R, G, B) of the background of PNG files, components from 0 to 1; None is
            transparent.
        overwrite: Whether frames of another sequence in the folder are deleted; otherwise they are an error.
        client: ``distributed.Client`` whose workers draw the frames. This process writes the files. Each worker
            receives the renderer once and keeps its tables; frames of lost workers are drawn by other workers.
        progress: Callable that gets the finished fraction of the sequence, 0 to 1, also within frames that this process
            draws; True shows a bar. Frames that existed before count as finished. An exception that the callable raises
            ends the call.

    Returns:
        Paths of the frames: all frames in the first format in their order, then all frames in the second format.

    Raises:
        ValueError: An argument is not accepted, or the folder contains frames of another sequence.
        OSError: A file cannot be written; existing frames are unchanged.

    Examples:
        >>> import warpdiff as wd
        >>> body, grating = wd.meshes.tube(), wd.gratings.sinusoidal(2.0, 0.1)
        >>> light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, width=32, height=18)
        >>> renderer = wd.Renderer(body, grating, light, view, coherence=wd.Coherence(sigma_um=5.0), tolerance=0.1)
        >>> paths = wd.sequence(renderer, wd.turntable(light, view, count=2), "turn")
        >>> [path.name for path in paths]
        ['frame_0000.png', 'frame_0001.png']
    """
    shown = DisplaySettings(**settings)
    report = reporter(progress, "sequence") or (lambda _: None)
    _check_shots(shots, renderer)
    suffixes = tuple(formats)
    animated_file = check_files(suffixes, animation)
    if background is not None and not all(0.0 <= component <= 1.0 for component in background):
        raise ArgumentValueError(
            f"{ref('background')} must be a colour of components from 0 to 1, got {list(background)}"
        )
    if client is not None and not (hasattr(client, "submit") and hasattr(client, "scatter")):
        raise ArgumentTypeError(f"{ref('client')} must be a distributed.Client or None, got {type(client).__name__}")

    target = files.made_folder(folder)
    png = dataclasses.asdict(shown) | {"background": background}
    exposure = png.pop("exposure")
    key = _key(renderer, shots, (suffixes, exposure, png))
    factor = _manifest(target, key, overwrite=overwrite).get("exposure")
    if factor is None:
        factor = _metered(renderer, shots, shown.display, report) if exposure is None else exposure
        _write(target / _MANIFEST, json.dumps({"key": key, "frames": len(shots), "exposure": factor}).encode())
    # EXR files have the exposure that the caller gives, or none. Their metadata state the exposure of the PNG files.
    shown = dataclasses.replace(shown, exposure=factor)
    scale = 1.0 if exposure is None else exposure_factor(shown, ())
    job = FrameJob(key, suffixes, shown, background, scale)

    digits = max(4, len(str(len(shots) - 1)))
    paths = [[target / f"frame_{index:0{digits}d}{suffix}" for suffix in suffixes] for index in range(len(shots))]
    missing = [index for index, of_frame in enumerate(paths) if not all(_is_whole(path, shots[0]) for path in of_frame)]
    done = len(shots) - len(missing)
    report(done / len(shots))

    def report_within(share: float) -> None:
        # The finished fraction of a frame is 1 only after its files are written.
        if share < 1.0:
            report((done + share) / len(shots))

    for index, contents in _draw(job, renderer, shots, missing, client, report_within):
        for path in paths[index]:
            _write(path, contents[path.suffix])
        done += 1
        report(done / len(shots))
    if animated_file is not None:
        column = suffixes.index(".png")
        animated.write(animated_file, [of_frame[column] for of_frame in paths], frames_per_second)
    return [of_frame[column] for column in range(len(suffixes)) for of_frame in paths]


def check_files(suffixes: tuple[str, ...], animation: object) -> Path | None:
    """Check the formats of frames and the file of the animation; return the path of this file, or None."""
    if not suffixes:
        raise ArgumentValueError(f"{ref('formats')} must name at least one of {' and '.join(FORMATS)}, got none")
    return None if animation is None else animated.check_target(animation, suffixes)


def _draw(
    job: FrameJob, renderer: Renderer, shots: Sequence[Shot], missing: Sequence[int], client: Any,
    progress: Callable[[float], None],
) -> Iterator[tuple[int, dict[str, bytes]]]:  # fmt: skip
    """Yield the index and the files of each missing frame, in the order of rendering.

    Args:
        job: Work that all frames share.
        renderer: Renderer of the frames.
        shots: Lights and camera of every frame.
        missing: Indices of the frames to draw.
        client: Dask client whose workers draw the frames; None draws them in this process.
        progress: Callable that gets the finished fraction of the current frame, if this process draws it.
    """
    if client is None:
        frame_renderer = FrameRenderer(renderer)
        for index in missing:
            yield index, draw_frame(job, frame_renderer, shots[index], progress)
    elif missing:
        yield from draw_by_workers(client, job, renderer, shots, missing)


def _check_shots(shots: Any, renderer: Renderer) -> None:
    if not validation.is_sequence(shots) or not len(shots):
        raise ArgumentTypeError(f"{ref('shots')} must be a non-empty list of warpdiff.Shot, got {shots!r:.60}")
    for index, shot in enumerate(shots):
        validation.instance(shot, Shot, f"shots[{index}]")
        if (shot.view.width, shot.view.height) != renderer.size:
            width, height = renderer.size
            raise ArgumentValueError(
                f"{ref(f'shots[{index}].view')} must have {width} × {height} pixels as the renderer's, "
                f"got {shot.view.width} × {shot.view.height}: use renderer.resized(view)"
            )


def _key(renderer: Renderer, shots: Sequence[Shot], saving: Any) -> str:
    """Return a hash of everything that determines the files of a sequence: renderer, shots, and options of saving.

    A shot has the lights and the camera of one frame.
    """
    digest = hashlib.sha256(str(_VERSION).encode())
    _feed(digest, saving)
    state = renderer.__getstate__()
    settings = state["settings"]
    # Tolerance, method and integration over wavelengths are not hashed themselves. They determine the plan (method,
    # number of wavelengths and so on), which is hashed.
    names = {field.name for field in dataclasses.fields(settings)}
    names -= {"tolerance", "method", "integration", "device", "threads"}
    _feed(digest, {name: getattr(settings, name) for name in names})
    device = settings.device.partition(":")[0]
    _feed(digest, (device, state["surface"], state["heightfield"]))
    radiances: dict[int, str] = {}
    # Each shot (lights and camera of one frame) is hashed as its text (``repr``), because this is fast enough for
    # 100,000 shots.
    for shot in shots:
        digest.update(repr(shot).encode())
        for light in shot.lights:
            # The text of a shot (lights and camera of one frame) contains only the names of spectra, and rounded
            # settings of environments. Exact settings and all arrays of spectra and environments are therefore hashed
            # as well.
            if isinstance(light, LobeLight) and not isinstance(light.illuminant, str):
                _feed(digest, light.illuminant)
            elif isinstance(light, Environment):
                # Environments that differ only in their rotation share one image. The image is hashed only once.
                image = np.asarray(light.radiance_rgb)
                radiances[id(image)] = radiances.get(id(image)) or hashlib.sha256(image.tobytes()).hexdigest()
                _feed(digest, (image.shape, radiances[id(image)], light.rotation_deg, light.scale, light.directions))
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    """Add a value to a hash: array, height field, dataclass, mapping, sequence, or any object by its repr."""
    if isinstance(value, HeightField):
        _feed(digest, (value.heights_um, value.pitch_um))
    elif isinstance(value, GratingMap):
        _feed(digest, (value.cell, value.turn_deg, value.depth_scale, value.pitch_scale))
    elif isinstance(value, np.ndarray):
        digest.update(repr((value.dtype.str, value.shape)).encode())
        digest.update(np.ascontiguousarray(value).data)
    elif dataclasses.is_dataclass(value):
        _feed(digest, {field.name: getattr(value, field.name) for field in dataclasses.fields(value)})
    elif isinstance(value, Mapping):
        for name in sorted(value):
            _feed(digest, name)
            _feed(digest, value[name])
    elif isinstance(value, (tuple, list)):
        for element in value:
            _feed(digest, element)
    else:
        digest.update(repr(value).encode())


def _manifest(folder: Path, key: str, *, overwrite: bool) -> dict[str, Any]:
    """Read the manifest of a folder, the hash of the inputs and the exposure of its frames; return {} without frames.

    Args:
        folder: Folder of the frames.
        key: Hash of the sequence to draw.
        overwrite: Whether frames of another sequence are deleted; otherwise such frames raise a ``ValueError``.
    """
    path = folder / _MANIFEST
    manifest: dict[str, Any] = {}
    if path.exists():
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            content = None
        manifest = content if isinstance(content, dict) else {}
    elif not any(folder.glob("frame_*")):
        return {}
    exposure = manifest.get("exposure")
    if manifest.get("key") == key and isinstance(exposure, float) and math.isfinite(exposure) and exposure > 0.0:
        return manifest
    if not overwrite:
        raise ArgumentValueError(
            f"{ref('folder')}: {folder} holds frames of another sequence, with other arguments: name another folder, "
            f"or give {ref('overwrite', True)}"
        )
    # The manifest is deleted before the frames. If the deletion is interrupted, the remaining frames without a manifest
    # cannot be mistaken for new ones.
    path.unlink(missing_ok=True)
    for frame in folder.glob("frame_*"):
        if frame.suffix in FORMATS:
            frame.unlink(missing_ok=True)
    return {}


def _metered(renderer: Renderer, shots: Sequence[Shot], display: Display, report: Callable[[float], None]) -> float:
    """Return one exposure factor for all frames, measured from up to 16 small unrefined frames.

    Args:
        renderer: Renderer of the full frames.
        shots: Lights and camera of every frame.
        display: Display transform, which determines the mean brightness.
        report: Callable that is called with 0 after each measured frame, so that a user can cancel.
    """
    view = shots[0].view
    scale = min(_METERED_WIDTH / max(view.width, view.height), 1.0)
    width, height = max(round(scale * view.width), 1), max(round(scale * view.height), 1)
    chosen = [shots[index] for index in np.unique(np.linspace(0, len(shots) - 1, _METERED).round().astype(int))]
    small = FrameRenderer(renderer.resized(dataclasses.replace(view, width=width, height=height), refine=False))
    logarithms = []
    for shot in chosen:
        image = small.draw(Shot(shot.lights, dataclasses.replace(shot.view, width=width, height=height)))
        report(0.0)
        # A black picture has no automatic exposure and is excluded from the mean.
        if image.xyz[..., 1].max(initial=0.0) > 0.0:
            logarithms.append(math.log(image.auto_exposure))
    mean = math.exp(sum(logarithms) / len(logarithms)) if logarithms else 1.0
    factor = mean * MEAN_SHOWN[display] / MEAN_SHOWN["aces"]
    return float(min(max(factor, validation.LEAST), 1e-3 * validation.MOST))


def _is_whole(path: Path, shot: Shot) -> bool:
    """Whether a frame's file exists, has the size of the shot, and is complete.

    The check reads only the header and the last part of the file: the last rows of an EXR file, or the last bytes of a
    PNG file.
    """
    if not path.is_file():
        return False
    with openimageio.in_use() as oiio:
        source = openimageio.opened(oiio, path, ("openexr", "png"))
        if source is None:
            # OpenImageIO prints unread error messages at the end of the process. Reading the message prevents this.
            openimageio.error_text(oiio)
            return False
        spec = source.spec()
        is_whole = (spec.width, spec.height) == (shot.view.width, shot.view.height)
        if path.suffix == ".exr" and is_whole:
            # The last rows of an EXR file are written last. If they can be read, the file is complete.
            is_whole = source.read_scanlines(spec.height - 1, spec.height, 0, 0, spec.nchannels) is not None
            openimageio.error_text(source)
        source.close()
    return is_whole and (path.suffix != ".png" or ends_as_png(path))


def _write(path: Path, data: bytes) -> None:
    with files.atomic_write(path, suffix=path.suffix) as temporary:
        temporary.write_bytes(data)
