"""Commands that print tables and write CSV files: ``orders``, ``angles`` and ``spectrum``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import warpdiff as wd
from warpdiff.apps import cli_inputs
from warpdiff.apps.cli_options import given
from warpdiff.core.options import describe
from warpdiff.core.table import check_csv
from warpdiff.core.wording import ArgumentValueError, renaming
from warpdiff.request.settings import SpectralSettings

if TYPE_CHECKING:
    import argparse

    from numpy.typing import NDArray

    from warpdiff.core.table import Table

# Angle of the horizon from the normal [degrees]. Directions at or beyond the horizon are refused.
_GRAZING_DEG = 90.0
# Maximum number of steps between the wavelengths of a spectrum. It was chosen because a user who asks for more steps
# has probably mistaken the unit.
_MOST_WAVELENGTHS = 100_000


def direction_of(theta_deg: float, phi_deg: float, flag: str) -> NDArray[np.float64]:
    """Return the unit vector at the angle ``theta_deg`` from the normal and the azimuth ``phi_deg`` from the x axis.

    Error messages about ``theta_deg`` name the option ``flag``.
    """
    if not abs(theta_deg) < _GRAZING_DEG:
        raise ArgumentValueError(f"{flag} must be more than -90 and less than 90, got {theta_deg:g}")
    with renaming({"phi_deg": flag.replace("--incidence", "--azimuth").replace("--view-deg", "--view-azimuth-deg")}):
        return wd.direction(theta_deg, phi_deg)


def orders(options: argparse.Namespace) -> None:
    """Run ``warpdiff orders``: print the efficiencies of the strongest diffraction orders of a height field."""
    _check_csv(options)
    heightfield = cli_inputs.height_field_of(options)
    to_light = direction_of(options.incidence_deg, options.azimuth_deg, "--incidence-deg")
    result = wd.order_efficiencies(
        heightfield, to_light, options.wavelengths_nm, material=cli_inputs.material_of(options),
        **given(options, describe(wd.order_efficiencies)),
    )  # fmt: skip
    with renaming({"count": "--count"}):
        table = result.table(options.count)
    _print(table, options, result.table())
    print(f"The orders are {result.verdict}.")


def angles(options: argparse.Namespace) -> None:
    """Run ``warpdiff angles``: print the angles of diffraction orders.

    The orders are those of each period that is measured in the height field.
    """
    _check_csv(options)
    heightfield = cli_inputs.height_field_of(options)
    to_light = direction_of(options.incidence_deg, options.azimuth_deg, "--incidence-deg")
    _print(
        wd.order_angles(heightfield, to_light, options.wavelengths_nm, **given(options, describe(wd.order_angles))),
        options,
    )


def spectrum(options: argparse.Namespace) -> None:
    """Run ``warpdiff spectrum``: print the reflectance spectrum for one direction of the light and one of the view."""
    _check_csv(options)
    if not options.step_nm > 0.0:
        raise ArgumentValueError(f"--step-nm must be more than 0, got {options.step_nm:g}")
    if not 0.0 <= options.to_nm - options.from_nm <= _MOST_WAVELENGTHS * options.step_nm:
        raise ArgumentValueError(
            f"--to-nm must be at least --from-nm, and {_MOST_WAVELENGTHS} steps at most, got {options.from_nm:g} to "
            f"{options.to_nm:g} in steps of {options.step_nm:g}"
        )
    # The end of the range is increased by a millionth of a step, so that rounding cannot exclude the last wavelength.
    wavelengths = np.arange(options.from_nm, options.to_nm + 1e-6 * options.step_nm, options.step_nm)
    settings = cli_inputs.settings_of(options, SpectralSettings)
    to_light = direction_of(options.incidence_deg, options.azimuth_deg, "--incidence-deg")
    to_view = direction_of(options.view_deg, options.view_azimuth_deg, "--view-deg")
    heightfield = cli_inputs.height_field_of(options)
    result = wd.reflectance_spectra(heightfield, to_light, to_view, wavelengths, **settings, progress=options.progress)
    _print(result.table(), options)


def _check_csv(options: argparse.Namespace) -> None:
    """Raise an error if the file of ``--csv`` cannot be written, before the result is computed."""
    if options.csv is not None:
        with renaming({"path": "--csv"}):
            check_csv(options.csv)


def _print(table: Table, options: argparse.Namespace, whole: Table | None = None) -> None:
    """Print a table, and write it to the file of ``--csv``.

    If the printed table is shortened, ``whole`` is the table with all rows, and the file contains ``whole``.
    """
    print(table)
    if options.csv is not None:
        print((table if whole is None else whole).save(options.csv))
