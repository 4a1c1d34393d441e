# SPDX-License-Identifier: Apache-2.0
"""Why the evolution strategy takes another integral part on axis x than the paper's: one thing changed at a time.

python benchmarks/paper_axis_x.py [--quick] --json OUT

The rig of config/testbed/paper.yaml plays five of the rotations, held for eight seconds, and the eight-second sequence.
The four values are fitted to what a recording of another length, another rig or other bounds would have shown; every
set of values is judged on the sequence of the paper's rig, as in the paper's Table 2. Five minutes of one core.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from paper import PAPER_1, PAPER_SHARES, POSITIONS, RATE, play_all, share

from eps_tunnel_analysis.alikeness import KS
from eps_tunnel_analysis.calibration.calibrate import Settings, calibrate
from eps_tunnel_analysis.fit.methods import EvolutionStrategy
from eps_tunnel_analysis.outputs import versions
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.recording import read, to_plays
from eps_tunnel_analysis.sequence import Command
from eps_tunnel_analysis.sequence_file import find_sequence
from eps_tunnel_analysis.simulated import roll_out
from eps_tunnel_analysis.terminal import console, table
from eps_tunnel_analysis.tunnel import build_tunnel, smooth
from labyrinth_hw.testbed.hidden import TestbedConfig, load_testbed
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.rig import load_rig

EVERY = 4  # of the twenty rotations
TRIALS = 10
LONGEST = 8.0  # s for which a rotation is held
USUAL = 2.0  # s, as in config/sequences/rotations_x.yaml
CUTS = (0.3, 0.5, 1.0, 4.0, 8.0)  # s
GENERATIONS = 12  # of 150; the search stands still by then
NAMES = ("p", "i", "d", "delay")
SIGNAL = "board_x"
AT_REST = 20  # samples
PRECISE = {"margin": {"x": 0.0020}, "coulomb": {"x": 0.05}, "error_amplitude": {"x": 0.0010}}  # as axis y
FREE = ("margin", "coulomb", "error_amplitude", "play", "belt_hysteresis")  # of what makes it stop short
NO_ERROR = {name: {"x": 0.0} for name in FREE}
NO_TICKS = {name: {"x": 0.0} for name in (*FREE, "control_tick", "command_tick")}
OTHER_RIGS = (
    ("rotations as precise as those of axis y", PRECISE),
    ("off by the angle and not by the way", {**PRECISE, "error_amplitude": {"x": 0.0082}}),  # 0.47 deg at most
    ("no friction, margin or play", NO_ERROR),
    ("nor ticks of goal and encoder", NO_TICKS),
)


@dataclass(frozen=True)
class Row:
    """One set of values.

    Attributes:
        case: what was changed.
        method: how the values were found; "" if they were given.
        values: P (1/s), I (1/s^2), D (1/s), delay (s).
        fitness: rad, equation 11 over the recording that was fitted, divided by its rotations.
        paper_fitness: the same of the paper's ES (phi_X).
        offset: rad, median distance of the rig from its target at rest, in that recording.
        shares: alikeness in % on the sequence of the paper's rig, k = 1 to 5.
    """

    case: str
    method: str
    values: tuple[float, ...]
    fitness: float
    paper_fitness: float
    offset: float
    shares: tuple[float, ...]


def main() -> int:
    """Plays, fits, prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two lengths, no other rigs, 2 generations")
    parser.add_argument("--seed", type=int, default=0, help="of the rig's noise and of the fits (default: 0)")
    parser.add_argument("--bags", type=Path, help="folder for the recordings; those already there are not played again")
    parser.add_argument("--json", type=Path, help="write all figures there; values that it holds are not fitted again")
    options = parser.parse_args()
    rows = []
    with TemporaryDirectory() as folder:
        for row in Study(options.bags or Path(folder), options.seed, options.quick, known(options.json)).rows():
            rows.append(row)
            console().print(f"{row.case}, {row.method or 'given'}: {shown(row)}", soft_wrap=True, markup=False)
            if options.json:
                content = {"versions": versions(), "seed": options.seed, "rows": [asdict(r) for r in rows]}
                options.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    tell(rows)
    return 0


class Study:
    """The paper's rig, played once, and the fits to it."""

    def __init__(self, folder: Path, seed: int, quick: bool, known: Mapping[tuple[str, str], Sequence[float]]) -> None:
        self._known = known
        self._folder, self._seed, self._quick = folder, seed, quick
        self._rig = load_testbed("paper")
        self._model = load_model("labyrinth")
        (sequence,) = self._played(self._rig, find_sequence("paper_8s").commands, folder, 0.0)
        self._sequence, self._tunnel = sequence.trials, smooth(build_tunnel(sequence.trials))

    def rows(self) -> Iterator[Row]:
        """What was changed, step by step; the cheap ones first."""
        held = self._rotations(self._rig, USUAL if self._quick else LONGEST, "held")
        usual = cut(held, USUAL)
        yield self._given("the paper's ES (phi_X)", PAPER_1["ES (phi_X)"], usual)
        yield self._given("the paper's manual set", PAPER_1["manual"], usual)
        yield self._fitted("held for 2 s, as in the study", usual)
        yield self._fitted("I left out", usual, free=("p", "d", "delay"))
        for seconds in (0.5,) if self._quick else CUTS:
            yield self._fitted(f"held for {seconds:g} s", cut(held, seconds))
        es = EvolutionStrategy(generations=2 if self._quick else GENERATIONS)
        yield self._fitted("held for 0.5 s", cut(held, 0.5), es)
        if self._quick:
            return
        for case, changes in OTHER_RIGS:
            rig = replace(self._rig, reality=self._rig.reality.with_values(changes))
            plays = self._rotations(rig, USUAL, case.replace(" ", "_"))
            yield self._fitted(case, plays)
        yield self._fitted(case, plays, es)
        other = self._model.with_values(named(PAPER_1["manual"]))
        yield self._fitted("held for 2 s, as in the study", usual, es)
        yield self._fitted("started at the manual set", usual, es, model=other)
        yield self._fitted("another seed", usual, es, seed=self._seed + 1)

    def _rotations(self, rig: TestbedConfig, seconds: float, name: str) -> list[Play]:
        commands = find_sequence("rotations_x").commands[::EVERY]
        return self._played(rig, commands, self._folder / name, seconds - USUAL)

    def _played(self, rig: TestbedConfig, commands: tuple[Command, ...], folder: Path, longer: float) -> list[Play]:
        there = sorted((folder / "bags").glob("*"))
        if len(there) == len(commands):
            return list(to_plays([read(bag) for bag in there], load_rig("labyrinth"), signals=POSITIONS).plays)
        return list(play_all(rig, commands, TRIALS, self._seed, folder, longer))

    def _given(self, case: str, values: Sequence[float], plays: Sequence[Play]) -> Row:
        return self._row(case, "", self._model.with_values(named(values)), plays)

    def _fitted(
        self, case: str, plays: Sequence[Play], method: Any = "gauss-newton", free: Sequence[str] = NAMES,
        model: Model | None = None, seed: int | None = None,
    ) -> Row:  # fmt: skip
        start = model or self._model
        name = method if isinstance(method, str) else method.name
        if (case, name) in self._known:
            return self._row(case, name, start.with_values(named(self._known[case, name])), plays)
        settings = Settings(method=method, seed=self._seed if seed is None else seed, signals=(SIGNAL,), nthread=1)
        fit = calibrate(start, [f"drive.x.{name}" for name in free], list(plays), settings)
        return self._row(case, fit.method, start.with_values(fit.values), plays)

    def _row(self, case: str, method: str, model: Model, plays: Sequence[Play]) -> Row:
        infos = model.parameters()
        values = tuple(infos[f"drive.x.{name}"].value for name in NAMES)
        paper = self._model.with_values(named(PAPER_1["ES (phi_X)"]))
        return Row(
            case, method, values, fitness(model, plays), fitness(paper, plays), offset(plays),
            tuple(share(model, self._sequence, self._tunnel, SIGNAL)),
        )  # fmt: skip


def known(file: Path | None) -> dict[tuple[str, str], Sequence[float]]:
    """Values by case and method, of a run that was interrupted or had fewer cases."""
    if file is None or not file.exists():
        return {}
    return {(row["case"], row["method"]): row["values"] for row in json.loads(file.read_text(encoding="utf-8"))["rows"]}


def named(values: Sequence[float]) -> dict[str, float]:
    """Full names of axis x to P, I, D and delay."""
    return {f"drive.x.{name}": value for name, value in zip(NAMES, values, strict=True)}


def cut(plays: Sequence[Play], seconds: float) -> list[Play]:
    """The first seconds of each play."""
    size = round(seconds * RATE) + 1
    return [
        Play(p.name, replace(t, time=t.time[:size], values=t.values[:, :size], commands=t.commands[:, :size]))
        for p in plays
        for t in (p.trials,)
    ]


def fitness(model: Model, plays: Sequence[Play]) -> float:
    """Mean of equation 10 over the rotations, rad."""
    errors = []
    for play in plays:
        real = build_tunnel(play.trials.select((SIGNAL,))).mean[:, 0]
        errors.append(np.nanmean(np.abs(real - roll_out(model, play).select((SIGNAL,)).values[0, :, 0])))
    return float(np.mean(errors))


def offset(plays: Sequence[Play]) -> float:
    """Median over the rotations of how far the rig is from its target in the last samples, rad."""
    channel = SIGNAL.replace("board", "motor")
    ends = [
        np.nanmean(p.trials.values[:, -AT_REST:, p.trials.index(SIGNAL)])
        - p.trials.commands[0, -1, p.trials.command_channels.index(channel)]
        for p in plays
    ]
    return float(np.median(np.abs(ends)))


def shown(row: Row) -> str:
    """Its values and alikeness in words."""
    values = ", ".join(f"{n} {v:.3g}" for n, v in zip(("P", "I", "D", "delay"), row.values, strict=True))
    return f"{values}; alikeness {', '.join(f'{s:.1f}' for s in row.shares)} %"


def tell(rows: Sequence[Row]) -> None:
    """Prints the table."""
    degrees = 180 / np.pi
    table(
        console(), "Axis x, one thing changed at a time",
        ("what was fitted", "by", "P", "I", "D", "delay (ms)", "error (deg)", "paper",
         *(f"k = {k:g}" for k in KS)),
        [(row.case, row.method, f"{row.values[0]:.1f}", f"{row.values[1]:.2f}", f"{row.values[2]:.1f}",
          f"{1000 * row.values[3]:.0f}", f"{row.fitness * degrees:.3f}", f"{row.paper_fitness * degrees:.3f}",
          *(f"{s:.1f}" for s in row.shares)) for row in rows]
        + [("the paper's own", "", *("",) * 6, *(f"{s:.1f}" for s in PAPER_SHARES["x"]["ES"]))],
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
