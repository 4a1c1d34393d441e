# SPDX-License-Identifier: Apache-2.0
"""The whole loop on an emulated rig with a hidden effect: gap, where, why, add, and the gap again."""

import argparse
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from eps_tunnel_analysis.diagnose.falls import of_rig
from eps_tunnel_analysis.loop.experimenter import Added, Experimenter, Plan, Played, judged
from eps_tunnel_analysis.loop.gap import Bags, Gap, RigFailed
from eps_tunnel_analysis.loop.reason import DiagnosisOptions, Reason
from eps_tunnel_analysis.nodes.live_improvement import rig_over_ros
from eps_tunnel_analysis.nodes.rig_processes import DRAW, EmulatedRig, hidden_in, hidden_in_words
from eps_tunnel_analysis.outputs import numbered_folder, shown_value
from eps_tunnel_analysis.processes import TIMING, spare_threads
from eps_tunnel_analysis.report.next_step import after_comparison, next_commands
from eps_tunnel_analysis.report.reports import before_after, loop_report
from eps_tunnel_analysis.sequence_file import find_sequence
from eps_tunnel_analysis.terminal import console, print_comparison, rollout_progress, table
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.whole_file import write_new

LEAST_PRINTED = 0.01  # probabilities below are not printed
ALIKENESS = "Alikeness is the share of time in which it stays within k times the spread of {} real trials."
HIDDEN, NOTHING = "gravity_load.y=medium", "none"


def walk(rig: EmulatedRig, plan: Plan, folder: Path) -> Path:
    """Runs the rig and one iteration of the loop, into an empty folder; returns the report's path."""
    model = load_model(plan.model)
    say = console().print
    say(f"Demo into {folder}: bags, models, logs and reports.", soft_wrap=True)
    played: list[Played] = []
    added: Added | None = None
    with rig_over_ros(rig, plan.model, folder) as client:
        domain = os.environ["ROS_DOMAIN_ID"]
        watch = f"Five processes run. To watch them: export ROS_DOMAIN_ID={domain}, then ros2 topic echo /srg"
        say(watch, soft_wrap=True)
        _title(f"1. How far, and where: rig and simulation play {plan.sequence}, {plan.trials} times")
        for step in Experimenter(plan, folder, client, rollout_progress).steps():
            match step:
                case Played():
                    played.append(step)
                    if added:
                        break
                    say(
                        f"The simulation is '{model.name}': {model.description} {ALIKENESS.format(plan.trials)}",
                        soft_wrap=True,
                    )
                    print_comparison(step.gap.comparison, step.gap.notes)
                    _title("2. Why: each effect of the library is fitted to the remaining error")
                case Reason():
                    reason = step
                    _show(reason)
                case Added():
                    added = step
                    _title("3. What to do: " + _what_to_do(step, reason, played[-1].bags, plan.model))
                    _title("4. Did it help? Both play again")
    before, after = played[-2].gap, played[-1].gap
    assert added is not None
    hidden, v = hidden_in(folder), reason.diagnosis.verdict
    right = judged(hidden, added.addition.effects, v.verdict, v.stated, model.registry)
    revealed = f"Hidden in the testbed: {hidden_in_words(hidden)}. {right}"
    sentences = [reason.content["sentence"], _fall(before, after), revealed]
    rows = before_after(before.comparison, after.comparison)
    table(console(), "Before and after", ("", "before", "after"), rows)
    for sentence in sentences:
        say(sentence, style="bold", soft_wrap=True, markup=False)
    facts = [("hidden", hidden_in_words(hidden)), ("seed", str(rig.seed)), ("model", str(added.file))]
    pages = {"gap": played[-2].report, "why": reason.report, "gap afterwards": played[-1].report}
    facts += [(name, str(page)) for name, page in pages.items()]
    next_steps = after_comparison(after.comparison, played[-1].bags.real, str(added.file), None)
    page = loop_report(before.comparison, reason.diagnosis, after.comparison, sentences, facts, next_steps, folder)
    write_new(folder / "report.html", page)
    return folder / "report.html"


def _title(text: str) -> None:
    console().print(f"\n{text}", style="bold", soft_wrap=True, markup=False)


def _show(reason: Reason) -> None:
    v = reason.diagnosis.verdict
    rows = [(name, f"{p:.1%}", "*" if name in v.stated else "") for name, p in v.set.items() if p >= LEAST_PRINTED]
    table(console(), "Hypotheses", ("hypothesis", "probability", "in the stated set"), rows)
    for line in (v.sentence, *(f"Note: {note}" for note in v.notes)):
        console().print(line, soft_wrap=True, markup=False)


def _what_to_do(added: Added, reason: Reason, bags: Bags, model: str) -> str:
    """What the demo does about it, also if the verdict names nothing."""
    if not added.words:
        return "nothing is added, because nothing was named; the model's own values are refitted."
    by_hand = next_commands(added.addition.effects, reason.recorded, bags.real, model, reason.folder)[1]
    careful = f" A careful experimenter plays {reason.folder / 'next_experiment.yaml'} first, as eps-tunnel improve " \
        "--live does." if added.why and reason.diagnosis.experiment else ""  # fmt: skip
    said = " ".join(added.addition.sentences)
    return f"{added.words} is added. {added.why}{careful} {said} By hand: {by_hand}"


def _fall(before: Gap, after: Gap) -> str:
    old, new = (shown_value(gap.error, gap.unit) for gap in (before, after))
    change = 1 - after.error / before.error
    verb = f"fell by {change:.0%}" if change > 0 else f"rose by {-change:.0%}"
    k1 = [f"{100 * min(gap.alikeness.items())[1]:.1f} %" for gap in (before, after)]
    return (
        f"On a fresh play the error {verb} compared with the model as given, from {old} to {new}; alikeness at k = 1 "
        f"went from {k1[0]} to {k1[1]}{of_rig(after.itself)}."
    )


def parser() -> argparse.ArgumentParser:
    """Options of `ros2 run eps_tunnel_analysis demo`."""
    p = argparse.ArgumentParser(
        prog="demo",
        description="Hides a physical effect in an emulated rig, plays a sequence on it and on its simulation, says "
        "how far apart they are, where and why, adds what is missing, and plays again. Needs no rig and no screen.",
    )
    p.add_argument("--effect", action="append", default=[], metavar="NAME[.AXIS][=STRENGTH]",
                   help=f"what to hide; {DRAW} picks one at random and reveals it at the end, {NOTHING} hides nothing "
                   f"(default: {HIDDEN}); `ros2 run labyrinth_hw testbed --list` lists them")  # fmt: skip
    p.add_argument("--sequence", default="excite_12s", help="name or path of the sequence (default: %(default)s)")
    p.add_argument("--trials", type=_count, default=3, metavar="N",
                   help="trials per play (default: %(default)s)")  # fmt: skip
    p.add_argument("--model", default="labyrinth_mx64", help="name or path of the model (default: %(default)s)")
    p.add_argument(
        "--testbed", default="healthy", metavar="CONFIG", help="config/testbed/*.yaml (default: %(default)s)"
    )
    p.add_argument("--hw", default="healthy", metavar="CONFIG", help="config/hw/*.yaml (default: %(default)s)")
    p.add_argument("--candidates", nargs="+", metavar="EFFECT", help="effects that are considered (default: all)")
    p.add_argument("--seed", type=int, help="of the testbed's noise and of the draw (default: at random, printed)")
    p.add_argument("--out", type=Path, default=Path("out"), metavar="DIR", help="where demo-N is made (default: out)")
    return p


def main(args: Sequence[str] | None = None) -> int:
    """Returns 0, 2 for bad input, 1 when a process died or the run failed, 130 after Ctrl-C."""
    given = parser().parse_args(_without_ros(sys.argv[1:] if args is None else args))
    began = time.monotonic()
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        find_sequence(given.sequence)
        load_model(given.model).registry.check(given.candidates or ())
        hidden = tuple(name for name in given.effect or [HIDDEN] if name != NOTHING)
        seed = given.seed if given.seed is not None else int.from_bytes(os.urandom(2), "little")
        rig = EmulatedRig(given.testbed, given.hw, hidden, seed)
        folder = numbered_folder(given.out, "demo")
        candidates = tuple(given.candidates) if given.candidates else None
        options = DiagnosisOptions(candidates, threads=spare_threads(), timing=TIMING)
        plan = Plan(given.model, given.sequence, given.trials, 1, 0, options, replay=True, propose=False)
        report = walk(rig, plan, folder)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except RigFailed as error:
        print(f"\nThe demo ended early: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nInterrupted; what was recorded until then is whole.", file=sys.stderr)
        return 130
    print(f"Done in {time.monotonic() - began:.0f} s. Page with pictures: {report.resolve()}")
    return 0


def _without_ros(args: Sequence[str]) -> list[str]:
    given = list(args)
    return given[: given.index("--ros-args")] if "--ros-args" in given else given


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got '{text}'")
    return int(text)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
