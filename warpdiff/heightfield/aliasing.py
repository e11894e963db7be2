"""Names of `diagnostics` that the planner still imports from here."""

from warpdiff.heightfield.diagnostics import coarsest_pitch_um, folded_power  # noqa: F401
