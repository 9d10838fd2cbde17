"""Real spherical harmonics to degree 3, in the signs and order of the 3DGS trainer."""

from __future__ import annotations

from gs_codec.kernels import inlined
from gs_codec.scene import SH_C1, SH_C2, SH_C3


@inlined
def sh_basis(x, y, z, coefficients, basis):
    """Fill ``basis (15,)`` with the first `coefficients` SH-AC values in a unit direction."""
    if coefficients >= 3:
        basis[0] = -SH_C1 * y
        basis[1] = SH_C1 * z
        basis[2] = -SH_C1 * x
    if coefficients >= 8:
        basis[3] = SH_C2[0] * x * y
        basis[4] = -SH_C2[0] * y * z
        basis[5] = SH_C2[1] * (2.0 * z * z - x * x - y * y)
        basis[6] = -SH_C2[0] * x * z
        basis[7] = SH_C2[2] * (x * x - y * y)
    if coefficients >= 15:
        basis[8] = -SH_C3[0] * y * (3.0 * x * x - y * y)
        basis[9] = SH_C3[1] * x * y * z
        basis[10] = -SH_C3[2] * y * (4.0 * z * z - x * x - y * y)
        basis[11] = SH_C3[3] * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)
        basis[12] = -SH_C3[2] * x * (4.0 * z * z - x * x - y * y)
        basis[13] = SH_C3[4] * z * (x * x - y * y)
        basis[14] = -SH_C3[0] * x * (x * x - 3.0 * y * y)
