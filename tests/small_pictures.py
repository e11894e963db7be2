"""Replacements of public functions that draw small, rough pictures, so that examples and pages run quickly."""

import dataclasses
import functools

import warpdiff as wd

# Largest number of pixels along the longer side of a picture.
MOST_PIXELS = 32


def smaller(view):
    """Return a copy of the view with few pixels."""
    scale = MOST_PIXELS / max(view.width, view.height)
    size = {name: max(round(scale * getattr(view, name)), 2) for name in ("width", "height")}
    return dataclasses.replace(view, **size)


class SmallView:
    """Replacement for ``wd.View`` in an example, which makes views with few pixels."""

    def __call__(self, *arguments, **options):
        return smaller(wd.scene.camera.View(*arguments, **options))

    def fit(self, *arguments, **options):
        return smaller(wd.scene.camera.View.fit(*arguments, **options))


def rough(function, **fixed):
    """Return the function with some of its arguments fixed, so that it runs faster."""

    @functools.wraps(function)
    def call(*arguments, **options):
        return function(*arguments, **options | fixed)

    return call


def _by_surface(of_fields, of_maps):
    """Return a function that calls ``of_maps`` if its second argument is a grating map, otherwise ``of_fields``."""

    @functools.wraps(of_fields)
    def call(*arguments, **options):
        return (of_maps if isinstance(arguments[1], wd.GratingMap) else of_fields)(*arguments, **options)

    return call


def draw_roughly(monkeypatch):
    """Make views small, and computations fast but inaccurate.

    Tolerances are large, coherence windows are short, fits start from two initial guesses, and searches for designs end
    after few iterations.
    """
    window = wd.Coherence(sigma_um=1.5)
    monkeypatch.setattr(wd, "View", SmallView())
    for name in ("shade", "Renderer"):
        function = getattr(wd, name)
        with_window = rough(function, tolerance=0.3, coherence=window)
        # If the dots of a grating map (an array of gratings) differ in pitch, the coherence model must be "source".
        of_maps = rough(function, tolerance=0.3, coherence=wd.Coherence("source", angular_diameter_deg=15.0))
        monkeypatch.setattr(wd, name, _by_surface(with_window, of_maps))
    monkeypatch.setattr(wd, "bake", rough(wd.bake, delta_e=20.0, coherence=window))
    monkeypatch.setattr(wd, "fit", rough(wd.fit, starts=2))
    for name in ("_MOST_FIRST", "_MOST_ITERATIONS", "_MOST_PENALISED"):
        monkeypatch.setattr(f"warpdiff.inverse_design.design_search.{name}", 10)


def draw_reports_roughly(monkeypatch):
    """Give the pictures of reports few pixels. Their numbers and tables do not change."""
    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 24)
    monkeypatch.setattr("warpdiff.apps.report.report_figures._DPI", 30)
