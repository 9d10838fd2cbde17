"""Real spherical harmonics to degree 3, with the trainer's signs and order; their gradient."""

from __future__ import annotations

from gs_codec.runtime.kernels import inlined
from gs_codec.scene import SH_C1, SH_C2, SH_C3, sh_values

#: `sh_values` for kernels.
sh_basis = inlined(sh_values)


@inlined
def sh_slope(x, y, z, coefficients, weights):
    """Gradient, by direction, of the sum of SH-AC values times ``weights (15,)``; see `sh_basis`.

    Only the first `coefficients` weights are used.
    """
    by_x = by_y = by_z = 0.0
    if coefficients >= 3:
        by_x -= SH_C1 * weights[2]
        by_y -= SH_C1 * weights[0]
        by_z += SH_C1 * weights[1]
    if coefficients >= 8:
        w3, w4, w5 = SH_C2[0] * weights[3], SH_C2[0] * weights[4], 2.0 * SH_C2[1] * weights[5]
        w6, w7 = SH_C2[0] * weights[6], 2.0 * SH_C2[2] * weights[7]
        by_x += w3 * y - w5 * x - w6 * z + w7 * x
        by_y += w3 * x - w4 * z - w5 * y - w7 * y
        by_z += 2.0 * w5 * z - w4 * y - w6 * x
    if coefficients >= 15:
        xx, yy, zz = x * x, y * y, z * z
        w8, w14 = 3.0 * SH_C3[0] * weights[8], 3.0 * SH_C3[0] * weights[14]
        w9, w13 = SH_C3[1] * weights[9], SH_C3[4] * weights[13]
        w10, w12 = SH_C3[2] * weights[10], SH_C3[2] * weights[12]
        w11 = 3.0 * SH_C3[3] * weights[11]
        by_x += w9 * y * z + 2.0 * (w10 * x * y - w8 * x * y - w11 * x * z + w13 * x * z)
        by_x -= w12 * (4.0 * zz - 3.0 * xx - yy) + w14 * (xx - yy)
        by_y += w9 * x * z + 2.0 * (w12 * x * y + w14 * x * y - w11 * y * z - w13 * y * z)
        by_y -= w10 * (4.0 * zz - xx - 3.0 * yy) + w8 * (xx - yy)
        by_z += w9 * x * y + w11 * (2.0 * zz - xx - yy) + w13 * (xx - yy)
        by_z -= 8.0 * z * (w10 * y + w12 * x)
    return by_x, by_y, by_z
