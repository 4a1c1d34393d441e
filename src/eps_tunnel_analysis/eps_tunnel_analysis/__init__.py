# SPDX-License-Identifier: Apache-2.0
"""How far a simulation is from a real rig, where, and which physical effect the model lacks.

    import eps_tunnel_analysis as eps
    study = eps.load("study/real", model="labyrinth")
    gap = study.compare()
    why = study.diagnose()

The names in `__all__` are imported on first use. See docs/python.md.
"""

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eps_tunnel_analysis.recording import Recording, read
    from eps_tunnel_analysis.study import Study, load
    from eps_tunnel_analysis.tunnel import Tunnel, build_tunnel, smooth
    from labyrinth_sim.errors import InputError
    from labyrinth_sim.model import Model, load_model, save_model
    from labyrinth_sim.rig import Rig, load_rig
    from labyrinth_sim.trials import Trials

__all__ = [
    "InputError",
    "Model",
    "Recording",
    "Rig",
    "Study",
    "Trials",
    "Tunnel",
    "build_tunnel",
    "load",
    "load_model",
    "load_rig",
    "read",
    "save_model",
    "smooth",
]
_MODULES = {
    "eps_tunnel_analysis.recording": ("Recording", "read"),
    "eps_tunnel_analysis.study": ("Study", "load"),
    "eps_tunnel_analysis.tunnel": ("Tunnel", "build_tunnel", "smooth"),
    "labyrinth_sim.errors": ("InputError",),
    "labyrinth_sim.model": ("Model", "load_model", "save_model"),
    "labyrinth_sim.rig": ("Rig", "load_rig"),
    "labyrinth_sim.trials": ("Trials",),
}

# Roll-outs take the processors; on matrices as small as ours more threads of BLAS only get in their way. Read when
# numpy is first imported.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(module), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
