"""The hull and fins of a REMUS 100 by the coefficients that T. Prestero fitted to its manoeuvres at sea.

| symbol | meaning | unit |
|---|---|---|
| u, v, w; p, q, r | velocity through the water; rates of turn, in body axes | m/s; rad/s |
| delta_r, delta_s | rudder (positive: to starboard), stern plane (positive: nose down) | rad |
| Y_uv, N_rr ... | force or moment over the product of what the index names; Y_vv: over v abs(v) | kg/m, kg m^2 ... |

T. Prestero, *Verification of a six-degree of freedom simulation model for the REMUS autonomous underwater vehicle*, MIT
and WHOI 2001: the adjusted coefficients, as D. Sgarioto (DSTO, 2006) lists them in R. Hall and S. Anstee, *Trim
calculation methods for a dynamical model of the REMUS 100 autonomous underwater vehicle*. Adjusted are the quadratic
ones of cross-flow and turning: Y_vv and N_rr are ten times, M_qq twenty times what strip theory gives.

Some coefficients are sums over hull and fins. Y_uv = -28.6 is -19.0 of the hull and -9.64 of the fins. N_uv = -24.0 is
the Munk moment less the moments of both lifts. Together they are unstable in yaw and pitch: without control the hull
turns, until the quadratic terms limit its turning.

Three parts of his model are left out. The first is the added mass that couples sway with yaw (1.93 kg m: 0.7 % of the
determinant). The second is the 3.3 N of buoyancy that he trims with the stern plane. The third is his propeller and
drag, which hold for one speed: remus100.py has values for all speeds.
"""

from __future__ import annotations

from world.plants.rigid_body import RigidBody
from world.vectors import Vec6

M = 30.48  # mass [kg]
IX, IY, IZ = 0.177, 3.45, 3.45  # [kg m^2], about the centre of buoyancy
Z_G = 0.0196  # centre of gravity below that of buoyancy [m]
ADDED: Vec6 = (0.93, 35.5, 35.5, 0.0704, 4.88, 4.88)  # [kg, kg m^2]
BODY = RigidBody(M, IX, IY, IZ, Z_G, ADDED, M * 9.81, M * 9.81)

X_WQ, X_QQ, X_VR, X_RR = -35.5, -1.93, 35.5, -1.93
Y_VV, Y_RR, Y_UV, Y_UR, Y_WP, Y_PQ = -1310.0, 0.632, -28.6, 5.22, 35.5, 1.93
Z_WW, Z_QQ, Z_UW, Z_UQ, Z_VP, Z_RP = -1310.0, -0.632, -28.6, -5.22, -35.5, 1.93
K_PP = -0.130
M_WW, M_QQ, M_UW, M_UQ, M_VP, M_RP = 3.18, -188.0, 24.0, -2.0, -1.93, 4.86
N_VV, N_RR, N_UV, N_UR, N_WP, N_PQ = -3.18, -94.0, -24.0, -2.0, -1.93, -4.86
FIN_FORCE = 9.64  # over u^2 and angle, of rudder and stern plane alike [kg/m/rad]
FIN_MOMENT = 6.15  # moment over u^2 and angle, likewise [kg/rad]


def forces(nu_r: Vec6, rudder: float, stern: float) -> Vec6:
    """Forces and moments [N, N m] of hull, fins and inertia, without the drag along the axis.

    Args:
        nu_r: velocity through the water and rates of turn [m/s, rad/s].
        rudder: delta_r [rad].
        stern: delta_s [rad].
    """
    u, v, w, p, q, r = nu_r
    vv, ww, pp, qq, rr = v * abs(v), w * abs(w), p * abs(p), q * abs(q), r * abs(r)
    uu = u * abs(u)  # astern the water comes from behind the fins
    c1, c2, c3, c4, c5, c6 = BODY.coriolis(nu_r)
    return (
        X_WQ * w * q + X_QQ * q * q + X_VR * v * r + X_RR * r * r - c1,
        Y_VV * vv + Y_RR * rr + Y_UV * abs(u) * v + Y_UR * u * r + Y_WP * w * p + Y_PQ * p * q
        - FIN_FORCE * uu * rudder - c2,
        Z_WW * ww + Z_QQ * qq + Z_UW * abs(u) * w + Z_UQ * u * q + Z_VP * v * p + Z_RP * r * p
        - FIN_FORCE * uu * stern - c3,
        K_PP * pp - c4,
        M_WW * ww + M_QQ * qq + M_UW * u * w + M_UQ * abs(u) * q + M_VP * v * p + M_RP * r * p
        - FIN_MOMENT * uu * stern - c5,
        N_VV * vv + N_RR * rr + N_UV * u * v + N_UR * abs(u) * r + N_WP * w * p + N_PQ * p * q
        + FIN_MOMENT * uu * rudder - c6,
    )  # fmt: skip
