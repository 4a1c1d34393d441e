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

import numpy as np

from eps_tunnel_analysis.diagnose.added_force import unlisted
from eps_tunnel_analysis.diagnose.candidates import Candidate, starts
from eps_tunnel_analysis.diagnose.contained import ROUNDS, best_points
from eps_tunnel_analysis.diagnose.evidence import Evidence
from eps_tunnel_analysis.diagnose.prescribed import GRID, measured_courses
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Job, Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from labyrinth_sim.build import compiled, inertia_at_rest
from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import Tables, law, row_of, state
from labyrinth_sim.trials import Array

#: rad/s, at which a joint that moves by itself would close in on the measured motion
HOLDS = (60.0, 60.0, 40.0, 25.0, 15.0, 9.0, 5.0)
CARRIED_ON = 4  # points that go on from one hold to the next
AROUND = 16  # points tried around each of them
WIDTHS = (0.5, 0.4, 0.3, 0.2, 0.2, 0.2, 0.2)  # how far around, in logarithms
FREE_ROUNDS = 12  # in free roll-outs, in the end
SEED = 0


def guide(name: str, motions: Sequence[Array]) -> Effect:
    """Holds one joint near motions, one for each play, each (2, K) its angle and speed on a grid of GRID."""
    made = unlisted(
        name,
        "Guide",
        "A spring and a damper to a measured motion.",
        "torque = I (r^2 (q_m - q) + 2 r (q_m' - q'))",
        Parameter("play", "1", 0.0, 1e6, 0.0, 1.0, "number of the play, from 1; 0 holds nothing"),
        Parameter("rate", "rad/s", 0.0, 1e3, None, HOLDS[0], "how firmly"),
        Parameter("inertia", "kg m^2", 0.0, 1e6, None, 0.0, "of the joint"),
        Parameter("coordinate", "1", 0.0, 1e6, None, 0.0, "number of the joint's"),
        Parameter("freedom", "1", 0.0, 1e6, None, 0.0, "number of the joint's degree of freedom"),
    )
    return replace(made, step=_hold, tables=Tables(motion.ravel() for motion in motions), steps_with="play")


@law
def _hold(raw):  # type: ignore[no-untyped-def]
    s = state(raw)
    motion = row_of(s, int(s.values[0]))
    rate, inertia, place, dof = s.values[1], s.values[2], int(s.values[3]), int(s.values[4])
    half = motion.size // 2
    k = min(round(s.memory[0] * s.step / GRID), half - 1)
    s.memory[0] += 1.0
    off, slip = motion[k] - s.qpos[place], motion[half + k] - s.qvel[dof]
    s.applied[dof] += inertia * rate * (rate * off + 2.0 * slip)


def event_refits(search: Search, on: Sequence[Refit], allowed: float) -> list[Refit]:
    """Refits of each candidate that acts by events, on top of refits that leave more than `allowed` floors."""
    abrupt = [c for c in search.library.candidates if any(p.abrupt for p in c.declared)]
    jobs: list[Job] = []
    for refit in on:
        new = [c for c in abrupt if c.name not in refit.effects]
        if new and worst_floors(refit.residuals, search.signal) > allowed:
            held = held_near(search, refit)
            firm = _under(search, held, HOLDS[0])
            (without,) = firm.refit([(search.library.of(refit.effects), refit.values)], ROUNDS)
            search.evaluations = firm.evaluations
            for candidate in new:
                jobs += _loosened(search, held, refit, candidate, without.cost)
    return search.refit(jobs, FREE_ROUNDS, "exact")


def held_near(search: Search, refit: Refit) -> Evidence:
    """Coarse evidence of the library's model with a guide at the finest sensor of each axis, as firm as the first hold,
    that holds it near its `Course`.
    """
    evidence = search.levels["coarse"]
    model = evidence.model
    finest = {}
    for axis in model.rig.axes:
        own = [m for m in axis.finest_first if m.quantity == "position" and m.signal in evidence.signals]
        finest.update({axis.name: own[0]} if own else {})
    courses = measured_courses(evidence, refit.values, [measured.signal for measured in finest.values()])
    at_rest, names = compiled(model, with_ball=False).mj, []
    for place, measured in finest.items():
        motions = [course.at(course.grid)[:2] for course in courses[measured.signal]]
        joint = at_rest.joint(measured.joint)
        model = model.with_effect(guide(f"guide_{place}", motions), place, {
            "play": 0.0, "rate": HOLDS[0], "inertia": inertia_at_rest(at_rest, measured.joint),
            "coordinate": float(joint.qposadr[0]), "freedom": float(joint.dofadr[0]),
        })  # fmt: skip
        names.append(f"guide_{place}.{place}.play")
    plays = [
        replace(p, play=replace(p.play, known={**p.play.known, **dict.fromkeys(names, number + 1.0)}))
        for number, p in enumerate(evidence.plays)
    ]
    return evidence.of(model, plays=plays)


def firmly(held: Evidence, rate: float) -> Evidence:
    """Evidence of `held_near` with a hold of another rate, rad/s."""
    rates = {name: rate for name in held.model.values() if name.startswith("guide_") and name.endswith(".rate")}
    return held.of(held.model.with_values(rates, "held"))


def _under(search: Search, held: Evidence, rate: float) -> Search:
    """The same search in roll-outs that are held at a rate, rad/s."""
    guided = copy(search)
    guided.levels, guided.shift = {"coarse": firmly(held, rate)}, np.zeros(len(search.used))
    return guided


def _loosened(search: Search, held: Evidence, refit: Refit, candidate: Candidate, without: float) -> list[Job]:
    """Where a candidate's best values end up as the hold is loosened, in free roll-outs; none if it explains little of
    what the firmest hold leaves `without` it, in floors.
    """
    rng, columns = np.random.default_rng(SEED), search.columns(candidate)
    fitted, begun = (*search.library.of(refit.effects), candidate), starts(candidate)
    points = np.tile(refit.values, (len(begun), 1))
    points[:, columns] = begun
    for number, (rate, width) in enumerate(zip(HOLDS, WIDTHS, strict=True)):
        guided = _under(search, held, rate)
        best = best_points(guided, points, CARRIED_ON)
        refits = guided.refit([(fitted, point) for point in best], ROUNDS)
        search.evaluations = guided.evaluations
        if number == 0 and min(r.cost for r in refits) > (1.0 - SETTINGS.worthwhile) * without:
            return []
        points = np.repeat([r.values for r in refits], 1 + AROUND, axis=0)
        away = np.where(np.arange(len(points)) % (1 + AROUND), width, 0.0)[:, None]
        free = search.free_columns(candidate)
        points[:, free] *= np.exp(away * rng.normal(size=(len(points), len(free))))
        points = search.within(points)
    return [(fitted, point) for point in best_points(search, points, CARRIED_ON, "exact")]
