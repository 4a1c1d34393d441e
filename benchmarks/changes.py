# SPDX-License-Identifier: Apache-2.0
"""Whether wear is named: an emulated rig is recorded on two dates, and something has changed in between, or nothing.

    python benchmarks/changes.py --cases 20 --seed 200000 --json out.json

Each case draws one of five: slack that grows from 0.2 to 0.5 degrees, a belt that loosens, friction that doubles, a
potentiometer that slips, and nothing. The rig has slack and friction from the beginning, with different noise and
starts on each date. The whole library is considered, and every value of the drive. A case is right if the result names
what was done and nothing more; "undecided" is counted separately, and only if the truth is in the stated set.

    right, undecided, wrong     shares of the cases in which something changed, with Wilson's 95 % intervals
    false_alarm                 share of the unchanged rigs whose result is anything but "nothing"
    interval_held               share of the correctly named changes whose interval holds the truth

Seeds below 200000 are for tuning.
"""

import argparse
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import testbed_cases
from counting import Figure, Record, flat, rate

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Command, Hold, Ramp, Step, Triangle
from eps_tunnel_analysis.values.changes import changes
from labyrinth_hw.testbed.hidden import Hidden, hide
from labyrinth_sim.model import Model, load_model

SLACK, WORN_SLACK = np.radians(0.2), np.radians(0.5)  # rad
FRICTION, WORN_FRICTION = 0.05, 0.1  # N m
BELT, WORN_BELT = 100.0, 10.0  # N m/rad
SLIPPED = 0.008  # rad


@dataclass(frozen=True)
class Wear:
    """What may have changed.

    Attributes:
        name: of the kind.
        truth: what a verdict must name; "" if nothing changed.
        parameter: whose change is known, and
        change: by how much, in its unit; None if the model has another form of it.
        slack, friction: of the rig as it is now.
        more: what was added.
    """

    name: str
    truth: str
    parameter: str = ""
    change: float | None = None
    slack: float = float(SLACK)
    friction: float = FRICTION
    more: tuple[Hidden, ...] = ()


WEAR = (
    Wear("slack", "backlash.x", "backlash.x.width", float(WORN_SLACK - SLACK), slack=float(WORN_SLACK)),
    Wear("belt", "belt_compliance.x", more=(hide("belt_compliance", "x", values={"belt_stiffness": WORN_BELT}),)),
    Wear("friction", "coulomb_friction.x", "coulomb_friction.x.torque", WORN_FRICTION - FRICTION,
         friction=WORN_FRICTION),
    Wear("potentiometer", "sensor_bias.board_x", "sensor_bias.board_x.bias", SLIPPED,
         more=(hide("sensor_bias", "board_x", values={"pot_bias": SLIPPED}),)),
    Wear("nothing", ""),
)  # fmt: skip


def command() -> Command:
    """4 s of motion on one axis."""
    d = np.radians
    x = (Hold(0.3), Step(0.7, d(3.0)), Step(0.6, d(-2.0)), Ramp(0.8, d(2.0)), Triangle(1.2, d(1.5), 1.25), Step(0.4, 0))
    return Command("wear", ("motor_x", "motor_y"), (0.0, 0.0), (x, (Hold(4.0),)))


def played(seed: int, wear: Wear) -> Play:
    """The rig on one date."""
    first = (
        hide("backlash", "x", values={"play": wear.slack}),
        hide("coulomb_friction", "x", values={"coulomb": wear.friction}),
    )
    return testbed_cases.play(testbed_cases.rig((*first, *wear.more)), command(), seed)


def as_then() -> Model:
    """Near the rig as it was; its values are fitted to what was recorded then."""
    known = load_model("labyrinth_mx64").with_effect("backlash", "x", {"width": float(SLACK)})
    return known.with_effect("coulomb_friction", "x", {"torque": FRICTION})


def case(seed: int, threads: int = 1) -> Record:
    """One rig on two dates, and the result."""
    wear = WEAR[seed % len(WEAR)]
    then, now = (played(2 * seed + date, of) for date, of in ((0, WEAR[-1]), (1, wear)))
    started = time.monotonic()
    result = changes(as_then(), [then], [now], run=SearchOptions(None, threads))
    value = next((v for v in result.values if v.name == wear.parameter), None)
    return {
        "seed": seed, "wear": wear.name, "truth": wear.truth, "outcome": result.outcome, "named": list(result.named),
        "stated": list(result.stated), "set": dict(result.set), "sentence": result.sentence, "change": wear.change,
        "measured": None if value is None else [value.change, value.half_width],
        "seconds": time.monotonic() - started,
    }  # fmt: skip


def is_right(r: Record) -> bool:
    """Whether exactly what was done is named, or nothing if nothing was done."""
    if not r["truth"]:
        return bool(r["outcome"] == "nothing")
    return r["outcome"] == "changed" and r["named"] == [r["truth"]]


def is_undecided(r: Record) -> bool:
    """Whether it is left open, with the truth among what is stated."""
    return r["outcome"] == "undecided" and (r["truth"] or "none") in r["stated"]


def figures(records: list[Record]) -> dict[str, Figure]:
    """Every key of the study."""
    worn = [r for r in records if r["truth"]]
    measured = [r for r in worn if is_right(r) and r["change"] is not None and r["measured"]]
    each = {
        f"right_{kind.name}": rate([r for r in worn if r["wear"] == kind.name], is_right) for kind in WEAR if kind.truth
    }
    return {
        "right": rate(worn, is_right),
        "undecided": rate(worn, is_undecided),
        "wrong": rate(worn, lambda r: not is_right(r) and not is_undecided(r)),
        "false_alarm": rate([r for r in records if not r["truth"]], lambda r: not is_right(r)),
        "interval_held": rate(measured, lambda r: abs(r["measured"][0] - r["change"]) <= r["measured"][1]),
        **each,
    }


def shown(measured: Mapping[str, Figure]) -> str:
    """The figures as a table."""
    lines = []
    for key, figure in measured.items():
        low, high = figure.interval or (float("nan"), float("nan"))
        lines.append(f"{key:24s}{'-' if figure.value is None else f'{figure.value:.3f}':8s}{low:.3f} to {high:.3f}"
                     f"  ({figure.n})")  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    """Runs the cases, writes them as they come, and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=20, help="the kinds in turn, by seed (default: 20)")
    parser.add_argument("--seed", type=int, default=200_000, help="of the first case; the others follow")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    started, records = time.monotonic(), list[Record]()
    for seed in range(given.seed, given.seed + given.cases):
        records.append(case(seed, given.threads))
        r = records[-1]
        print(f"{seed} {r['wear']:14s}{r['sentence']} ({r['seconds']:.0f} s)", flush=True)
        if given.json:
            measured = flat(figures(records))
            content = {**measured, "seed": given.seed, "seconds": time.monotonic() - started, "cases": records}
            given.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(f"\n{len(records)} cases in {time.monotonic() - started:.0f} s\n\n{shown(figures(records))}")


if __name__ == "__main__":
    main()
