"""Plots of height fields and results with matplotlib, public as ``wd.plot``; requires ``pip install 'warpdiff[plot]'``.

The functions plot height fields, order efficiencies, spectra, pictures, and plans (choices of a method with predicted
errors). Each function accepts ``ax=``, the matplotlib axes to draw into; by default the function makes a new figure.
The function returns the axes, and ``axes.figure.savefig("plot.png")`` writes the figure to a file.

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
