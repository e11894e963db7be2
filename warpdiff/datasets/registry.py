"""Registry of the data sets: address, licence, checksum and scale of each file."""

from __future__ import annotations

from dataclasses import dataclass

from warpdiff.core.wording import ArgumentValueError, did_you_mean, ref


@dataclass(frozen=True)
class Dataset:
    """Source and scale of a published height field.

    Attributes:
        title: Measured surface and instrument.
        address: Web address of a fixed version of the file.
        licence: Licence of the file, and laboratory that measured the surface.
        sha256: SHA-256 checksum of the file, in hexadecimal digits.
        size_bytes: Size of the file [bytes].
        local_name: Name of the file in the folder ``WARPDIFF_DATA``.
        extent_um: Width of the field along x [µm]; the pitch along y is the same as along x.
        height_range_um: Difference of height between the values 255 and 0 of the image's first channel [µm].

    Examples:
        >>> import warpdiff as wd
        >>> scan = wd.datasets.info("corn_snake_scan")
        >>> isinstance(scan, wd.datasets.Dataset), scan.size_bytes
        (True, 1608068)
    """

    title: str
    address: str
    licence: str
    sha256: str
    size_bytes: int
    local_name: str
    extent_um: float
    height_range_um: float


_DATASETS = {
    "corn_snake_scan": Dataset(
        title="shed skin of a corn snake (Elaphe guttata), scanned by an atomic force microscope",
        address=(
            "https://raw.githubusercontent.com/simplay/Bachelor-Thesis/ef450c5420b768b2a1fd84c9ad768f34db12fc88/"
            "document/Figures/results/misc/Elaphe65microns.png"
        ),
        licence=(
            "the repository is under the MIT licence (M. Single, 2014–2016); the LANE laboratory, Geneva, measured the "
            "scan, which is not distributed with warpdiff"
        ),
        sha256="fe49cf29a7527cf022a3860c0e25af9e6809b26a9ecb9662e1189f6ca79b6516",
        size_bytes=1_608_068,
        local_name="elaphe_65um.png",
        extent_um=65.0,
        # The image file does not record the height range of the scan. This value is that of the preprocessing that was
        # published with the scan. If it is wrong, computed colours are wrong, too.
        height_range_um=0.375,
    )
}


def info(name: str) -> Dataset:
    """Return the source, licence, checksum and scale of a data set.

    Args:
        name: Name of the data set: ``"corn_snake_scan"``.

    Raises:
        ValueError: There is no data set of this name.

    Examples:
        >>> import warpdiff as wd
        >>> wd.datasets.info("corn_snake_scan").height_range_um
        0.375
    """
    if not isinstance(name, str) or name not in _DATASETS:
        raise ArgumentValueError(
            f"{ref('name')} must be one of {', '.join(map(repr, _DATASETS))}, got {name!r}"
            f"{did_you_mean(name, _DATASETS)}"
        )
    return _DATASETS[name]
