"""Names of `diagnostics` that the planner still imports from here."""

from warpdiff.heightfield.diagnostics import SCALAR_INVALID as UNTRUSTED  # noqa: F401
from warpdiff.heightfield.diagnostics import WAVELENGTH_NM  # noqa: F401
from warpdiff.heightfield.diagnostics import scalar_error_bound as error_bound  # noqa: F401
from warpdiff.heightfield.diagnostics import scalar_error_text as told  # noqa: F401
