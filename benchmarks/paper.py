# SPDX-License-Identifier: Apache-2.0
"""The paper's case study on the emulated rig: `make paper`, or python benchmarks/paper.py [--quick].

The rig of config/testbed/paper.yaml plays the single rotations and the eight-second sequence into bags; the evolution
strategy is run for each servo on the rotations; Tables 1 to 3 are printed beside the paper's, Figures 4 and 5 drawn.

phi is what the potentiometers measure, board_x and board_y. At rest the servos' own encoders, of 0.29 deg resolution,
show the same number in every trial: a tunnel of width zero, which no simulation meets at any k.
"""

import argparse
import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from paper_figures import draw_figure_4, draw_figure_5
from tqdm import tqdm

from eps_tunnel_analysis.alikeness import KS, alikeness_over_k
from eps_tunnel_analysis.calibration.calibrate import Fit, Settings, calibrate
from eps_tunnel_analysis.fit.methods import EvolutionStrategy
from eps_tunnel_analysis.fit.problem import Part
from eps_tunnel_analysis.outputs import versions
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.recording import read, to_plays
from eps_tunnel_analysis.sequence import Command
from eps_tunnel_analysis.sequence_file import find_sequence
from eps_tunnel_analysis.simulated import roll_out
from eps_tunnel_analysis.terminal import console, fit_bars, table
from eps_tunnel_analysis.tunnel import Tunnel, build_tunnel, smooth
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import TestbedConfig, load_testbed
from labyrinth_hw.testbed.offline import run_offline
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.rig import load_rig
from labyrinth_sim.trials import Array, Trials

RATE = 100.0  # Hz
REST_S = 1.0  # since the last step of the command; then the rig stands still
POSITIONS = ["motor_x", "motor_y", "board_x", "board_y"]
PAPER_1 = {
    "standard": (1.0, 0.0, 0.0, 0.0),
    "manual": (20.0, 0.0, 0.0, 0.03),
    "ES (phi_X)": (24.52, 0.0, 0.95, 0.049),
    "ES (phi_Y)": (20.24, 0.0, -7.33, 0.049),
}
PAPER_SHARES = {
    "x": {
        "standard": (13.74, 31.30, 42.75, 45.67, 47.84),
        "manual": (0.64, 5.98, 66.03, 77.10, 98.35),
        "ES": (0.76, 5.34, 73.79, 77.35, 98.47),
    },
    "y": {
        "standard": (32.70, 39.31, 44.15, 48.35, 51.15),
        "manual": (87.40, 95.17, 98.35, 99.11, 99.75),
        "ES": (88.67, 95.67, 98.60, 99.75, 100.00),
    },
}


@dataclass(frozen=True)
class Rest:
    """The rig standing still: how far from its target, against how well it repeats that; rad, medians."""

    offset: float
    half_width: float


def main() -> int:
    """Plays, fits, prints; everything made lies in a new folder under out/."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="20 generations, every other angle, 5 trials")
    parser.add_argument("--seed", type=int, default=0, help="of the rig's noise and of the strategy (default: 0)")
    parser.add_argument("--rig", default="paper", help="emulated rig: a name in config/testbed or a file")
    parser.add_argument("--torque-noise", type=float, metavar="NM",
                        help="random torque on the board, N m, instead of the rig's own; it decides how well the rig "
                        "repeats where it stops, and so how wide its tunnel is at rest")  # fmt: skip
    parser.add_argument("--out", type=Path, help="new folder for bags, tables, figures (default: out/paper-N)")
    options = parser.parse_args()
    out = options.out or next(p for n in range(1, 10_000) if not (p := Path("out") / f"paper-{n}").exists())
    out.mkdir(parents=True)
    testbed = load_testbed(options.rig)
    if options.torque_noise is not None:
        testbed = replace(testbed, reality=testbed.reality.with_values({"torque_noise": options.torque_noise}))
    trials, every, generations = (5, 2, 20) if options.quick else (20, 1, 150)

    rotations = {
        axis: play_all(testbed, find_sequence(f"rotations_{axis}").commands[::every], trials, options.seed, out)
        for axis in "xy"
    }
    (sequence,) = play_all(testbed, find_sequence("paper_8s").commands, 10, options.seed, out)
    standard, manual = load_model("labyrinth"), load_model("labyrinth_manual")
    fits, fitted = {}, {}
    for axis in "xy":
        fits[axis] = evolve(standard, axis, rotations[axis], generations, options.seed)
        fitted[axis] = standard.with_values(fits[axis].values, f"ES on phi_{axis.upper()}, seed {options.seed}")

    tunnel = smooth(build_tunnel(sequence.trials))
    shares = {
        axis: {
            name: share(model, sequence.trials, tunnel, f"board_{axis}")
            for name, model in (("standard", standard), ("manual", manual), ("ES", fitted[axis]))
        }
        for axis in "xy"
    }
    rest = {axis: at_rest(sequence.trials, tunnel, f"board_{axis}") for axis in "xy"}
    tell(fits, shares, rest)
    sets = {"standard": standard, "manual": manual, "ES": fitted["x"]}
    largest = max(rotations["x"], key=lambda play: float(play.trials.commands[0, -1, 0]))
    draw_figure_4(out, largest, sets)
    draw_figure_5(out, sequence, tunnel, fitted["x"])
    content = {
        "versions": versions(), "seed": options.seed, "rig": testbed.name, "trials": trials,
        "fits": {axis: fit.to_json() for axis, fit in fits.items()}, "alikeness": shares,
        "rest": {axis: asdict(r) for axis, r in rest.items()},
    }  # fmt: skip
    (out / "paper.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    console().print(f"Bags, figures 4 and 5, paper.json: {out}", soft_wrap=True)
    return 0


def play_all(
    testbed: TestbedConfig, commands: tuple[Command, ...], trials: int, seed: int, out: Path, longer: float = 0.0
) -> tuple[Play, ...]:
    """Plays each command on the emulated rig, into a bag each, and reads them back.

    Args:
        longer: s for which the last target is held besides.
    """
    bags = []
    for number, command in enumerate(tqdm(commands, desc=f"playing {commands[0].name.split('/')[0]}", leave=False)):
        _, steps = command.sample(RATE)
        # The rig rests at the initial pose; the first sample at which it is commanded to move comes after it.
        held = np.vstack([command.initial, steps, *[steps[-1]] * round(longer * RATE)])
        run = run_offline(testbed, np.arange(len(held)) / RATE, held, trials, seed + number)
        bags.append(write_bag(out / "bags" / command.name.replace("/", "_"), run, command.name, command.hash))
    return to_plays([read(bag) for bag in bags], load_rig("labyrinth"), signals=POSITIONS).plays


def evolve(model: Model, axis: str, plays: list[Play], generations: int, seed: int) -> Fit:
    """The paper's (5 + 100) strategy on one servo's P, I, D and delay."""
    free = tuple(f"drive.{axis}.{name}" for name in ("p", "i", "d", "delay"))
    signals = (f"board_{axis}",)
    strategy = EvolutionStrategy(generations=generations)
    with fit_bars("bar") as bars:
        bar = bars(Part(axis, free, signals, ()), strategy.budget) if bars else None
        return calibrate(model, free, plays, Settings(method=strategy, seed=seed, signals=signals), bar)


def share(model: Model, real: Trials, tunnel: Tunnel, signal: str) -> list[float]:
    """Alikeness of one signal in % at k = 1..5, equation 13."""
    simulated = roll_out(model, Play("", real)).select(real.signals)
    return [100 * a.shares[signal] for a in alikeness_over_k(tunnel, build_tunnel(simulated), KS)]


def at_rest(trials: Trials, tunnel: Tunnel, signal: str) -> Rest:
    """What the rig is like once a step is over."""
    target = trials.commands[0, :, trials.command_channels.index(signal.replace("board", "motor"))]
    steps = np.flatnonzero(np.diff(target)) + 1
    since = np.arange(len(target)) - np.array(
        [max([s for s in steps if s <= k], default=0) for k in range(len(target))]
    )
    still = since >= REST_S * RATE
    column = tunnel.index(signal)
    width: Array = 0.5 * (tunnel.upper - tunnel.lower)[still, column]
    return Rest(float(np.nanmedian(np.abs(tunnel.mean[still, column] - target[still]))), float(np.nanmedian(width)))


def tell(fits: dict[str, Fit], shares: dict[str, dict[str, list[float]]], rest: dict[str, Rest]) -> None:
    """Prints the tables and the findings."""
    out = console()
    ours = dict(list(PAPER_1.items())[:2])
    half = {}
    for axis, fit in fits.items():
        ours[f"ES (phi_{axis.upper()})"] = tuple(p.value for p in fit.parameters)  # type: ignore[assignment]
        half[f"ES (phi_{axis.upper()})"] = [p.half_width for p in fit.parameters]
    table(
        out, "Table 1: motor parameters, ours (paper's)", ("set", "P", "I", "D", "delay (s)"),
        [(name, *(f"{v:.4g} ± {half[name][i]:.2g} ({p:.4g})" if name in half else f"{v:.4g} ({p:.4g})"
                  for i, (v, p) in enumerate(zip(ours[name], PAPER_1[name], strict=True)))) for name in PAPER_1],
    )  # fmt: skip
    for number, axis in ((2, "x"), (3, "y")):
        table(
            out, f"Table {number}: alikeness of phi_{axis.upper()} in %, ours (paper's)",
            ("set", *(f"kR = {k:g}" for k in KS)),
            [(name, *(f"{o:.2f} ({p:.2f})" for o, p in zip(shares[axis][name], PAPER_SHARES[axis][name], strict=True)))
             for name in PAPER_SHARES[axis]],
        )  # fmt: skip
    degrees = 180 / np.pi
    table(
        out, "The rig standing still", ("servo", "short of its target by", "half-width of its tunnel", "ratio"),
        [(f"phi_{axis.upper()}", f"{r.offset * degrees:.3f} deg", f"{r.half_width * degrees:.3f} deg",
          f"{r.offset / max(r.half_width, 1e-9):.1f}") for axis, r in rest.items()],
    )  # fmt: skip
    for text in findings(shares, rest):
        out.print(text, soft_wrap=True, markup=False)
    for fit in fits.values():
        for warning in fit.warnings:
            out.print(f"Warning: {warning}", soft_wrap=True, markup=False)


def findings(shares: dict[str, dict[str, list[float]]], rest: dict[str, Rest]) -> list[str]:
    """The paper's statements, each with whether it holds here."""
    x, y = shares["x"], shares["y"]
    at_5 = all(s[name][-1] > s["standard"][-1] for s in (x, y) for name in ("manual", "ES"))
    odd = [k for i, k in enumerate(KS) if x["standard"][i] > max(x["manual"][i], x["ES"][i])]
    statements = [
        f"[{'yes' if at_5 else 'no'}] At kR = 5 the optimised sets are more alike than the standard set on both axes.",
        f"[{'yes' if y['ES'][-1] >= x['ES'][-1] and y['ES'][0] > x['ES'][0] else 'no'}] phi_Y becomes more alike than "
        "phi_X.",
        f"[{'yes' if rest['x'].offset > rest['y'].offset else 'no'}] The servo of phi_X stops further from its target "
        "than that of phi_Y.",
        f"[{'yes' if odd else 'no'}] On phi_X the standard set beats the optimised ones at small kR"
        + (f" (here kR = {', '.join(f'{k:g}' for k in odd)})." if odd else "."),
    ]
    ratio = rest["x"].offset / max(rest["x"].half_width, 1e-9)
    statements.append(
        f"At rest the real phi_X lies {ratio:.1f} half-widths of its tunnel from the target; a simulation that reaches "
        f"its target is outside until kR = {ratio:.1f}, while the slow standard set crosses the tunnel on its way."
    )
    return statements


if __name__ == "__main__":
    sys.exit(main())
