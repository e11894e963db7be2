"""Plots of height fields and results with matplotlib, public as ``wd.plot`` (extra ``plot``).

In: height fields, order efficiencies, spectra, pictures and plans. Each function accepts ``ax=``, matplotlib axes that
it draws into; the default is a new figure.
Out: the axes. ``ax.figure.savefig("plot.png")`` writes a file.

matplotlib is imported when the first plot is drawn.

Examples:
    >>> import warpdiff as wd
    >>> axes = wd.plot.height_map(wd.gratings.bumps())
    >>> axes.get_xlabel()
    'x [µm]'
"""

from warpdiff.plot.colour_plots import colour_strip, reflectance_map
from warpdiff.plot.error_plots import error_image, plan
from warpdiff.plot.order_plots import orders, spectra
from warpdiff.plot.surface_plots import height_map, power_spectrum, profile

__all__ = [
    "colour_strip", "error_image", "height_map", "orders", "plan", "power_spectrum", "profile", "reflectance_map",
    "spectra",
]  # fmt: skip
