# SPDX-License-Identifier: Apache-2.0
"""Laws that act between MuJoCo's steps, compiled, and the loop that steps a simulation with them.

A law is a plain function of one simulation, `step` of an effect say:

    @law
    def step(raw):
        s = state(raw)
        s.frictionloss[s.dof] += s.values[0] * math.exp(-((s.qvel[s.dof] / s.values[1]) ** 2))

It is compiled when it is first used, and kept for the next time, so that a step with it costs little more than a bare
one. The same law serves the roll-outs here, which call `mj_step` themselves, and batches that are stepped from outside.
"""

import ctypes
import glob
import hashlib
import math
import os
import tempfile
from collections import namedtuple
from collections.abc import Callable, Iterable
from functools import cached_property, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numba
import numpy as np
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from labyrinth_sim.trials import Array

Addresses = NDArray[np.int64]

DATA = ("qpos", "qvel", "qfrc_applied", "qfrc_actuator", "qfrc_bias", "qfrc_passive", "ctrl", "ten_length",
        "ten_velocity")  # fmt: skip
MODEL = ("dof_damping", "dof_frictionloss", "tendon_damping", "actuator_gainprm", "actuator_biasprm",
         "actuator_forcerange", "dof_armature", "jnt_actfrcrange")  # fmt: skip
PLACE = ("channel", "actuator", "dof", "qpos", "load_dof", "tendon", "joint")
DRIVE = ("actuator", "dof", "qpos", "emf", "by_duty")
MEMORY = 16  # numbers that a law may keep from step to step
MOST_VALUES = 32
TABLES = MOST_VALUES - 1  # the value that is the address of an effect's tables; a number holds one exactly, to 2^53
MOST_SUM = (
    1e4  # of a control by an integral; far beyond the torque is saturated, and MuJoCo takes huge controls for errors
)

State = namedtuple(
    "State",
    "qpos qvel applied actuator bias passive ctrl length rate "
    "damping frictionloss belt_damping gain act_bias limits armature joint_limits base_gain base_bias base_limits "
    "error channel drive dof angle load_dof tendon joint drives values memory step",
)
"""One simulation before a step, as a law sees it; arrays that it may write are set back before the next one.

Attributes:
    qpos (nq,), qvel (nv,): now.
    applied (nv,): N m, add to it.
    actuator, bias, passive (nv,): N m on each degree of freedom as of the last step: of the drives; of inertia and
        gravity, on the other side of the equation; of springs and dampers.
    ctrl (nu,): of the actuators, for this step.
    length, rate (ntendon,): of the belts, rad, rad/s, as of the last step.
    damping, frictionloss, armature (nv,), belt_damping (ntendon,), gain, act_bias (nu, 10), limits (nu, 2),
        joint_limits (njnt, 2): of the model, the limits being those of each actuator, and of all of a joint together;
        those of the actuators before any law are base_gain, base_bias, base_limits.
    error (u,): rad, of each drive, as it sees it.
    channel, drive, dof, angle, load_dof, tendon, joint: where the effect acts: its axis, and the actuator, degree of
        freedom and coordinate of its joint; -1 where there is no such thing.
    drives (u, 5): actuator, degree of freedom, coordinate, back-EMF actuator (or -1) of each axis, and whether it
        sets a duty.
    values: of the effect's parameters, in their order.
    memory (16,): kept from step to step, zero at first.
    step: s.
"""


def _kept() -> str:
    """A folder for compiled laws that belongs to this layout of `State` alone, and to these functions that laws call.

    A law is compiled again if its own file changes, but numba does not see what it calls.
    """
    called = b"".join(
        text for file in sorted(Path(__file__).parent.glob("*.py")) if b"njit" in (text := file.read_bytes())
    )
    marks = called + f"{numba.__version__} {mujoco.__version__}".encode()
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = os.path.join("labyrinth_sim", hashlib.sha256(marks).hexdigest()[:16])
    for parent in (home, os.path.join(tempfile.gettempdir(), f"cache-{os.getuid() if hasattr(os, 'getuid') else 0}")):
        path = os.path.join(parent, folder)
        try:
            os.makedirs(path, mode=0o700, exist_ok=True)
        except OSError:
            continue
        # What lies there is executed, so it must belong to this user.
        if os.access(path, os.W_OK) and (not hasattr(os, "getuid") or os.stat(path).st_uid == os.getuid()):
            return path
    return ""


numba.config.CACHE_DIR = _kept()  # type: ignore[attr-defined]
CACHED = bool(numba.config.CACHE_DIR)  # type: ignore[attr-defined]


def _pointer(kind: Any) -> Any:
    """Makes an address a pointer to numbers of a kind."""

    def typed(_typing: Any, address: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            return builder.inttoptr(given[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.int64), code

    return intrinsic(typed)


def _caller(count: int) -> Any:
    """Calls a C function at an address with `count` addresses."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        word = cgutils.intp_t
        kind = cgutils.ir.FunctionType(cgutils.ir.VoidType(), [word] * count)
        builder.call(builder.inttoptr(given[0], kind.as_pointer()), list(given[1:]))
        return context.get_dummy_value()

    return types.void(*[types.int64] * (count + 1)), code


def _to_call(_typing: Any, function: Any, raw: Any) -> Any:
    return _caller(1)


def _to_step(_typing: Any, function: Any, model: Any, data: Any) -> Any:
    return _caller(2)


# Intrinsics take the typing context themselves, which their stubs do not say.
_doubles: Any = _pointer(types.float64)
_integers: Any = _pointer(types.int64)
_call: Any = intrinsic(_to_call)
_call_step: Any = intrinsic(_to_step)


# Not inlined by numba, which would compile all of it again for every law; a step costs the same.
@numba.njit(cache=CACHED)  # type: ignore[untyped-decorator]
def state(raw: int) -> State:
    """What a law sees: `raw` is the one argument that it gets."""
    head = numba.carray(_integers(raw), (7,))
    at = numba.carray(_integers(head[0]), (21,))
    n = numba.carray(_integers(head[1]), (6,))  # nq, nv, nu, ntendon, drives, njnt
    place = numba.carray(_integers(head[2]), (7,))
    rest = numba.carray(_doubles(head[5]), (1,))
    nq, nv, nu, nt, u = n[0], n[1], n[2], n[3], n[4]
    return State(
        numba.carray(_doubles(at[0]), (nq,)), numba.carray(_doubles(at[1]), (nv,)),
        numba.carray(_doubles(at[2]), (nv,)), numba.carray(_doubles(at[3]), (nv,)),
        numba.carray(_doubles(at[4]), (nv,)), numba.carray(_doubles(at[5]), (nv,)),
        numba.carray(_doubles(at[6]), (nu,)), numba.carray(_doubles(at[7]), (nt,)),
        numba.carray(_doubles(at[8]), (nt,)),
        numba.carray(_doubles(at[9]), (nv,)), numba.carray(_doubles(at[10]), (nv,)),
        numba.carray(_doubles(at[11]), (nt,)), numba.carray(_doubles(at[12]), (nu, 10)),
        numba.carray(_doubles(at[13]), (nu, 10)), numba.carray(_doubles(at[14]), (nu, 2)),
        numba.carray(_doubles(at[15]), (nv,)),
        numba.carray(_doubles(at[16]), (n[5], 2)),
        numba.carray(_doubles(at[17]), (nu, 10)), numba.carray(_doubles(at[18]), (nu, 10)),
        numba.carray(_doubles(at[19]), (nu, 2)), numba.carray(_doubles(at[20]), (u,)),
        place[0], place[1], place[2], place[3], place[4], place[5], place[6],
        numba.carray(_integers(head[6]), (u, 5)),
        numba.carray(_doubles(head[3]), (MOST_VALUES,)), numba.carray(_doubles(head[4]), (MEMORY,)), rest[0],
    )  # fmt: skip


class Tables:
    """Rows of numbers, each (K,) of its own length, that a law of an effect reads beside its values.

    Args:
        rows: may be replaced from one batch to the next, but not while one is stepped.
    """

    def __init__(self, rows: Iterable[Array] = ()) -> None:
        self.rows = [np.ascontiguousarray(row, dtype=np.float64) for row in rows]

    def addresses(self) -> Addresses:
        """(n, 2) of each row, and how many numbers it has."""
        return np.array([(row.ctypes.data, row.size) for row in self.rows], dtype=np.int64).reshape(-1, 2)


@numba.njit(cache=CACHED)  # type: ignore[untyped-decorator]
def row_of(s: State, number: int) -> Any:
    """(K,) a row of the `tables` of a law's effect, from 1."""
    addresses = numba.carray(_integers(int(s.values[TABLES])), (number, 2))
    return numba.carray(_doubles(addresses[number - 1, 0]), (addresses[number - 1, 1],))


class Law:
    """A compiled function of one simulation; `address` compiles it the first time."""

    def __init__(self, function: Callable[[int], None]) -> None:
        self.function = function
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__

    @cached_property
    def _compiled(self) -> Any:
        return numba.cfunc(types.void(types.int64), cache=CACHED)(self.function)

    @property
    def address(self) -> int:
        """Of the machine code: `void law(int64_t raw)`."""
        return int(self._compiled.address)

    def __reduce__(self) -> tuple[Any, ...]:
        return _named, (self.__module__, self.__name__)


def _named(module: str, name: str) -> Law:
    found: Law = getattr(import_module(module), name)
    return found


def law(function: Callable[[int], None]) -> Law:
    """Declares a function of one simulation a law."""
    return Law(function)


@lru_cache(maxsize=1)
def step_address() -> int:
    """Of `mj_step` in the library that the bindings loaded."""
    folder = Path(mujoco.__file__).parent
    names = [
        n for pattern in ("libmujoco*.so*", "libmujoco*.dylib", "mujoco*.dll") for n in glob.glob(str(folder / pattern))
    ]
    library = ctypes.CDLL(names[0])
    return int(ctypes.cast(library.mj_step, ctypes.c_void_p).value or 0)


@numba.njit(nogil=True, cache=CACHED)  # type: ignore[untyped-decorator]
def apply(laws: Addresses, raws: Addresses) -> None:
    """Calls laws (l,) for simulations, raws (n, l, 7), each in turn."""
    for i in range(raws.shape[0]):
        for k in range(laws.shape[0]):
            _call(laws[k], raws[i, k, 0:7].ctypes.data)


@numba.njit(nogil=True, cache=CACHED)  # type: ignore[untyped-decorator]
def roll(
    step: int,
    model: int,
    data: int,
    laws: Addresses,
    first_force: int,
    raws: Addresses,
    restore: Addresses,
    at: Addresses,
    drives: Addresses,
    control: Any,
    targets: Any,
    gain: Any,
    ticks: Any,
    integral: Any,
    sums: Any,
    substeps: int,
    every: float,
    measured: Addresses,
    limit: float,
    jumps: Any,
    limited: Any,
    out: Any,
) -> int:
    """Steps one simulation through all samples.

    Args:
        step, model, data: addresses of `mj_step` and of what it is called with.
        laws: (l,) addresses, those that change a drive's error first.
        first_force: the number of those.
        raws: (l, 7), each one's argument.
        restore: (r, 3) addresses from and to which so many numbers are copied before every step.
        at: (7,) addresses of positions, speeds, actuators' torques, controls and errors; nq, nv.
        drives: (u, 5), see `State`.
        control: (T, nu) controls that the target alone asks for.
        targets: (T, u) rad; NaN where the drive is off.
        gain: (u,) control per radian of error.
        ticks: (u,) rad in which each drive sees its angle, 0 for none.
        integral: (u,) control for each rad s of the error's sum.
        sums: (u,) rad s, the errors' sums so far, written.
        every: s of a sample.
        measured: (m, 2) which of positions, speeds, torques (0, 1, 2), and its index.
        limit: rad/s; beyond, it has diverged.
        jumps: (s, 2 + c) samples in which a control steps, in order, its axis, and what its drive's law is told then.
        limited: (u, MOST_VALUES) values of the drives' laws, of which those are from 1 on; as many as there are.
        out: (T, m), written.

    Returns:
        The sample at which it diverged, or -1.
    """
    nv, samples, count = at[6], control.shape[0], laws.shape[0]
    qpos, qvel = numba.carray(_doubles(at[0]), (at[5],)), numba.carray(_doubles(at[1]), (nv,))
    torque, ctrl = numba.carray(_doubles(at[2]), (nv,)), numba.carray(_doubles(at[3]), (control.shape[1],))
    error = numba.carray(_doubles(at[4]), (drives.shape[0],))
    added, kept, jump, told = np.zeros(drives.shape[0]), integral.any(), 0, True
    end = jumps.shape[1] - 1  # of what a law is told
    bent = first_force > 0 or ticks.any() or kept
    for k in range(samples):
        for c in range(measured.shape[0]):
            if measured[c, 0] == 0:
                out[k, c] = qpos[measured[c, 1]]
            elif measured[c, 0] == 1:
                out[k, c] = qvel[measured[c, 1]]
        added[:] = 0.0
        if told:
            limited[:, 1:end], told = 0.0, False
        while jump < jumps.shape[0] and jumps[jump, 0] == k:
            limited[int(jumps[jump, 1]), 1:end] = jumps[jump, 2:]
            jump, told = jump + 1, True
        for sub in range(substeps):
            for r in range(restore.shape[0]):
                source, into = _doubles(restore[r, 0]), _doubles(restore[r, 1])
                for i in range(restore[r, 2]):
                    into[i] = source[i]
            for i in range(control.shape[1]):
                ctrl[i] = control[k, i]
            for i in range(drives.shape[0]):
                seen = qpos[drives[i, 2]]
                if ticks[i] > 0.0:
                    seen = ticks[i] * math.floor(seen / ticks[i] + 0.5)
                error[i] = targets[k, i] - seen
            if bent:
                for j in range(first_force):
                    _call(laws[j], raws[j, 0:7].ctypes.data)
                if kept and sub == 0:
                    for i in range(drives.shape[0]):
                        on = targets[k, i] == targets[k, i]
                        sums[i] = sums[i] + error[i] * every if on else 0.0
                        added[i] = min(max(integral[i] * sums[i], -MOST_SUM), MOST_SUM)
                for i in range(drives.shape[0]):
                    if targets[k, i] == targets[k, i]:
                        shift = error[i] - (targets[k, i] - qpos[drives[i, 2]])
                        ctrl[drives[i, 0]] = control[k, drives[i, 0]] + added[i] + gain[i] * shift
            for j in range(first_force, count):
                _call(laws[j], raws[j, 0:7].ctypes.data)
            _call_step(step, model, data)
            if sub == 0:
                for c in range(measured.shape[0]):
                    if measured[c, 0] == 2:
                        out[k, c] = torque[measured[c, 1]]
        for i in range(nv):
            if not abs(qvel[i]) < limit:
                return k
    return -1
