# SPDX-License-Identifier: Apache-2.0
"""Options that several commands share."""

import argparse
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eps_tunnel_analysis.inputs import Reading
    from eps_tunnel_analysis.loop.reason import DiagnosisOptions

MOST_THREADS = 1024


def add_bag_arguments(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """--real and how bags are read; the same for every command that reads them."""
    parser.add_argument("--real", nargs="+", metavar="BAG", required=required, type=Path,
                        help="recordings of the real rig: rosbag2 folders, .mcap, .db3 or .bag files, or folders of "
                        "those; each bag is a trial, or holds trials marked on NS/trial")  # fmt: skip
    add_reading_arguments(parser)


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """How bags are read, for `reading_of`."""
    reading = parser.add_argument_group("reading bags")
    reading.add_argument("--rig", metavar="R", help="rig that says what is measured on which topic: a name in "
                         "config/rigs or a file (default: the model's rig, or else all topics in the "
                         "bags)")  # fmt: skip
    reading.add_argument("--signals", nargs="+", metavar="SIGNAL", help="signals to compare (default: every position)")
    reading.add_argument("--time-source", choices=("header", "log"), default="header",
                         help="clock to trust: the stamp set where the value was measured, or the time at which it "
                         "was recorded (default: %(default)s)")  # fmt: skip
    reading.add_argument("--rate", type=within(0.1, 1e5, "Hz"), metavar="HZ",
                         help="rate of the common grid, Hz (default: the rig's, or 100 without a rig)")  # fmt: skip
    reading.add_argument("--max-gap", type=within(1e-4, 3600.0, "s"), default=0.1, metavar="S",
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
        help="model to simulate: a name in config/models or a file; it is simulated with the recorded commands from "
        "the first recorded pose",
    )
    parser.add_argument("--effects", metavar="DIR", type=Path, help="folder with your own effect files")


def add_known_argument(parser: argparse.ArgumentParser) -> None:
    """--known."""
    parser.add_argument(
        "--known",
        nargs="+",
        metavar="PATTERN:NAME=VALUE",
        help="what was set differently in some bags: those whose path matches PATTERN were recorded with this value, "
        "for example '*kp_100*:drive.pendulum.kp=100'; a file known.yaml in or next to a bag states it permanently, "
        "with lines such as 'drive.pendulum.kp: 100'",
    )


def add_held_out_argument(parser: argparse.ArgumentParser) -> None:
    """--held-out."""
    parser.add_argument(
        "--held-out", nargs="+", metavar="BAG", type=Path, help="recordings that are never fitted, only judged"
    )


def add_known_arguments(parser: argparse.ArgumentParser) -> None:
    """--known, --timing-ms and --held-out."""
    add_known_argument(parser)
    parser.add_argument(
        "--timing-ms",
        dest="timing",
        type=_milliseconds,
        metavar="MS",
        help="known uneven timing of commands or samples within trials; more than this counts as something missing "
        "(default: 0.29 of a sample; 10 with nodes, which share a computer)",
    )
    add_held_out_argument(parser)


def add_diagnosis_arguments(parser: argparse.ArgumentParser) -> None:
    """--known, --timing-ms, --held-out, --seed, --threads, --progress."""
    add_known_arguments(parser)
    parser.add_argument("--seed", type=int, default=0, help="recorded with the result (default: %(default)s)")
    add_threads_argument(parser, ", with nodes all but one")
    parser.add_argument("--progress", choices=("bar", "lines"), default="bar",
                        help="on stderr: a bar, or lines of JSON for programs (default: %(default)s)")  # fmt: skip


def add_search_arguments(parser: argparse.ArgumentParser) -> None:
    """--candidates and --exhaustive, of commands that look for what is missing."""
    parser.add_argument("--candidates", nargs="+", metavar="EFFECT", help="effects to consider (default: all)")
    parser.add_argument("--exhaustive", action="store_true", help="search without shortcuts; takes many times as long")


def add_threads_argument(parser: Any, but: str = "") -> None:
    """--threads, of a parser or a group; 0 for all. `but` says what else the default depends on."""
    parser.add_argument(
        "--threads",
        type=_threads,
        default=0,
        metavar="N",
        help=f"threads on this machine, 0 for all (default: all{but})",
    )


def reading_of(arguments: argparse.Namespace) -> "Reading":
    """How to read bags, from the arguments of `add_reading_arguments`."""
    from eps_tunnel_analysis.inputs import Reading

    signals = None if arguments.signals is None else tuple(arguments.signals)
    return Reading(
        arguments.rig, signals, arguments.time_source, arguments.rate, arguments.max_gap, arguments.cut_to_shortest
    )


def diagnosis_options(arguments: argparse.Namespace, timing: float = 0.0, threads: int = 0) -> "DiagnosisOptions":
    """Options from the arguments of a command that diagnoses; `timing` (s) and `threads` are defaults."""
    from eps_tunnel_analysis.loop.reason import DiagnosisOptions

    candidates = getattr(arguments, "candidates", None)
    return DiagnosisOptions(
        tuple(candidates) if candidates else None, arguments.seed, arguments.threads or threads,
        timing if arguments.timing is None else arguments.timing, reading_of(arguments), arguments.effects,
        tuple(arguments.known or ()), tuple(arguments.held_out or ()), getattr(arguments, "exhaustive", False),
    )  # fmt: skip


def positive(text: str) -> float:
    """An argparse type: a number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a number above 0, got {text}")
    return value


def factor(text: str) -> float:
    """An argparse type: a factor, of either sign."""
    value = float(text)
    if value == 0.0 or not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a finite factor that is not 0, got {text}")
    return value


def within(low: float, high: float, unit: str) -> Callable[[str], float]:
    """An argparse type: a number within bounds; the error message names them with their unit."""

    def number(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must lie between {low:g} and {high:g} {unit}, got {text}")
        return value

    return number


def at_least_one(text: str) -> int:
    """An argparse type: a whole number from 1 on, of nine digits at most."""
    if not re.fullmatch("[0-9]{1,9}", text) or int(text) < 1:
        raise argparse.ArgumentTypeError(
            f"expected a whole number of at least 1, nine digits at most, got '{text:.100}'"
        )
    return int(text)


def _threads(text: str) -> int:
    if not re.fullmatch("[0-9]{1,6}", text) or int(text) > MOST_THREADS:
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 to {MOST_THREADS}, got '{text:.100}'")
    return int(text)


def _milliseconds(text: str) -> float:
    """In s."""
    value = float(text)
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected milliseconds from 0 on, got {text}")
    return value / 1e3
