# SPDX-License-Identifier: Apache-2.0
"""The two sides of a comparison as the command line names them: bags, or a model to be rolled out."""

import argparse
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labyrinth_sim.errors import Complaints, InputError

if TYPE_CHECKING:
    from eps_tunnel_analysis.recording import Recording, TrialsResult
    from labyrinth_sim.model import Model
    from labyrinth_sim.rig import Rig
    from labyrinth_sim.trials import Trials

DATA_FILES = (".mcap", ".db3")
POSITIONS = ("rad", "m")  # compared unless --signals says otherwise


@dataclass(frozen=True)
class Sides:
    """Real and simulated trials, the model if there was one, and what was read, as pairs of name and value."""

    real: "Trials"
    sim: "Trials"
    model: "Model | None"
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def add_bag_arguments(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """--real and how bags are read; the same for every command that reads them."""
    parser.add_argument("--real", nargs="+", metavar="BAG", required=required, type=Path,
                        help="recordings of the real rig: rosbag2 folders, .mcap or .db3 files, or folders of those; "
                        "each bag is a trial, or holds trials marked on NS/trial")  # fmt: skip
    reading = parser.add_argument_group("reading bags")
    reading.add_argument("--rig", metavar="R", help="rig that says what is measured on which topic: a name in "
                         "config/rigs or a file (default: the model's rig, else all that the bags offer)")  # fmt: skip
    reading.add_argument("--signals", nargs="+", metavar="SIGNAL", help="which to compare (default: every position)")
    reading.add_argument("--time-source", choices=("header", "log"), default="header",
                         help="clock to trust: the stamp set where the value was measured, or the time at which it "
                         "was recorded (default: %(default)s)")  # fmt: skip
    reading.add_argument("--rate", type=positive, default=100.0, metavar="HZ",
                         help="sampling rate of the common grid in Hz (default: %(default)g)")  # fmt: skip
    reading.add_argument("--max-gap", type=positive, default=0.1, metavar="S",
                         help="longest pause in seconds that is bridged by a straight line; samples in longer ones "
                         "count as unseen (default: %(default)g)")  # fmt: skip
    reading.add_argument("--cut-to-shortest", action="store_true",
                         help="cut trials of different length to the shortest instead of refusing them")  # fmt: skip


def add_model_arguments(parser: argparse.ArgumentParser, group: Any = None) -> None:
    """--model, required or else one of a group of alternatives, and --effects."""
    (parser if group is None else group).add_argument(
        "--model",
        metavar="M",
        required=group is None,
        help="model to simulate: a name in config/models or a file; it is played with the recorded commands from the "
        "recorded first pose",
    )
    parser.add_argument("--effects", metavar="DIR", type=Path, help="folder with effect files of your own")


def positive(text: str) -> float:
    """An argparse type: a number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a number above 0, got {text}")
    return value


def bags(paths: Sequence[Path]) -> list[Path]:
    """The bags that the paths stand for: a folder that is no bag stands for those in it."""
    found: list[Path] = []
    for path in paths:
        inside = [] if _is_bag(path) or not path.is_dir() else sorted(p for p in path.iterdir() if _is_bag(p))
        found += inside or [path]
    twice = sorted({str(p) for p in found if found.count(p) > 1})
    if twice:
        raise InputError([f"{p}: named twice; each bag counts as one trial." for p in twice])
    return found


def load_sides(arguments: argparse.Namespace) -> Sides:
    """Reads both sides.

    Raises:
        InputError: everything wrong with the bags, the rig and the model, at once.
    """
    complaints = Complaints()
    attempt = complaints.attempt
    model = attempt(lambda: _model(arguments)) if arguments.model else None
    rig = attempt(lambda: _rig(arguments)) if arguments.rig else model.rig if model else None
    real_bags = attempt(lambda: bags(arguments.real))
    real = attempt(lambda: _read(real_bags, rig, arguments)) if real_bags is not None else None
    sim_bags = attempt(lambda: bags(arguments.sim)) if getattr(arguments, "sim", None) else None
    sim = attempt(lambda: _read(sim_bags, rig, arguments)) if sim_bags else None
    complaints.check()
    assert real is not None and real_bags is not None
    if sim is not None and real.sequence_hash and sim.sequence_hash and real.sequence_hash != sim.sequence_hash:
        raise InputError(
            f"The two sides played different sequences: real '{real.sequence}' ({real.sequence_hash[:12]}), simulation "
            f"'{sim.sequence}' ({sim.sequence_hash[:12]}). Compare bags of the same sequence."
        )
    facts = _bag_facts("real", real_bags, real)
    if sim is not None and sim_bags is not None:
        facts += _bag_facts("simulation", sim_bags, sim)
        sim_trials = sim.trials
    else:
        from eps_tunnel_analysis.rollout import roll_out

        assert model is not None
        sim_trials = roll_out(model, real.trials)
        shared = [name for name in sim_trials.signals if name in real.trials.signals]
        sim_trials = sim_trials.select(shared) if shared else sim_trials
        facts += _model_facts(model)
        if sim_trials.count > 1:
            facts.append(("simulation", "rolled out for each trial, whose commands differ"))
    facts += [
        ("time source", f"{arguments.time_source} time"),
        (
            "sampling",
            f"{arguments.rate:g} Hz, {len(real.trials.time)} samples, gaps up to {arguments.max_gap:g} s bridged",
        ),
    ]
    notes = dict.fromkeys((*real.report.notes, *(sim.report.notes if sim else ())))
    return Sides(real.trials, sim_trials, model, tuple(facts), tuple(notes))


def bag_hash(bag: Path) -> str:
    """SHA-256 over a bag's data files."""
    files = sorted(p for p in bag.rglob("*") if p.suffix in DATA_FILES) if bag.is_dir() else [bag]
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _is_bag(path: Path) -> bool:
    if path.is_file():
        return path.suffix in DATA_FILES
    return path.is_dir() and ((path / "metadata.yaml").exists() or any(p.suffix in DATA_FILES for p in path.iterdir()))


def _model(arguments: argparse.Namespace) -> "Model":
    from labyrinth_sim.model import load_model

    return load_model(arguments.model, arguments.effects)


def _rig(arguments: argparse.Namespace) -> "Rig":
    from labyrinth_sim.rig import load_rig

    return load_rig(arguments.rig)


def _read(paths: Sequence[Path], rig: "Rig | None", arguments: argparse.Namespace) -> "TrialsResult":
    from eps_tunnel_analysis.recording import read_all, to_trials

    recordings = read_all(paths, arguments.time_source)
    return to_trials(recordings, rig, **reading(recordings, rig, arguments))


def reading(
    recordings: "Sequence[Recording]", rig: "Rig | None", arguments: argparse.Namespace, efforts: bool = False
) -> dict[str, Any]:
    """How the arguments of `add_bag_arguments` want recordings brought onto a grid; for `to_trials` and `to_plays`.

    Args:
        efforts: read the rig's efforts too where all recordings have them, and the ball only where all have it.
    """
    from eps_tunnel_analysis.recording import guessed_map
    from eps_tunnel_analysis.recording.channel_map import held_by_all

    names = arguments.signals
    if names is None and rig is not None and efforts:
        names = held_by_all(rig, recordings)
    elif names is None and rig is not None:
        names = _recorded(
            [n for n, unit in zip(rig.signals, rig.units, strict=True) if unit in POSITIONS], rig, recordings
        )
    elif names is None:
        first = recordings[0]
        # A camera that is not there leaves a topic without messages.
        offered = [source for source in guessed_map(first).signals if len(first.topics[source.topic])]
        names = [source.name for source in offered if source.unit in POSITIONS] or None
    return {
        "signals": names,
        "rate": arguments.rate,
        "max_gap": arguments.max_gap,
        "cut_to_shortest": arguments.cut_to_shortest,
    }


def _recorded(names: list[str], rig: "Rig", recordings: "Sequence[Recording]") -> list[str]:
    """Those signals of a rig that some recording holds messages of, as of a ball it may not; all where it has none."""
    from eps_tunnel_analysis.recording.channel_map import channel_map, namespace_of

    maps = [(r, channel_map(rig, namespace_of(r))) for r in recordings]
    there = {
        source.name
        for r, channels in maps
        for source in channels.signals
        if source.topic in r.topics and len(r.topics[source.topic])
    }
    return [name for name in names if name in there] or names


def _bag_facts(side: str, paths: Sequence[Path], result: "TrialsResult") -> list[tuple[str, str]]:
    facts = [(f"{side}, {result.trials.count} trial{'s' * (result.trials.count > 1)}", "")]
    facts += [(f"{side} bag", f"{path} (SHA-256 {bag_hash(path)[:12]})") for path in paths]
    if result.sequence:
        facts.append((f"{side} sequence", f"{result.sequence} ({result.sequence_hash[:12]})"))
    gaps = result.report.gaps
    told = [f"trial {t + 1} {s}: {length:.2f} s at {start:.2f} s" for t, s, start, length in gaps[:5]]
    more = f"; {len(gaps) - 5} more" if len(gaps) > 5 else ""
    facts.append((f"{side} gaps", "; ".join(told) + more if gaps else "none"))
    return facts[1:] if len(paths) == result.trials.count else [(facts[0][0], "marked in the bag"), *facts[1:]]


def _model_facts(model: "Model") -> list[tuple[str, str]]:
    effects = ", ".join(f"{use.effect.name} ({use.place})" for use in model.effects)
    facts = [("model", f"{model.name}, rig {model.rig.name}"), ("effects in the model", effects or "none")]
    if model.path is not None:
        facts.append(
            ("model file", f"{model.path} (SHA-256 {hashlib.sha256(model.path.read_bytes()).hexdigest()[:12]})")
        )
    return facts
