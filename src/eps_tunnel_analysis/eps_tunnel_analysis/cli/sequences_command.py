# SPDX-License-Identifier: Apache-2.0
"""sequences: what can be played, and a sequence's commands as a table."""

import argparse
import csv
import io
import math
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.cli.arguments import within
from eps_tunnel_analysis.outputs import shown_number
from eps_tunnel_analysis.terminal import console, table
from labyrinth_sim.whole_file import write_new

if TYPE_CHECKING:
    from eps_tunnel_analysis.sequence import Sequence

NAME = "sequences"
HELP = "Lists the command sequences, or writes the sampled commands of one as CSV."
MOST_ROWS = 2_000_000
EPILOG = """\
examples:
  eps-tunnel sequences
  eps-tunnel sequences excite_12s --csv excite_12s.csv
  eps-tunnel sequences why/next_experiment.yaml --csv next.csv
  eps-tunnel sequences rotations_x/+2.0deg --csv step.csv

columns of the CSV: time (s), then the target of each joint (rad)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", nargs="?", metavar="NAME", help="a name in config/sequences, NAME/COMMAND, or a file "
                        "(default: list all)")  # fmt: skip
    parser.add_argument("--csv", metavar="FILE", type=Path, help="write its sampled commands to this new file")
    parser.add_argument(
        "--rate", type=within(0.1, 1e5, "Hz"), default=100.0, metavar="HZ", help="samples per second (default: 100)"
    )


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.sequence_file import find_sequence
    from labyrinth_sim import config
    from labyrinth_sim.errors import InputError

    if arguments.csv and not arguments.name:
        raise InputError(
            "--csv: name the sequence whose commands are to be written. `eps-tunnel sequences` lists them."
        )
    names = [arguments.name] if arguments.name else config.names("sequences")
    sequences = [find_sequence(name) for name in names]
    if arguments.csv:
        write_csv(sequences[0], arguments.csv, arguments.rate)
        return
    rows = [(s.name, str(len(s.commands)), str(s.trials), f"{max(c.duration for c in s.commands):g} s", _reach(s),
             s.description) for s in sequences]  # fmt: skip
    table(console(), "Sequences", ("name", "commands", "trials", "length", "reach", "what"), rows, left=6)


def write_csv(sequence: "Sequence", file: Path, rate: float) -> None:
    """Writes the samples of a sequence of one command.

    Raises:
        InputError: it has several commands, or the file exists.
    """
    from labyrinth_sim.errors import InputError

    if len(sequence.commands) > 1:
        names = ", ".join(command.name for command in sequence.commands)
        raise InputError(f"{sequence.name} has {len(sequence.commands)} commands; name one of {names}.")
    command = sequence.commands[0]
    if command.duration * rate > MOST_ROWS:
        raise InputError(
            f"{command.name}: {command.duration:g} s at {rate:g} Hz would be {shown_number(command.duration * rate)} "
            f"rows; expected at most {MOST_ROWS}. Lower --rate."
        )
    time, targets = command.sample(rate)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time", *command.channels])
    writer.writerows([f"{t:.6f}", *(f"{v:.9f}" for v in row)] for t, row in zip(time, targets, strict=True))
    write_new(file, stream.getvalue(), by="--csv")
    print(f"{file}: {len(time)} samples, {command.duration:g} s, {', '.join(command.channels)}")


def _reach(sequence: "Sequence") -> str:
    """The largest target of each channel in degrees, either way."""
    largest: dict[str, float] = {}
    for command in sequence.commands:
        for channel, (low, high) in command.reach().items():
            largest[channel] = max(largest.get(channel, 0.0), -low, high)
    return ", ".join(f"{channel} {shown_number(math.degrees(value))} deg" for channel, value in largest.items())
