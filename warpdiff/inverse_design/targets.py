"""``Target``: a colour or efficiencies of orders that a designed surface shall have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref, renaming
from warpdiff.evaluate.orders import energy_or_default
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import check_covers, check_reflection, reflectance_at
from warpdiff.request.settings import Energy, check_energy

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.optics.materials import Material
    from warpdiff.optics.spectra import Spectrum

    Array = NDArray[np.float64]

# Largest number of orders of a target. The value is limited by the time of the search, which changes single pixels and
# sums the changes of all orders.
_MOST_ORDERS = 100_000
# Largest accepted magnitude of the index of an order. The value is far above the orders that propagate for any period.
_LARGEST_ORDER = 1e9
# Largest accepted X and Z of a requested colour, whose Y is at most 1. No spectrum has X or Z above 200 times Y.
_MOST_XYZ = 200.0
# Wavelength for which the default depth of a relief for colours is computed [nm]. The value was chosen near the middle
# of the visible range, but towards red, so that the phase of red light also varies by nearly a full cycle.
_COLOUR_NM = 600.0


@dataclass(frozen=True)
class Optics:
    """Material, illuminant and coherence of a target. Targets of colours with equal optics are evaluated together.

    Attributes:
        ior: Index of refraction, or None.
        material: Material, or None.
        energy: ``"stam"`` for efficiencies of Stam's theory, or ``"normalised"`` for ones that conserve energy.
        illuminant: Illuminant of colours.
        coherence: Coherence of colours.
        masking: Whether colours include V-cavity masking.
    """

    ior: float | None
    material: Material | None
    energy: Energy = "stam"
    illuminant: str | Spectrum = "D65"
    coherence: Coherence = field(default_factory=Coherence)
    masking: bool = True


@dataclass(frozen=True, eq=False)
class Target:
    """Property that a designed surface shall have: a colour, or efficiencies of orders.

    Attributes:
        kind: ``"colour"``, ``"orders"`` or ``"equal"``.
        to_light: Unit vector to the light, shape (3,).
        requested: XYZ, shape (3,); or efficiencies of the orders, shape (n,); NaN for equal orders.
        to_view: Unit vector to the viewer of a colour, shape (3,).
        pairs: Orders (m_y, m_x), shape (n, 2).
        wavelength_nm: Wavelength of the orders [nm].
        optics: Material, illuminant and coherence of the target.

    Examples:
        >>> import math
        >>> import warpdiff as wd
        >>> wd.Target.colour((0.27, 0.55, 0.09), (0, 0, 1), wd.direction(20.0), ior=math.inf)
        Target(colour, XYZ 0.27 0.55 0.09)
        >>> wd.Target.equal([(0, m) for m in range(-3, 4)], (0, 0, 1), 632.8, ior=math.inf)
        Target(equal, 7 orders at 632.8 nm)
    """

    kind: Literal["colour", "orders", "equal"]
    to_light: Array
    requested: Array
    to_view: Array = field(repr=False)
    pairs: NDArray[np.int64] = field(repr=False)
    wavelength_nm: float = field(repr=False)
    optics: Optics = field(repr=False)

    def __repr__(self) -> str:
        if self.kind == "colour":
            return f"Target(colour, XYZ {' '.join(f'{value:g}' for value in self.requested)})"
        return f"Target({self.kind}, {len(self.pairs)} orders at {self.wavelength_nm:g} nm)"

    @classmethod
    def colour(
        cls, xyz: ArrayLike, to_light: ArrayLike, to_view: ArrayLike, *, illuminant: str | Spectrum = "D65",
        coherence: Coherence | None = None, ior: float | None = None, material: Material | None = None,
        masking: bool = True,
    ) -> Target:  # fmt: skip
        """Request a colour of the surface, for one direction to the light and one direction to the viewer.

        Colours are compared in CIE Lab with the white D65, at one exposure for all colours of a design, which is
        fitted: XYZ of :func:`warpdiff.reflectance` times the exposure shall be ``xyz``. Gratings reflect a small part
        of the light into each direction, so that only the ratios of the colours of a design are absolute.

        Args:
            xyz: CIE XYZ, positive, relative to a white of Y = 1, X and Z up to 200, shape (3,).
            to_light: Direction to the light, shape (3,).
            to_view: Direction to the viewer, shape (3,).
            illuminant: Name in colour-science's ``SDS_ILLUMINANTS``, or a ``Spectrum``.
            coherence: Averaged window or source; None is an averaged window of σ = 16.25 µm.
            ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
            material: Material of the surface instead of ``ior``.
            masking: Whether V-cavity masking is included, by default True.

        Raises:
            ValueError: An argument is out of its range, a direction is below the horizon, or the coherence has
                speckle (``"centred"``, ``"replicas"``).
        """
        colour = validation.vector(xyz, "xyz")
        if colour.min() <= 0.0 or colour[1] > 1.0 or colour.max() > _MOST_XYZ:
            raise ArgumentValueError(
                f"{ref('xyz')} must be positive, have Y of at most 1, the white, and X and Z of at most {_MOST_XYZ:g}, "
                f"got {colour.tolist()}: divide it by Y of the white"
            )
        validation.instance(coherence, Coherence, "coherence", optional=True)
        form = Coherence() if coherence is None else coherence
        if form.kind not in ("averaged", "source"):
            raise ArgumentValueError(
                f"{ref('coherence')} must be averaged or a source, got {form.kind!r}: other kinds have speckle, which "
                "no design can control"
            )
        _, material = check_reflection(ior, material)
        if material is not None:
            check_covers(material, float(colorimetry.LAMBDA_MIN_NM), float(colorimetry.LAMBDA_MAX_NM))
        colorimetry.check_illuminant(illuminant)
        optics = Optics(
            ior, material, illuminant=illuminant, coherence=form, masking=validation.flag(masking, "masking")
        )
        light, view = _direction(to_light, "to_light"), _direction(to_view, "to_view")
        return cls("colour", light, colour, view, np.zeros((0, 2), dtype=np.int64), _COLOUR_NM, optics)

    @classmethod
    def orders(
        cls, efficiencies: Mapping[tuple[int, int], float], to_light: ArrayLike, wavelength_nm: float, *,
        ior: float | None = None, material: Material | None = None, energy: Energy | None = None,
    ) -> Target:  # fmt: skip
        """Request efficiencies of diffraction orders.

        Args:
            efficiencies: Reflected power relative to the incident power, 0 to 1, by order (m_y, m_x).
            to_light: Direction to the light, shape (3,).
            wavelength_nm: Wavelength [nm].
            ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
            material: Material of the surface instead of ``ior``.
            energy: ``"stam"`` or ``"normalised"``, as for :func:`warpdiff.order_efficiencies`.

        Raises:
            ValueError: An argument is out of its range, or the efficiencies add up to more than a flat surface of
                the material reflects.

        Examples:
            >>> import math
            >>> wd.Target.orders({(0, 1): 0.3, (0, 0): 0.0}, (0, 0, 1), 550.0, ior=math.inf)
            Target(orders, 2 orders at 550 nm)
        """
        if not isinstance(efficiencies, Mapping):
            raise ArgumentTypeError(
                f"{ref('efficiencies')} must be a dictionary by order (m_y, m_x), got {type(efficiencies).__name__}"
            )
        for order, value in efficiencies.items():
            if isinstance(value, (bool, np.bool_)):
                raise ArgumentTypeError(f"{ref('efficiencies')} must be numbers, got {value!r} for the order {order!r}")
        values = validation.finite_array(list(efficiencies.values()), "efficiencies")
        target = cls._of_orders(
            "orders", efficiencies, values, to_light, wavelength_nm, Optics(ior, material), energy, "efficiencies"
        )
        if values.min() < 0.0 or not 0.0 < values.sum() <= target.flat_reflectance:
            raise ArgumentValueError(
                f"{ref('efficiencies')} must be at least 0 and add up to more than 0 and at most "
                f"{target.flat_reflectance:.3g}, which a flat surface reflects, got a sum of {values.sum():.3g}: give "
                f"{ref('material')} or another {ref('ior')}"
            )
        return target

    @classmethod
    def equal(
        cls, orders: Iterable[tuple[int, int]], to_light: ArrayLike, wavelength_nm: float, *,
        ior: float | None = None, material: Material | None = None, energy: Energy | None = None,
    ) -> Target:  # fmt: skip
        """Request equal efficiencies of some orders, as large as possible.

        Args:
            orders: Orders (m_y, m_x), at least one.
            to_light: Direction to the light, shape (3,).
            wavelength_nm: Wavelength [nm].
            ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
            material: Material of the surface instead of ``ior``.
            energy: ``"stam"`` or ``"normalised"``, as for :func:`warpdiff.order_efficiencies`.

        Raises:
            ValueError: An argument is out of its range.
        """
        pairs = _listed(orders, "orders")
        values = np.full(len(pairs), np.nan)
        return cls._of_orders("equal", pairs, values, to_light, wavelength_nm, Optics(ior, material), energy, "orders")

    @classmethod
    def _of_orders(
        cls, kind: Literal["orders", "equal"], orders: Iterable[tuple[int, int]], values: Array, to_light: ArrayLike,
        wavelength_nm: float, optics: Optics, energy: Energy | None, name: str,
    ) -> Target:  # fmt: skip
        """Return a target of order efficiencies after checks; ``name`` is the caller's argument with the orders."""
        pairs = validation.finite_array(_listed(orders, name), name, most=_LARGEST_ORDER)
        if pairs.ndim != 2 or pairs.shape[1] != 2 or np.any(pairs != np.rint(pairs)) or len(pairs) > _MOST_ORDERS:
            raise ArgumentValueError(
                f"{ref(name)} must be 1 to {_MOST_ORDERS} pairs of integers (m_y, m_x), got shape {pairs.shape}"
            )
        if len(np.unique(pairs, axis=0)) < len(pairs):
            raise ArgumentValueError(f"{ref(name)} must be different orders, got {len(pairs)} with repetitions")
        with renaming({"wavelengths_nm": "wavelength_nm"}):
            wavelength = float(colorimetry.check_wavelengths(validation.number(wavelength_nm, "wavelength_nm"))[0])
        normal, material = check_reflection(optics.ior, optics.material)
        if material is not None:
            check_covers(material, wavelength, wavelength)
        energy = check_energy(energy_or_default(energy, normal, material))
        light = _direction(to_light, "to_light")
        return cls(
            kind, light, values, light, pairs.astype(np.int64), wavelength, Optics(optics.ior, material, energy=energy)
        )

    @property
    def flat_reflectance(self) -> float:
        """Reflectance of a flat surface at the wavelength and the direction of the light."""
        cosine = self.to_light[2:]
        if self.optics.material is not None:
            return float(reflectance_at(self.optics.material, np.array([self.wavelength_nm]), cosine)[0])
        return float(reflectance_factors.schlick(cosine, check_reflection(self.optics.ior, None)[0])[0])

    @property
    def cycle_um(self) -> float:
        """Depth [µm] that changes the phase of the reflected light by a full cycle."""
        return 1e-3 * self.wavelength_nm / float(self.to_light[2] + self.to_view[2])


def _listed(orders: Iterable[tuple[int, int]], name: str) -> list[tuple[int, int]]:
    """Return diffraction orders as a list; raise an error if they are no sequence. ``name`` is the argument's name."""
    try:
        return list(orders)
    except TypeError:
        raise ArgumentTypeError(
            f"{ref(name)} must be a sequence of pairs (m_y, m_x), got {type(orders).__name__}"
        ) from None


def _direction(value: ArrayLike, name: str) -> Array:
    """Return a single direction above the horizon as a unit vector, shape (3,)."""
    unit, is_single = validation.unit_directions(value, name)
    if not is_single or unit[0, 2] <= HORIZON:
        raise ArgumentValueError(f"{ref(name)} must be one direction above the horizon, shape (3,), got {value!r:.60}")
    return np.asarray(unit[0])
