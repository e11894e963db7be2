"""Design of foils: surfaces with requested colours and orders, by the derivatives of ``warpdiff.adjoint``."""
