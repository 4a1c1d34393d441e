# SPDX-License-Identifier: Apache-2.0
"""What each entry of the emulated testbed shows against the noise: what the drive's values alone, refitted, leave.

Root mean square over the noise floor, for the weak, the medium and the strong case; a complete model leaves about 1.
A "!" marks cases whose trials differ in a way that no effect of the library explains, which widens the floor.

    python benchmarks/strengths.py [--only NAME ...] [--seed S]
"""

import argparse

import numpy as np
from testbed_cases import draw, play, rig

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.base_values import base_refit
from eps_tunnel_analysis.diagnose.repeats import repeats
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_hw.testbed.hidden import EFFECTS, STRENGTHS, hide


def shown(name: str, axis: str, strength: str, seed: int) -> str:
    """One cell of the table."""
    model = draw(seed)[2]
    plays = [play(rig((hide(name, axis, strength),)), find_sequence("excite_12s").commands[0], seed)]
    part = next(p for p in axis_parts(model, plays) if p.name == axis[-1])
    base = base_refit(axis_search(model, plays, part, SearchOptions(only=(), nthread=1)))
    positions = [s for s in part.signals if not s.endswith("effort")]
    odd = any(r.sentence for r in repeats(plays[0].trials, positions))
    return f"{np.sqrt(base.cost):.1f}{'!' if odd else ''}"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[n for n, e in EFFECTS.items() if not e.ball], metavar="NAME")
    parser.add_argument("--seed", type=int, default=9700)
    arguments = parser.parse_args()
    print("| hidden | " + " | ".join(STRENGTHS) + " |\n|---|---|---|---|")
    for name in arguments.only:
        for axis in ("motor_x", "board_y") if EFFECTS[name].sensor else ("x",):
            cells = [shown(name, axis, strength, arguments.seed) for strength in STRENGTHS]
            print(f"| {name}.{axis} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
