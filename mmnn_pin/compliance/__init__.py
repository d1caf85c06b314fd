"""A compliant hand: springs and dampers at a frame of the robot, carried by base and arm together, and forces.

    impedance (torques)      tau = Psi_hat + J' (K x~ + D x~') + N' (posture)         s = nu_ref - nu,  J nu_ref = x_d'
    admittance (velocities)  m nu_c' = the same torque + what is felt,  nu_ref = nu_d + nu_c

`settings` has what is asked for, `law` the compiled arithmetic, `bound` what delay and period bear.
"""

from .bound import Bound, Held, bound_of
from .law import Compliance, give, wish
from .settings import Force, Impedance, require_impedance
from .wiring import compliance_of, compliance_size, set_force, soften
