# SPDX-License-Identifier: Apache-2.0
"""What drives give for a control, an angle and a speed, as MuJoCo's actuators compute it."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.build import Plan
from labyrinth_sim.law import CACHED
from labyrinth_sim.live import Fields
from labyrinth_sim.servo import back_emf_actuator
from labyrinth_sim.trials import Array


class DriveTorques:
    """The torques of nsim simulations' drives, effects aside.

    Attributes:
        actuator, dof, qpos: (u,) numbers of each drive's actuator, degree of freedom and position.
        laws: (nsim, u, 9), what `torque` takes of each.
    """

    def __init__(self, plan: Plan, fields: Fields) -> None:
        def of(name: str, *place: int) -> Array:
            held = fields.used.get(name)
            every: Any = (slice(None), *place)
            return np.asarray(getattr(fields.model, name)[place]) if held is None else held[every]

        sites = [site for _, _, site in plan.drives]
        self.dof, self.qpos = (np.array([getattr(s, name) for s in sites]) for name in ("dof", "qpos"))
        self.actuator = np.array([s.actuator for s in sites])
        self.laws = np.empty((len(fields.torque), len(sites), 9))
        for number, site in enumerate(sites):
            servo, emf = site.actuator, back_emf_actuator(site)
            limited = bool(fields.model.jnt_actfrclimited[site.joint])
            columns = [
                of("actuator_gainprm", servo, 0),
                *(of("actuator_biasprm", servo, k) for k in range(3)),
                *(of("actuator_forcerange", servo, k) for k in range(2)),
                of("actuator_biasprm", emf, 2) if emf >= 0 else 0.0,
                *(of("jnt_actfrcrange", site.joint, k) if limited else end for k, end in ((0, -np.inf), (1, np.inf))),
            ]
            for column, values in enumerate(columns):
                self.laws[:, number, column] = values

    @property
    def most(self) -> Array:
        """(nsim, u) the control at which each drive gives its most at rest; infinite where nothing limits it."""
        gain, limit = np.abs(self.laws[..., 0]), np.minimum(self.laws[..., 5], self.laws[..., 8])
        return np.asarray(np.divide(limit, gain, out=np.full_like(limit, np.inf), where=gain > 0.0))

    def __call__(
        self, sims: NDArray[np.intp], drives: NDArray[np.intp], control: Array, angle: Array, speed: Array
    ) -> Array:
        """(s,) N m of drives (s,) of simulations (s,), for controls (s,), angles (s,) rad and speeds (s,) rad/s."""
        return np.asarray(_torques(self.laws, sims, drives, control, angle, speed))


@numba.njit(cache=CACHED, error_model="numpy")  # type: ignore[untyped-decorator]
def torque(law: Array, control: float, angle: float, speed: float) -> float:
    """N m of a drive whose servo and joint have these gains and ranges (9,)."""
    asked = law[0] * control + law[1] + law[2] * angle + law[3] * speed
    given = min(max(asked, law[4]), law[5]) + law[6] * speed
    return float(min(max(given, law[7]), law[8]))


@numba.njit(cache=CACHED, error_model="numpy")  # type: ignore[untyped-decorator]
def _torques(
    laws: Array, sims: NDArray[np.intp], drives: NDArray[np.intp], control: Array, angle: Array, speed: Array
) -> Array:
    out = np.empty(len(control))
    for row in range(len(out)):
        out[row] = torque(laws[sims[row], drives[row]], control[row], angle[row], speed[row])
    return out
