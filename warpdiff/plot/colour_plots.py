"""Plots in display colours: reflectance over all view directions, and against the view angle in one plane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Unpack

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.heightfield.field import HeightField
from warpdiff.image.display_transform import to_srgb
from warpdiff.image.image import Image
from warpdiff.plot.axes import axes_for, outlined
from warpdiff.request.settings import ColourSettings, Display
from warpdiff.request.signatures import accepts, checked

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.request.keywords import ColourKeywords

# Width and height of the reflectance map that is computed to plot a height field [pixels].
_MAP_PIXELS = 480
# View angles at which a height field is evaluated for a strip of colours [degrees]. The step is about half of the
# angular width of a diffraction order at the default coherence length.
_STRIP_DEG = np.arange(-89.75, 89.76, 0.25)
# Angles from the normal at which a reflectance map has circles [degrees].
_CIRCLES_DEG = (30.0, 60.0)


@checked
@accepts(ColourSettings)
def reflectance_map(
    source: HeightField | Image, to_light: ArrayLike | None = None, *, ax: Axes | None = None,
    display: Display = "aces", title: str | None = None, **settings: Unpack[ColourKeywords],
) -> Axes:  # fmt: skip
    """Plot the display colours of the reflectance over all view directions, for one direction to the light.

    The plot is a disc over the x and y components of the view direction: its centre is the normal and its rim the
    horizon. Circles are at 30° and 60° from the normal. A small circle marks the direction to the light, and a cross
    its mirror direction.

    Args:
        source: Height field, which is evaluated with default settings, or the picture that
            :func:`warpdiff.reflectance_map` returned.
        to_light: Direction to the light in the local frame, shape (3,); required for a height field. The plot marks
            this direction and its mirror direction. For a picture, None is possible and marks nothing.
        ax: Axes to draw into; None makes a figure.
        display: Display transform, as in :meth:`warpdiff.Image.display`.
        title: Title; None states the direction of the light.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed.
        TypeError: ``source`` is neither a height field nor a picture.
        ValueError: ``to_light`` is missing, or not above the horizon.

    Examples:
        >>> import warpdiff as wd
        >>> picture = wd.reflectance_map(wd.gratings.sinusoidal(2.0, 0.1), (0, 0, 1), size=32)
        >>> axes = wd.plot.reflectance_map(picture, (0, 0, 1))
        >>> axes.get_title()
        'Reflectance, light at 0° from the normal'
    """
    light = None
    if to_light is not None:
        light = validation.unit_directions(validation.vector(to_light, "to_light"), "to_light")[0][0]
    if isinstance(source, HeightField):
        if to_light is None:
            raise ArgumentValueError(f"{ref('to_light')} is required with a height field, got None: give a direction")
        # This import loads Warp, which is needed only to evaluate a height field.
        from warpdiff.evaluate.reflectance import reflectance_map as evaluate

        source = evaluate(source, to_light, size=_MAP_PIXELS)
    elif not isinstance(source, Image):
        raise ArgumentTypeError(
            f"{ref('source')} must be a warpdiff.HeightField or the picture of reflectance_map, got "
            f"{type(source).__name__}"
        )
    ax = axes_for(ax, width=5.2, height=5.2)
    colours = source.display(display, **settings)
    ax.imshow(colours, extent=(-1.0, 1.0, -1.0, 1.0), interpolation="antialiased")
    _add_directions(ax, light)
    angle = "" if light is None else f", light at {math.degrees(math.acos(min(light[2], 1.0))):.3g}° from the normal"
    ax.set_title(f"Reflectance{angle}" if title is None else title)
    return ax


def _add_directions(ax: Axes, light: NDArray[np.float64] | None) -> None:
    """Draw axis labels, circles of equal angle from the normal, light and mirror direction into a reflectance map."""
    from matplotlib.patches import Circle

    for angle in _CIRCLES_DEG:
        radius = math.sin(math.radians(angle))
        ax.add_patch(Circle((0.0, 0.0), radius, fill=False, edgecolor="white", linewidth=0.7, alpha=0.6))
        place = radius * math.sqrt(0.5)
        ax.text(place, place, f"{angle:g}°", fontsize="small", ha="center", va="center", **outlined())
    ax.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor="0.3", linewidth=1.0))
    ax.text(0.735, 0.735, "90°", fontsize="small", ha="left", va="bottom")
    if light is not None:
        for direction, marker, name in ((-light, "+", "mirror direction"), (light, "o", "light")):
            for colour, size, width in (("black", 15.0, 3.2), ("white", 13.0, 1.4)):
                ax.plot(
                    direction[0], direction[1], marker, color=colour, markersize=size if marker == "+" else 0.6 * size,
                    markerfacecolor="none", markeredgewidth=width,
                )  # fmt: skip
            ax.annotate(
                name,
                (direction[0], direction[1]),
                xytext=(8, -13),
                textcoords="offset points",
                fontsize="small",
                **outlined(),
            )
    ax.set_xlim(-1.02, 1.02)
    ax.set_ylim(-1.02, 1.02)
    ax.set_xticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    ax.set_yticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    ax.spines[:].set_visible(False)
    ax.set_xlabel("x component of the view direction")
    ax.set_ylabel("y component of the view direction")


@checked
@accepts(ColourSettings)
def colour_strip(
    source: HeightField | ArrayLike, to_light: ArrayLike | None = None, *, angles_deg: ArrayLike | None = None,
    azimuth_deg: float | None = None, ax: Axes | None = None, display: Display = "aces",
    title: str | None = None, **settings: Unpack[ColourKeywords],
) -> Axes:  # fmt: skip
    """Plot the display colours against the view angle, in a plane through the normal.

    Args:
        source: Height field, which is evaluated with default settings, or the XYZ of
            :func:`warpdiff.reflectance` in the directions of ``angles_deg``, shape (n, 3).
        to_light: Direction to the light in the local frame, shape (3,); required for a height field. The plot marks the
            mirror direction of the light if this lies in the plane.
        angles_deg: View angles from the normal [degrees], increasing, shape (n,). None is −89.75 to 89.75 in steps of
            0.25 for a height field.
        azimuth_deg: Azimuth of the plane from the x axis [degrees]; positive view angles are on the side of this
            azimuth. None is the plane through the normal and the light, with an azimuth from −90 to 90 degrees. For a
            light along the normal, None is 0.
        ax: Axes to draw into; None makes a figure.
        display: Display transform, as in :meth:`warpdiff.Image.display`.
        title: Title; None states the direction of the light.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: An argument is missing, or the shapes of ``source`` and ``angles_deg`` differ.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> angles_deg = np.linspace(-80.0, 80.0, 161)
        >>> angles = np.radians(angles_deg)
        >>> to_view = np.stack([np.sin(angles), 0.0 * angles, np.cos(angles)], axis=1)
        >>> xyz = wd.reflectance(wd.gratings.sinusoidal(2.0, 0.1), (0, 0, 1), to_view)
        >>> axes = wd.plot.colour_strip(xyz, angles_deg=angles_deg)
        >>> axes.get_xlabel()
        'view angle from the normal [°]'
    """
    light = None
    if to_light is not None:
        light = validation.unit_directions(validation.vector(to_light, "to_light"), "to_light")[0][0]
    azimuth = _azimuth_of(light) if azimuth_deg is None else math.radians(azimuth_deg)
    if angles_deg is None:
        if not isinstance(source, HeightField):
            raise ArgumentValueError(f"{ref('angles_deg')} is required with XYZ, got None: give the view angles")
        angles_deg = _STRIP_DEG
    angles = validation.finite_array(angles_deg, "angles_deg", ndim=1, most=90.0)
    if len(angles) < 2 or np.min(np.diff(angles)) <= 0.0:
        raise ArgumentValueError(f"{ref('angles_deg')} must be at least two increasing angles, got {len(angles)}")
    if isinstance(source, HeightField):
        if to_light is None:
            raise ArgumentValueError(f"{ref('to_light')} is required with a height field, got None: give a direction")
        from warpdiff.evaluate.reflectance import reflectance

        radians = np.radians(angles)
        views = np.stack(
            [np.sin(radians) * math.cos(azimuth), np.sin(radians) * math.sin(azimuth), np.cos(radians)], axis=1
        )
        xyz = np.asarray(reflectance(source, to_light, views), dtype=np.float64)
    else:
        xyz = validation.finite_array(source, "source", most=validation.MOST)
        if xyz.shape != (len(angles), 3):
            raise ArgumentValueError(
                f"{ref('source')} must have the shape ({len(angles)}, 3), a colour per angle, got {xyz.shape}"
            )
    ax = axes_for(ax, width=7.0, height=1.9)
    colours = to_srgb(xyz, display, **settings)
    # In the strip, each colour extends halfway to the neighbouring view angles.
    edges = np.concatenate([[angles[0]], 0.5 * (angles[1:] + angles[:-1]), [angles[-1]]])
    ax.pcolormesh(edges, [0.0, 1.0], colours[None], rasterized=True)
    ax.set_yticks([])
    ax.set_xlabel("view angle from the normal [°]")
    if light is not None and abs(-light[0] * math.sin(azimuth) + light[1] * math.cos(azimuth)) < 1e-6:
        mirror = -math.degrees(math.atan2(light[0] * math.cos(azimuth) + light[1] * math.sin(azimuth), light[2]))
        ax.plot([mirror], [1.0], "v", color="black", markersize=8.0, clip_on=False, transform=ax.get_xaxis_transform())
        ax.annotate(
            "mirror direction", (mirror, 1.0), xycoords=ax.get_xaxis_transform(), xytext=(0, 6),
            textcoords="offset points", ha="center", fontsize="small",
        )  # fmt: skip
    angle = "" if light is None else f", light at {math.degrees(math.acos(min(light[2], 1.0))):.3g}°"
    ax.set_title(f"Colour against view angle{angle}" if title is None else title, pad=None if light is None else 18.0)
    return ax


def _azimuth_of(light: NDArray[np.float64] | None) -> float:
    """Return the azimuth of the plane through the normal and the light, from −π/2 to π/2 [rad].

    Without a light, and for a light along the normal, the azimuth is 0.
    """
    if light is None or math.hypot(light[0], light[1]) < 1e-9:
        return 0.0
    azimuth = math.atan2(light[1], light[0])
    return azimuth - math.copysign(math.pi, azimuth) if abs(azimuth) > 0.5 * math.pi + 1e-12 else azimuth
