"""``sequence``: frames of one surface, drawn here or by workers of Dask, resumed where they ended."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import pickle
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.apps.sequences import animation as animated
from warpdiff.apps.sequences.dask_workers import drawn_by_workers
from warpdiff.apps.sequences.frames import FrameJob, drawn
from warpdiff.apps.sequences.shots import Shot
from warpdiff.core import files, openimageio, validation
from warpdiff.image.display_transform import DISPLAYS, GAMUTS, MEAN_SHOWN
from warpdiff.image.image import MOST_STOPS, PNG_END
from warpdiff.render.renderer import Renderer

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike

FORMATS = (".png", ".exr")
# What tells one sequence from another is counted up when the same arguments make other frames.
_VERSION = 1
_MANIFEST = "sequence.json"
# Frames that tell the exposure of all, and how wide they are then.
_METERED, _METERED_WIDTH = 16, 160


def sequence(
    renderer: Renderer,
    shots: Sequence[Shot],
    folder: str | os.PathLike[str],
    *,
    formats: Sequence[str] = (".png",),
    animation: str | os.PathLike[str] | None = None,
    frames_per_second: float = 24.0,
    display: str = "aces",
    exposure: float | None = None,
    exposure_stops: float = 0.0,
    gamut: str = "srgb",
    background: ArrayLike | None = None,
    bits: int = 8,
    overwrite: bool = False,
    client: Any = None,
    progress: Callable[[float], None] | None = None,
) -> list[Path]:
    """Draw shots one after the other into files ``frame_0000.png``, …, all at one exposure.

    What is interrupted goes on where it ended when it is called again with the same arguments: a file is whole or not
    there, and the folder says of which renderer, shots and options its frames are. Frames do not depend on who draws
    them, to the bit, on machines of one type::

        shots = wd.turntable(light, view, count=72)
        wd.sequence(wd.Renderer(mesh, heightfield, light, view, tolerance=3e-2), shots, "turn", animation="turn.webp")

    Args:
        renderer: What is drawn, and how; each frame is the picture that it draws of a shot.
        shots: Lights and views, of as many pixels as the renderer's.
        folder: Where the frames go; it is made if need be.
        formats: Of each frame: ``".png"``, ``".exr"``, or both.
        animation: An animated file of the PNG frames: ``.webp``, ``.png`` (APNG) or ``.gif``. None makes none.
        frames_per_second: Of the animation.
        display: As in :meth:`warpdiff.Image.save`, for PNG.
        exposure: Linear factor of all frames; None is found from some of them, small and unrefined: the geometric mean
            of what each would take by itself. EXR is unscaled unless it is given.
        exposure_stops: Doublings of light, on top of it.
        gamut: As in :meth:`warpdiff.Image.save`, for PNG.
        background: A colour behind PNG frames, (R, G, B), encoded, each 0 to 1; None is transparent.
        bits: 8 or 16, of PNG.
        overwrite: Whether frames of another sequence in the folder are replaced; otherwise they are an error.
        client: A ``distributed.Client``: its workers draw, and the frames come back to this machine, which writes them.
            Each worker gets the renderer once and keeps its tables. Workers that are lost are replaced by others.
        progress: Called with the share of the frames that are there, 0 to 1.

    Returns:
        The frames' paths in order, those of the first format, then those of the second.

    Raises:
        ValueError: A bad argument, or a folder with frames of another sequence.
        OSError: A file cannot be written; frames that are there stay.
    """
    validation.instance(renderer, Renderer, "renderer")
    validation.callback(progress, "progress")
    shots = _checked_shots(shots, renderer)
    suffixes = _checked_formats(formats)
    target = validation.path(folder, "folder")
    film = None if animation is None else animated.check_target(animation, suffixes)
    pace = validation.number(frames_per_second, "frames_per_second", above=0.0, most=1000.0)
    exposure = None if exposure is None else validation.positive(exposure, "exposure")
    how = _checked_saving(display, exposure_stops, gamut, background, bits)
    validation.flag(overwrite, "overwrite")
    if client is not None and not (hasattr(client, "submit") and hasattr(client, "scatter")):
        raise TypeError(f"client must be a distributed.Client or None, got {type(client).__name__}")

    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise type(error)(f"folder: {target} cannot be made: {error.strerror}") from None
    files.check_folder(target, "folder")
    key = _key(renderer, shots, (suffixes, exposure, how))
    told = _manifest(target, key, overwrite=overwrite)
    factor = told.get("exposure")
    if factor is None:
        factor = _metered(renderer, shots, display) if exposure is None else exposure
        _write(target / _MANIFEST, json.dumps({"key": key, "frames": len(shots), "exposure": factor}).encode())
    png = {**how, "exposure": factor}
    exr = {"exposure": exposure, "exposure_stops": exposure_stops if exposure is not None else 0.0}
    job = FrameJob(key, suffixes, {".png": png, ".exr": exr})

    digits = max(4, len(str(len(shots) - 1)))
    paths = [[target / f"frame_{index:0{digits}d}{suffix}" for suffix in suffixes] for index in range(len(shots))]
    missing = [index for index, of_frame in enumerate(paths) if not all(_is_whole(path, shots[0]) for path in of_frame)]
    done = len(shots) - len(missing)
    if progress is not None:
        progress(done / len(shots))
    for index, contents in _draw(job, renderer, shots, missing, client):
        for path in paths[index]:
            _write(path, contents[path.suffix])
        done += 1
        if progress is not None:
            progress(done / len(shots))
    if film is not None:
        column = suffixes.index(".png")
        animated.write(film, [each[column] for each in paths], pace)
    return [each[column] for column in range(len(suffixes)) for each in paths]


def _draw(
    job: FrameJob, renderer: Renderer, shots: Sequence[Shot], missing: Sequence[int], client: Any
) -> Iterator[tuple[int, dict[str, bytes]]]:
    """Frames that are missing, as they are drawn."""
    if client is None:
        for index in missing:
            yield index, drawn(job, renderer, shots[index])
    elif missing:
        yield from drawn_by_workers(client, job, pickle.dumps(renderer), {index: shots[index] for index in missing})


def _checked_shots(shots: Any, renderer: Renderer) -> list[Shot]:
    if not validation.is_sequence(shots) or not len(shots):
        raise TypeError(f"shots must be a non-empty list of warpdiff.Shot, got {shots!r:.60}")
    for index, each in enumerate(shots):
        validation.instance(each, Shot, f"shots[{index}]")
        if (each.view.width, each.view.height) != renderer.size:
            width, height = renderer.size
            raise ValueError(
                f"shots[{index}].view must have {width} × {height} pixels as the renderer's, "
                f"got {each.view.width} × {each.view.height}"
            )
    return list(shots)


def _checked_formats(formats: Any) -> tuple[str, ...]:
    if not validation.is_sequence(formats) or not len(formats):
        raise TypeError(f"formats must be a list of {' and '.join(FORMATS)}, got {formats!r:.60}")
    return tuple(dict.fromkeys(validation.choice(each, "formats", FORMATS) for each in formats))


def _checked_saving(display: Any, exposure_stops: Any, gamut: Any, background: Any, bits: Any) -> dict[str, Any]:
    """What PNG frames are saved with, but for the exposure of all."""
    validation.choice(display, "display", DISPLAYS)
    validation.choice(gamut, "gamut", tuple(GAMUTS))
    stops = validation.number(exposure_stops, "exposure_stops", least=-MOST_STOPS, most=MOST_STOPS)
    colour = None if background is None else tuple(validation.vector(background, "background").tolist())
    if colour is not None and not all(0.0 <= each <= 1.0 for each in colour):
        raise ValueError(f"background must be a colour of components from 0 to 1, got {list(colour)}")
    if validation.count(bits, "bits") not in (8, 16):
        raise ValueError(f"bits must be 8 or 16, got {bits!r}")
    return {"display": display, "exposure_stops": stops, "gamut": gamut, "background": colour, "bits": bits}


def _key(renderer: Renderer, shots: Sequence[Shot], how: Any) -> str:
    """A hash of all that frames depend on."""
    digest = hashlib.sha256(str(_VERSION).encode())
    _feed(digest, how)
    _, (request, wanted, device, _, surface, _) = renderer.__reduce__()
    heightfield = request.pop("heightfield")
    # What the plan has made of it counts.
    told = {name: value for name, value in (request | wanted).items() if name not in ("lights", "tolerance", "method")}
    _feed(digest, told)
    _feed(digest, (device.partition(":")[0], surface, heightfield.heights_um, heightfield.pitch_um))
    # A hundred thousand of them are soon written.
    for shot in shots:
        digest.update(repr(shot).encode())
        # Of a spectrum that says no more than the name.
        _feed(digest, [each.illuminant for each in shot.light if not isinstance(each.illuminant, str)])
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    """Add a value of any kind."""
    if isinstance(value, np.ndarray):
        digest.update(repr((value.dtype.str, value.shape)).encode())
        digest.update(np.ascontiguousarray(value).data)
    elif dataclasses.is_dataclass(value):
        _feed(digest, {each.name: getattr(value, each.name) for each in dataclasses.fields(value)})
    elif isinstance(value, dict):
        for name in sorted(value):
            _feed(digest, name)
            _feed(digest, value[name])
    elif isinstance(value, (tuple, list)):
        for each in value:
            _feed(digest, each)
    else:
        digest.update(repr(value).encode())


def _manifest(folder: Path, key: str, *, overwrite: bool) -> dict[str, Any]:
    """What the folder says of its frames, which go if they are another sequence's."""
    path = folder / _MANIFEST
    told: dict[str, Any] = {}
    if path.exists():
        try:
            read = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            read = None
        told = read if isinstance(read, dict) else {}
    elif not any(folder.glob("frame_*")):
        return {}
    exposure = told.get("exposure")
    if told.get("key") == key and isinstance(exposure, float) and math.isfinite(exposure) and exposure > 0.0:
        return told
    if not overwrite:
        raise ValueError(
            f"folder: {folder} holds frames of another sequence, drawn with other arguments: name another folder, or "
            "give overwrite=True"
        )
    # First of all, so that none of them is taken for a new one.
    path.unlink(missing_ok=True)
    for each in folder.glob("frame_*"):
        if each.suffix in FORMATS:
            each.unlink(missing_ok=True)
    return {}


def _metered(renderer: Renderer, shots: Sequence[Shot], display: str) -> float:
    """One exposure for all frames."""
    view = shots[0].view
    scale = min(_METERED_WIDTH / max(view.width, view.height), 1.0)
    width, height = max(round(scale * view.width), 1), max(round(scale * view.height), 1)
    chosen = [shots[index] for index in np.unique(np.linspace(0, len(shots) - 1, _METERED).round().astype(int))]
    small = renderer.resized(dataclasses.replace(view, width=width, height=height), refine=False)
    logarithms = []
    for shot in chosen:
        small.draw(shot.light, dataclasses.replace(shot.view, width=width, height=height))
        image = small.image()
        # A black picture says nothing.
        if image.xyz[..., 1].max(initial=0.0) > 0.0:
            logarithms.append(math.log(image.auto_exposure))
    mean = math.exp(sum(logarithms) / len(logarithms)) if logarithms else 1.0
    factor = mean * MEAN_SHOWN[display] / MEAN_SHOWN["aces"]
    return float(min(max(factor, validation.LEAST), 1e-3 * validation.MOST))


def _is_whole(path: Path, shot: Shot) -> bool:
    """Whether a frame is there with its size and its end, as far as can be told without reading all of it."""
    if not path.is_file():
        return False
    with openimageio.in_use() as oiio:
        source = oiio.ImageInput.open(str(path))
        if source is None:
            # Or it is printed when the process ends.
            oiio.geterror()
            return False
        spec = source.spec()
        is_whole = (spec.width, spec.height) == (shot.view.width, shot.view.height)
        if path.suffix == ".exr" and is_whole:
            # The last rows come last.
            is_whole = source.read_scanlines(spec.height - 1, spec.height, 0, 0, spec.nchannels) is not None
            source.geterror()
        source.close()
    return is_whole and (path.suffix != ".png" or path.read_bytes().endswith(PNG_END))


def _write(path: Path, data: bytes) -> None:
    with files.atomic_write(path, suffix=path.suffix) as temporary:
        temporary.write_bytes(data)
