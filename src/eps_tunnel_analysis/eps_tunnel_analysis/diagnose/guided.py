# SPDX-License-Identifier: Apache-2.0
"""Effects that act by events, searched for in roll-outs that are held near the measured motion.

Whether and when a duty is cut depends on the whole motion before, so that a free roll-out at values near the true ones
may lack the event, or have another one, and no slope leads to them. A spring and a damper between the joint and its
measured motion let every event happen where it happened on the rig: what remains is only what each value itself gets
wrong. So the search begins with a firm hold, which is loosened step by step, as in the synchronization of a model with
its data (Abarbanel, Creveling, Farsian, Kostuk: Dynamical state and parameter estimation, SIAM Journal on Applied
Dynamical Systems 8, 2009).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import mujoco
import numpy as np

from eps_tunnel_analysis.diagnose.candidates import Candidate, starts
from eps_tunnel_analysis.diagnose.contained import ROUNDS
from eps_tunnel_analysis.diagnose.evidence import Evidence
from eps_tunnel_analysis.diagnose.prescribed import GRID, course
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Job, Refit
from eps_tunnel_analysis.diagnose.search import Level, Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from labyrinth_sim.build import compiled
from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.model import Model
from labyrinth_sim.rig import Measured
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

HOLDS = (
    60.0,
    60.0,
    40.0,
    25.0,
    15.0,
    9.0,
    5.0,
)  # rad/s, at which a joint that moves by itself would close in on the measured motion
CARRIED_ON = 4  # points that go on from one hold to the next
AROUND = 16  # points tried around each of them
WIDTHS = (0.5, 0.4, 0.3, 0.2, 0.2, 0.2, 0.2)  # how far around, in logarithms
FREE_ROUNDS = 12  # in free roll-outs, in the end
SEED = 0


class Guide:
    """Holds one joint near motions, one for each play, by a torque `I (r^2 e + 2 r e')`.

    Args:
        name: of the effect.
        joint: of the MJCF.
        inertia: kg m^2, of the joint.
        motions: for each play (2, K) its angle and speed on a grid of GRID.
    """

    def __init__(self, name: str, joint: str, inertia: float, motions: Sequence[Array]) -> None:
        self.joint, self.inertia, self.motions = joint, inertia, tuple(motions)
        self.effect = Effect(
            name=name,
            title="Guide",
            physics="A spring and a damper to a measured motion.",
            equation="torque = I (r^2 (q_m - q) + 2 r (q_m' - q'))",
            parameters=(
                Parameter("play", "1", 0.0, 1e6, 0.0, 1.0, "number of the play, from 1; 0 holds nothing"),
                Parameter("rate", "rad/s", 0.0, 1e3, None, HOLDS[0], "how firmly"),
            ),
            stage="force",
            mark="",
            shows="offset",
            confused_with=(),
            separated_by="",
            order=1000,
            step=self._step,
        )

    def _step(self, live: Live, _site: Site, values: Values) -> None:
        if self.effect.name not in live.memory:
            joint = live.model.joint(self.joint)
            live.memory[self.effect.name] = np.array([joint.qposadr[0], joint.dofadr[0], 0])
        kept = live.memory[self.effect.name]
        place, dof, count = (int(number) for number in kept)
        kept[2] += 1
        play, rate = int(values["play"][0]), values["rate"]
        if play:
            motion = self.motions[play - 1]
            k = min(round(count * live.step / GRID), motion.shape[1] - 1)
            off, slip = motion[0, k] - live.qpos[:, place], motion[1, k] - live.qvel[:, dof]
            live.applied[:, dof] += self.inertia * rate * (rate * off + 2.0 * slip)


def event_refits(search: Search, on: Sequence[Refit], allowed: float) -> list[Refit]:
    """Refits of each candidate that acts by events, on top of refits that leave more than `allowed` floors."""
    abrupt = [c for c in search.library.candidates if any(p.abrupt for p in c.declared)]
    jobs: list[Job] = []
    for refit in on:
        new = [c for c in abrupt if c.name not in refit.effects]
        if new and worst_floors(refit.residuals, search.signal) > allowed:
            held = held_near(search, refit)
            for candidate in new:
                jobs += _loosened(search, held, refit, candidate)
    return search.refit(jobs, FREE_ROUNDS, "exact")


def held_near(search: Search, refit: Refit) -> Evidence:
    """Coarse evidence of the library's model with a guide at the finest sensor of each axis, as firm as the first hold.

    A measured motion is what a refit says of it, and a smooth curve through what it misses.
    """
    evidence = search.levels["coarse"]
    model = evidence.model
    finest = {}
    for axis in model.rig.axes:
        own = [m for m in axis.finest_first if m.quantity == "position" and m.signal in evidence.signals]
        finest.update({axis.name: own[0]} if own else {})
    motions = _motions(evidence, refit, list(finest.values()))
    guides = [
        Guide(f"guide_{place}", measured.joint, _inertia(model, measured.joint), motion)
        for (place, measured), motion in zip(finest.items(), motions, strict=True)
    ]
    for guide, place in zip(guides, finest, strict=True):
        model = model.with_effect(guide.effect, place, {"play": 0.0, "rate": HOLDS[0]})
    names = [f"{guide.effect.name}.{place}.play" for guide, place in zip(guides, finest, strict=True)]
    plays = [
        replace(p, play=replace(p.play, known={**p.play.known, **dict.fromkeys(names, number + 1.0)}))
        for number, p in enumerate(evidence.plays)
    ]
    return evidence.with_plays(model, plays)


def _loosened(search: Search, held: Evidence, refit: Refit, candidate: Candidate) -> list[Job]:
    """Where a candidate's best values end up as the hold is loosened, in free roll-outs; none if it explains little of
    what the firmest hold leaves.
    """
    rng, columns = np.random.default_rng(SEED), search.columns(candidate)
    fitted = (*search.library.of(refit.effects), candidate)
    points = np.tile(refit.values, (len(starts(candidate)), 1))
    points[:, columns] = starts(candidate)
    bare = np.inf
    for rate, width in zip(HOLDS, WIDTHS, strict=True):
        rates = {name: rate for name in held.model.values() if name.startswith("guide_") and name.endswith(".rate")}
        guided = copy(search)
        guided.levels = {"coarse": held.of(held.model.with_values(rates, "held"))}
        guided.shift = np.zeros(len(search.used))
        without = [] if np.isfinite(bare) else [(fitted[:-1], refit.values)]
        refits = guided.refit([*without, *((fitted, point) for point in _best(guided, points))], ROUNDS)
        search.evaluations = guided.evaluations
        if without:
            bare, refits = refits[0].cost, refits[1:]
            if min(r.cost for r in refits) > (1.0 - SETTINGS.worthwhile) * bare:
                return []
        points = np.repeat([r.values for r in refits], 1 + AROUND, axis=0)
        away = np.where(np.arange(len(points)) % (1 + AROUND), width, 0.0)[:, None]
        points[:, columns] *= np.exp(away * rng.normal(size=(len(points), len(columns))))
        points = np.clip(points, search.low, search.high)
    return [(fitted, point) for point in _best(search, points, "exact")]


def _best(search: Search, points: Array, level: Level = "coarse") -> Array:
    """The best CARRIED_ON of points (n, K)."""
    cost = np.nan_to_num(np.mean(search.residuals(points, level) ** 2, axis=1), nan=np.inf)
    return np.asarray(points[np.argsort(cost, kind="stable")[:CARRIED_ON]])


def _motions(evidence: Evidence, refit: Refit, finest: Sequence[Measured]) -> list[list[Array]]:
    """For each of these signals and each play (2, K) angle and speed on a grid of GRID."""
    model = evidence.model
    for use in model.effects:
        model = model.without_effect(use.effect.name, use.place) if use.effect.only_measures else model
    kept = [i for i, name in enumerate(evidence.free) if name in model.values()]
    missed = evidence(refit.values[None])[0]
    found: list[list[Array]] = [[] for _ in finest]
    for number in range(len(evidence.plays)):
        time = evidence.times(number)
        simulated = simulate_batch(
            model, [evidence.free[i] for i in kept], refit.values[None, kept], time, evidence.commands[number][None],
            evidence.initial[number],
            per_command={name: given[[number]] for name, given in evidence.known.items() if name in model.values()},
            resting=evidence.resting[number], signals=evidence.signals, timestep=evidence.step(number), means=True,
        ).values[0, 0]  # fmt: skip
        at = np.arange(0.0, time[-1] + GRID, GRID)
        for motions, measured in zip(found, finest, strict=True):
            column = evidence.signals.index(measured.signal)
            here = evidence.blocks == number * len(evidence.signals) + column
            motions.append(course(time, simulated[:, column], evidence.time[here], -missed[here], at)[:2])
    return found


def _inertia(model: Model, joint: str) -> float:
    """kg m^2 of a joint in the model's first pose, with what it carries."""
    mj = compiled(model, with_ball=False).mj
    data, mass = mujoco.MjData(mj), np.zeros((mj.nv, mj.nv))
    mujoco.mj_forward(mj, data)
    mujoco.mj_fullM(mj, data, mass)
    dof = int(mj.joint(joint).dofadr[0])
    return float(mass[dof, dof])
