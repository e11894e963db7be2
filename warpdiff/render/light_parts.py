"""Parts of the lights of a picture (lobes, discs and skies), after checks against the coherence of its surfaces.

Coherence states how far light interferes. A lobe is a Gaussian of directions or a single direction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.lights.base import MANY_LIGHTS, Light, LobeChoice, LobeSet

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.lights.base import LightPart, Lobe
    from warpdiff.optics.coherence import Coherence
    from warpdiff.request.evaluation import Evaluation


def check_extent(light: Light, name: str, coherence: Coherence, *, means: bool) -> None:
    """Raise an error if a light has an extent (not a single direction), but coherence or settings do not permit it.

    With a coherence of the kind ``"source"``, which has an angular diameter itself, lights must have no extent. With
    other coherences, lights with an extent require that pixels show means over footprints (areas of pixel filters).
    """
    if coherence.kind == "source":
        raise ArgumentValueError(
            f"{ref(name)} must not have an extent of its own with {ref('coherence')} of kind 'source', whose diameter "
            f"is that of all lights, got {light!r}: give one of them"
        )
    if not (means and coherence.adds_powers):
        raise ArgumentValueError(
            f"{ref(name)} has an extent and requires footprints, which {ref('coherence')} of kind {coherence.kind!r}, "
            f"{ref('footprint', False)}, {ref('wavelengths_nm')}, {ref('method', 'direct')} or a {ref('plan')} without "
            "footprints excludes, got "
            f"{light!r}: give several lights without an extent"
        )


def parts_of(
    lights: Sequence[Light], evaluation: Evaluation, *, refine: bool, means: bool, first: int = 0
) -> list[LightPart]:
    """Check lights and return their parts. Without refinement, disc lights of up to 5° become single lobes.

    ``first`` is the index of the first light among the lights of the picture, for errors.

    The lobes of all lights form one part, so that the error of a pixel is estimated for the sum of their colours. An
    uneven surface causes errors under each light, and separate estimates would not bound the sum of these errors. Many
    directional lights with the same illuminant are an exception: in refined pictures they form a part of their own.
    Each subpixel cell then chooses one of these lights at random.
    """
    lobes: list[Lobe] = []
    others: list[LightPart] = []
    for index, light in enumerate(lights, first):
        name = f"lights[{index}]"
        for part in light.parts(evaluation.coherence, single_lobe=not refine, name=name):
            if part.has_extent:
                check_extent(light, name, evaluation.coherence, means=means)
            # Lobes (single directions or Gaussians of directions) of a plain ``LobeSet`` are joined. A subclass that
            # overrides ``make_pass``, such as a wide disc, stays a separate part.
            if isinstance(part, LobeSet) and type(part).make_pass is LobeSet.make_pass:
                lobes += [replace(lobe, name=f"{ref(name)} ({type(light).__name__})") for lobe in part.lobes]
            else:
                others.append(part)
    chosen: list[LightPart] = []
    if refine and evaluation.footprint and evaluation.coherence.kind == "averaged":
        for spectrum in dict.fromkeys(lobe.illuminant for lobe in lobes):
            group = tuple(lobe for lobe in lobes if lobe.illuminant == spectrum and lobe.is_direction)
            if len(group) >= MANY_LIGHTS:
                chosen.append(LobeChoice(group))
                lobes = [lobe for lobe in lobes if lobe not in group]
    return [*([LobeSet(tuple(lobes))] if lobes else []), *chosen, *others]
