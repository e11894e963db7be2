"""Peers on random directions and rays: errors against the float64 reference, and times, beside ours.

Errors are the design's, ‖ΔXYZ‖ / max(‖XYZ‖, f), f a thousandth of the 99th percentile of Y over the judged directions.
Times are of warm calls on all directions, arrays in, arrays out, medians of rounds in which everything takes turns;
beside each its least and largest, and the CPU's time of all threads, which a busy machine changes less. What comes
before is apart: to prepare, which for a series of as many terms is done once for all of its settings, and what a first
call takes more than a warm one, compilation above all, less what is kept on disk. Ours is timed the same.

Directions are random over the hemisphere, and for the disc besides across its tracks (v = 0), where the analytic shader
has its lines. Peers that cannot run are named and skipped.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import warpdiff as wd
from warpdiff import meshes, optics, render
from warpdiff.bench import inputs, reference
from warpdiff.bench.peers import drjit_peer, numpy_peer, raycasters, stam_analytic
from warpdiff.device import resolve_device, resolve_threads
from warpdiff.integration import Integrator
from warpdiff.scope import Scope
from warpdiff.surface import prepare_surface

PEERS = {"NumPy": numpy_peer, "Dr.Jit": drjit_peer, "Stam, analytic": stam_analytic}
# As long as the scan, or the window would see the same pits again.
DISC = "CD, 64 µm"
# Tables where they reach it, sampled wavelengths beyond.
TOLERANCES = {1e-1: "low-rank/table", 1e-2: "low-rank/table", 1e-3: "low-rank"}
Shade = Callable[[np.ndarray, np.ndarray, int], np.ndarray]


class Directions(NamedTuple):
    """Directions to the light, deflections (u, v, w), and gains, of unit vectors in the local frame."""

    to_lights: np.ndarray
    deflections: np.ndarray
    gains: np.ndarray

    @classmethod
    def of(cls, lights: np.ndarray, views: np.ndarray) -> Directions:
        """Those of pairs of unit vectors (n, 3)."""
        gains = optics.gain(lights, views, normal=optics.normal_reflectance(1.5), masking=True)
        return cls(lights, -lights - views, gains)

    @classmethod
    def random(cls, count: int, *, across: bool = False) -> Directions:
        """Uniform in z over the hemisphere; ``across`` in the plane of x and z, uniform in angle."""
        rng = np.random.default_rng(1)
        z, phi = rng.uniform(0.05, 1.0, (2, count)), rng.uniform(0.0, 2.0 * np.pi, (2, count))
        if across:
            angle = rng.uniform(-1.3, 1.3, (2, count))
            z, phi = np.cos(angle), np.where(angle < 0.0, np.pi, 0.0)
        s = np.sqrt(1.0 - z * z)
        lights, views = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=2)
        if across:
            lights[:, 1] = views[:, 1] = 0.0
        return cls.of(lights, views)


def surfaces(data: Path) -> dict[str, wd.HeightField]:
    """Synthetic fingers, a disc, and the scan where it is present."""
    made = {
        "fingers, 25.6 µm": wd.gratings.fingers(seed=2),
        DISC: wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08),
    }
    scan = data / "elaphe_65um.png"
    if scan.is_file():
        made["scan, 65 µm"] = wd.HeightField.load(scan, extent_um=65.0, height_range_um=0.375).levelled(order=2)
    else:
        print("The scan is not at hand: set WARPDIFF_DATA or --data to its folder.")
    return made


def ours(hf: wd.HeightField, seen: Directions, tolerance: float) -> Shade:
    """Ours at a tolerance, called like a peer."""
    import warp as wp

    device, window = resolve_device(None), wd.Coherence()
    plan = wd.plan(hf, tolerance=tolerance, method=TOLERANCES[tolerance])
    scope = Scope.of(hf, window, seen.deflections, seen.to_lights, seen.gains > 0.0)
    lights = wp.array(np.float32(seen.to_lights), dtype=wp.vec3f, device=device)
    made: dict[int, Integrator] = {}

    def shade(deflections: np.ndarray, gains: np.ndarray, threads: int) -> np.ndarray:
        if threads not in made:
            made[threads] = Integrator(hf, plan, scope, device=device, threads=threads)
        xyz = wp.zeros(len(gains), dtype=wp.vec3f, device=device)
        given = (
            wp.array(deflections, dtype=wp.vec3d, device=device),
            lights,
            wp.array(np.float32(gains), dtype=wp.float32, device=device),
        )
        made[threads].add(*given, "D65", xyz)
        return xyz.numpy()

    return shade


def running() -> dict[str, Any]:
    """The peers that can run; of the others it says why not."""
    found = {}
    for name, peer in PEERS.items():
        reason = peer.available()
        if reason is None:
            found[name] = peer
        else:
            print(f"{name} is left out: {reason}.")
    return found


def label(setting: dict[str, Any]) -> str:
    """A setting in few words."""
    if "colours" in setting:
        return f"{setting['colours']} colours"
    side = 2 * setting["reach"] + 1
    found = "rounding" if setting["rounded"] else "floor"
    heights = "centred" if setting["centred"] else "as they are"
    return f"{setting['wavelengths']} λ, {setting['terms']} terms, {side} × {side} by {found}, heights {heights}"


def shading(
    name: str, hf: wd.HeightField, seen: Directions, *, judged: int, rounds: int, threads: int, peers: dict[str, Any]
) -> None:
    """Print a table of all peers and settings on one surface."""
    window = wd.Coherence()
    few = Directions(*(each[:judged] for each in seen))
    exact = few.gains[:, None] * reference.colours(hf, few.deflections, few.to_lights, window, tolerance=1e-3)
    makers: dict[str, Callable[[], Shade]] = {
        f"warpdiff | tolerance {each:g}": functools.partial(ours, hf, seen, each) for each in TOLERANCES
    }
    for peer_name, peer in peers.items():
        for setting in ([peer.PUBLISHED] if hasattr(peer, "PUBLISHED") else []) + peer.SETTINGS:
            makers[f"{peer_name} | {label(setting)}"] = functools.partial(peer.prepare, hf, window, **setting)
    calls, prepared = {}, {}
    for each, maker in makers.items():
        begin = time.perf_counter()
        calls[each] = maker()
        prepared[each] = time.perf_counter() - begin
    wall: dict[str, list[float]] = {each: [] for each in calls}
    busy: dict[str, list[float]] = {each: [] for each in calls}
    found = {}
    for _ in range(rounds + 1):
        for each, shade in calls.items():
            begin, spent = time.perf_counter(), time.process_time()
            found[each] = shade(seen.deflections, seen.gains, threads)
            wall[each].append(time.perf_counter() - begin)
            busy[each].append(time.process_time() - spent)
    print(f"\n{name}: {len(seen.gains)} directions, {judged} judged, {threads} threads\n")
    print("| by | setting | median | P99 | µs a direction | spread | CPU, µs | prepared in, s | first call, s more |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    size = np.maximum(np.linalg.norm(exact, axis=1), 1e-3 * np.percentile(exact[:, 1], 99.0))
    for each, xyz in found.items():
        error = np.linalg.norm(xyz[:judged] - exact, axis=1) / size
        first, *warm = (1e6 * taken / len(seen.gains) for taken in wall[each])
        cpu = 1e6 * np.median(busy[each][1:]) / len(seen.gains)
        more = max(first - np.median(warm), 0.0) * 1e-6 * len(seen.gains)
        print(
            f"| {each} | {np.median(error):.1e} | {np.percentile(error, 99.0):.1e} | {np.median(warm):.2f} | "
            f"{min(warm):.2f} to {max(warm):.2f} | {cpu:.2f} | {prepared[each]:.2f} | {more:.2f} |",
            flush=True,
        )


def seen_by(hf: wd.HeightField, name: str, width: int) -> tuple[Directions, wd.View]:
    """What the pixels of a picture see: of the disc under a light that shows its spectra, or of the tube."""
    size = {"width": width, "height": width * 3 // 4}
    if name == DISC:
        mesh, light = meshes.disc(), wd.DirectionalLight((0.15, 0.9, 1.0))
        view = wd.View((0.0, -1.9, 2.3), (0.0, -0.05, 0.0), fov_y_deg=40.0, **size)
    else:
        mesh, light = meshes.tube(segments_along=128, segments_around=64), wd.DirectionalLight((0.1, 0.9, 1.2))
        view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, **size)
    window, device, threads = wd.Coherence(), resolve_device(None), resolve_threads(None)
    frame = render._Frame(prepare_surface(mesh), view, smooth=True, samples=1, device=device, threads=threads)
    lit = frame.light_arguments(light, window, hf.size_um[0] * hf.size_um[1], pigment=0.0, shadows=True)
    frame.light_up([lit], frame.reflection(optics.normal_reflectance(1.5), window, masking=True))
    frame.survey(hf, window)
    deflections, to_lights, gains = frame.directions()
    return Directions(np.float64(to_lights), deflections, np.float64(gains)), view


def pictures(folder: Path, hf: wd.HeightField, name: str, *, width: int = 320) -> Path:
    """Draw a scene by ours and by every peer at its best, each with its error against ours.

    All are at ours' exposure but the analytic shader's rainbow, whose brightness is the artist's.

    Args:
        folder: Where to.
        hf: The height field.
        name: Its name; the disc's lies on a disc, any other on the tube.
        width: Of each picture [pixels].

    Returns:
        The file.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from warpdiff.spectrum import srgb_encode, xyz_to_rgb

    every, view = seen_by(hf, name, width)
    lit = np.flatnonzero(every.gains > 0.0)
    seen = Directions(*(each[lit] for each in every))
    made: dict[str, Shade] = {"warpdiff, tolerance 0.001": ours(hf, seen, 1e-3)}
    for peer_name, peer in running().items():
        # The analytic shader's two forms are two models; of the others the last setting is the best.
        for setting in peer.SETTINGS if peer is stam_analytic else peer.SETTINGS[-1:]:
            made[f"{peer_name}, {label(setting)}"] = peer.prepare(hf, wd.Coherence(), **setting)
    mine, exposure = None, 0.0
    figure, axes = plt.subplots(len(made), figsize=(width / 80, len(made) * (width * 3 // 4 / 80 + 0.4)), squeeze=False)
    for axis, (each, shade) in zip(axes[:, 0], made.items(), strict=True):
        xyz = shade(seen.deflections, seen.gains, resolve_threads(None))
        if mine is None:
            mine, exposure = xyz, 5.0 / np.percentile(xyz[:, 1], 99.0)
        floor = 1e-3 * np.percentile(mine[:, 1], 99.0)
        error = np.linalg.norm(xyz - mine, axis=1) / np.maximum(np.linalg.norm(mine, axis=1), floor)
        image = np.zeros((view.height * view.width, 3))
        own = "rainbow" in each
        image[lit] = srgb_encode((1.0 / np.percentile(xyz[:, 1], 99.0) if own else exposure) * xyz_to_rgb(xyz))
        axis.imshow(image.reshape(view.height, view.width, 3))
        axis.set_axis_off()
        beside = (
            "" if xyz is mine else f"\nagainst ours: median {np.median(error):.1e}, P99 {np.percentile(error, 99):.1e}"
        )
        axis.set_title(each + (", its own exposure" if own else "") + beside, fontsize=7)
    figure.tight_layout()
    path = folder / f"peers_{name.split(',', maxsplit=1)[0].lower()}.png"
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
    plt.close(figure)
    return path


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--directions", type=int, default=2000, help="random directions to time (2000)")
    parser.add_argument("--judged", type=int, default=300, help="of these compared with the truth (300)")
    parser.add_argument("--rounds", type=int, default=5, help="timed rounds (5)")
    parser.add_argument("--threads", type=int, help="threads on the CPU (default: one a core)")
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    parser.add_argument("--surfaces", nargs="+", default=["fingers", "CD", "scan"], metavar="NAME")
    parser.add_argument("--pictures", type=Path, help="a folder to draw pictures into, in place of the tables")
    parser.add_argument("--no-rays", action="store_true", help="leave the table of rays out")
    given = parser.parse_args()
    data = inputs.folder(given.data)
    threads = resolve_threads(given.threads)
    chosen = {name: hf for name, hf in surfaces(data).items() if name.split(",", maxsplit=1)[0] in given.surfaces}
    if given.pictures:
        for name, hf in chosen.items():
            print(pictures(given.pictures, hf, name))
        return
    options = {"judged": given.judged, "rounds": given.rounds, "threads": threads, "peers": running()}
    for name, hf in chosen.items():
        shading(f"{name}, random directions", hf, Directions.random(given.directions), **options)
        if name == DISC:
            seen = Directions.random(given.directions, across=True)
            shading(f"{name}, across the tracks", hf, seen, **options)
    if given.no_rays:
        return
    for reason in raycasters.missing():
        print(f"Left out of the rays: {reason}.")
    view = wd.View((0.0, 0.8, 1.55), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=640, height=480)
    rays = raycasters.rays_of(meshes.tube(segments_along=128, segments_around=64), view)
    raycasters.table(rays, threads=tuple({1: 0, threads: 0}), rounds=given.rounds, judged=1000)


if __name__ == "__main__":
    main()
