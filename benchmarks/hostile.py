# SPDX-License-Identifier: Apache-2.0
"""Attacks the command line with damaged and crafted files, and counts the outcomes.

    python benchmarks/hostile.py --tries 10000 --seed 0 --json hostile.json

Each try damages one of a set of small valid files, or an option, and runs one command in a process whose memory is
limited. `refused` and `handled` are as they should be (exit codes 2 and 0); `tracebacks` (a crash of the process
included), `hangs` (over 20 s of processor time), `memory` (over 2 GiB) and `left_behind` (anything left of a refused
command's output, or an input changed) are failures. A try depends on its own seed alone: `--only SEED` runs it again.
"""

import argparse
import contextlib
import hashlib
import io
import json
import multiprocessing
import os
import random
import resource
import shutil
import sqlite3
import struct
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Metadata, Schema
from rosbags.rosbag2 import StoragePlugin, Writer

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.recording import BagWriter
from eps_tunnel_analysis.recording.bag import MAGIC, TwoTypesError, read_mcap
from eps_tunnel_analysis.recording.decode import BALL_STATE, JOINT_STATE, TRIAL, typestore
from labyrinth_hw.testbed.command_line import main as testbed
from labyrinth_sim.config import find

MOST_SECONDS = 20.0  # of processor time, for one try
MOST_MEMORY = 2 << 30  # bytes beyond what the process has after its imports
STUCK = 600.0  # s without an answer and without work; a process that waits for nothing
FAILURES = ("tracebacks", "hangs", "memory", "left_behind")
START = 1_700_000_000_000_000_000  # ns
SAMPLES = 31
KINDS = (JOINT_STATE, BALL_STATE, TRIAL)
NUMBERS = (
    0,
    1,
    -1,
    7,
    1e-300,
    1e9,
    1e300,
    -1e6,
    float("nan"),
    float("inf"),
    2**31 - 1,
    2**31,
    2**63 - 1,
    2**63,
    2**64 - 1,
)
TIMES = tuple(int(n) for n in NUMBERS if 0 <= n < 2**64)
WORDS = (
    *("nan", "-inf", "1e999", "-1", "0", "1e-300", "99999999999999999999", "null", "~", "[]", "{}", "true", "*a", "&a"),
    *("2020-99-99", "!!python/name:os.system", "<<: *a", "\0", "\u2028", "é", "../../x", "/dev/null", "x" * 5000, "'"),
    *('"', "- - - -", "? ", "|", "%s", "{0}", "[" * 60, "=", ",,,", "\t", "0x1F", "1_000", "::", "rad", "deg"),
)
URDF = """\
<robot name="horn">
  <link name="base"/>
  <link name="horn">
    <inertial>
      <mass value="0.01"/>
      <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="horn" type="revolute">
    <parent link="base"/>
    <child link="horn"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="2" velocity="5"/>
  </joint>
</robot>
"""


@dataclass(frozen=True)
class Outcome:
    """How a try ended: one of "refused", "handled" and FAILURES; `words` describe a failure."""

    kind: str
    words: str = ""


# The valid files


def prepare(folder: Path) -> None:
    """Small files of every kind that the commands read."""
    for name, lag in (("real_0", 0.03), ("real_1", 0.031), ("sim", 0.05)):
        _bag(folder / name, f"/{name.split('_')[0]}", lag)
    chunked = folder / "real_0" / "real_0.mcap"
    (folder / "whole.mcap").write_bytes(chunked.read_bytes())
    (folder / "killed").mkdir()
    (folder / "killed" / "killed.mcap").write_bytes(chunked.read_bytes()[: chunked.stat().st_size * 2 // 3])
    store = typestore()
    writer = Writer(folder / "table", version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        topics: dict[str, Any] = {}
        for topic, kind, at, message in _messages("/real", 0.03):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], at, message)
    for kind, name in (("rigs", "horn.yaml"), ("mjcf", "horn.xml")):
        shutil.copy(find(kind, "horn"), folder / name)
    shutil.copy(find("sequences", "ball_3s"), folder / "sequence.yaml")
    model = find("models", "horn").read_text(encoding="utf-8").replace("rig: horn", "rig: horn.yaml")
    (folder / "model.yaml").write_text(model, encoding="utf-8")
    (folder / "horn.urdf").write_text(URDF, encoding="utf-8")
    (folder / "known").mkdir()
    shutil.copytree(folder / "real_0", folder / "known" / "real")
    (folder / "known" / "known.yaml").write_text("drive.horn.damping: 0.5\n", encoding="utf-8")
    hw = Path(sys.modules["labyrinth_hw"].__file__ or "").parents[1] / "config" / "testbed" / "paper.yaml"
    (folder / "testbed.yaml").write_text(hw.read_text(encoding="utf-8"), encoding="utf-8")
    rows = [f"{i / 100:.2f},{0.1 * (i > 5)},{0.1 * (i > 8)},{0.5}" for i in range(SAMPLES)]
    (folder / "log.csv").write_text("\n".join(["t,goal,angle,amps", *rows]) + "\n", encoding="utf-8")
    goals = [f"{i / 100:.2f},{0.02 * (i > 5)},0.0" for i in range(SAMPLES)]
    (folder / "goals.csv").write_text("\n".join(["time,motor_x,motor_y", *goals]) + "\n", encoding="utf-8")
    with contextlib.redirect_stdout(io.StringIO()):
        assert main([*FIT, "--real", str(folder / "real_0"), "--model", str(folder / "model.yaml"), "--checkpoint",
                     str(folder / "checkpoint"), "--out", str(folder / "fitted.yaml")]) == 0  # fmt: skip


def _bag(folder: Path, side: str, lag: float) -> None:
    with BagWriter(folder, {"sequence": "step", "sequence_hash": "a" * 64}) as writer:
        for topic, kind, at, message in _messages(side, lag):
            writer.add_topic(topic, kind)
            writer.write(topic, at, message)


def _messages(side: str, lag: float) -> Iterator[tuple[str, str, int, bytes]]:
    store = typestore()
    kinds: Any = store.types
    none = np.zeros(0)

    def header(at: int) -> Any:
        return kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](*divmod(at, 10**9)), "")

    def mark(at: int, phase: int) -> tuple[str, str, int, bytes]:
        message = kinds[TRIAL](header(at), phase, "step", "a" * 64, 0, (SAMPLES - 1) / 100)
        return f"{side}/trial", TRIAL, at, bytes(store.serialize_cdr(message, TRIAL))

    yield mark(START, 0)
    for i in range(SAMPLES):
        at, t = START + i * 10**7, i / 100
        target, value = 0.1 * (t >= 0.05), 0.1 * (1 - np.exp(-max(t - 0.05, 0) / lag))
        for topic, position in (("joint_commands", target), ("joint_states", value)):
            message = kinds[JOINT_STATE](header(at), ["joint"], np.array([position], dtype=float), none, none)
            yield f"{side}/{topic}", JOINT_STATE, at, bytes(store.serialize_cdr(message, JOINT_STATE))
        ball = kinds[BALL_STATE](header(at), True, 0.01, 0.02)
        yield f"{side}/ball", BALL_STATE, at, bytes(store.serialize_cdr(ball, BALL_STATE))
    yield mark(START + (SAMPLES - 1) * 10**7, 1)


# What is done to them


def damage_bytes(rng: random.Random, data: bytes) -> bytes:
    """Bits, numbers and slices changed, lost, doubled."""
    raw = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at, size = rng.randrange(max(len(raw), 1)), rng.choice((1, 2, 4, 8, 40, 400))
        action = rng.randrange(6)
        if action == 0 and raw:
            raw[at] ^= 1 << rng.randrange(8)
        elif action == 1:
            raw[at : at + size] = bytes(rng.randrange(256) for _ in range(min(size, 40)))
        elif action == 2:
            del raw[at : at + size]
        elif action == 3:
            raw[at:at] = raw[at : at + size]
        elif action == 4:
            raw[at : at + 8] = _packed(rng)
        else:
            del raw[at:]
    return bytes(raw)


def _packed(rng: random.Random) -> bytes:
    number = rng.choice(NUMBERS)
    with contextlib.suppress(struct.error, OverflowError, ValueError):
        return struct.pack(rng.choice(("<q", "<Q", "<i", "<I")), int(number))
    return struct.pack("<d", float(number))


def damage_text(rng: random.Random, text: str) -> str:
    """Words, lines and characters changed, lost, doubled, nested."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        lines = text.split("\n")
        at = rng.randrange(len(lines))
        line, action, word = lines[at], rng.randrange(9), rng.choice(WORDS)
        if action == 0:
            del lines[at]
        elif action == 1:
            lines.insert(at, rng.choice(lines))
        elif action == 2:
            cut = rng.randrange(len(line) + 1)
            lines[at] = line[:cut] + word + line[cut:]
        elif action == 3 and ":" in line:
            lines[at] = line.partition(":")[0] + ": " + word
        elif action == 4:
            lines[at] = " " * rng.randrange(9) + line.strip()
        elif action == 5:
            parts = line.replace(",", " ").replace(":", " ").split()
            lines[at] = line.replace(rng.choice(parts), word) if parts else word
        elif action == 6:
            lines[at:at] = [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}' if i else 'x'] * 9)}]" for i in range(12)]
        elif action == 7:
            lines[at] = line[: rng.randrange(len(line) + 1)]
        else:
            lines[at] = line + rng.choice(("{", "[")) * rng.choice((1, 50, 4000))
        text = "\n".join(lines)
    return text


def rebuilt_mcap(rng: random.Random, data: bytes, folder: Path) -> bytes:
    """A file with the same messages, well formed and with right checksums, but for a few fields that say otherwise."""
    source = folder / "source"
    source.write_bytes(data)
    try:
        topics = read_mcap(source).topics
    finally:
        source.unlink()
    content: list[Any] = []
    odd = rng.randrange(8)
    for number, (name, topic) in enumerate(topics.items(), start=1):
        definition, type_ = topic.definition.data, topic.type
        if odd == 0 and rng.random() < 0.5:
            definition = damage_text(rng, definition)
        if odd == 1 and rng.random() < 0.5:
            odd_type, odd_name, other = damage_text(rng, type_), damage_text(rng, name), rng.choice(KINDS)
            names = ((name, odd_type), (odd_name, type_), ("", ""), (name, other), ("/sim/ball", type_))
            name, type_ = rng.choice(names)
        content.append(Schema(number, definition.encode(errors="replace"), "ros2msg", type_))
        content.append(Channel(number, name, "cdr", {}, number))
        for at, message in zip(topic.log_times, topic.messages, strict=True):
            time_, payload = at, message
            if odd == 2 and rng.random() < 0.1:
                time_ = rng.choice(TIMES)
            if odd in (3, 4) and rng.random() < (0.05 if odd == 3 else 0.5):
                payload = _damaged_payload(rng, message)
            content.append(Message(number, time_, payload, time_, 0))
    if odd == 5:
        rng.shuffle(content)
    records = _records(*content)
    if odd == 6:
        records = damage_bytes(rng, records)
    size = len(records) if odd != 7 else rng.choice(TIMES)
    kind = rng.choice(("zstd", "", "lz4", "zstd"))
    packed = zstandard.compress(records) if kind == "zstd" else records
    body = [Header("ros2", "x"), Metadata("eps_tunnel", {"k": "v"}), Chunk(kind, packed, 0, 0, 0, size)]
    return MAGIC + _records(*body, DataEnd(0), Footer(0, 0, 0)) + MAGIC


def _damaged_payload(rng: random.Random, data: bytes) -> bytes:
    raw = bytearray(data)
    at = 4 + 4 * rng.randrange(max((len(raw) - 4) // 4, 1))
    number = struct.pack("<d", float(rng.choice(NUMBERS))) if rng.random() < 0.5 else _packed(rng)
    raw[at : at + rng.choice((4, len(number)))] = number
    return bytes(raw)


def _records(*content: Any) -> bytes:
    builder = RecordBuilder()
    for record in content:
        record.write(builder)
    return bytes(builder.end())


CELLS = (
    *(("messages", column) for column in ("timestamp", "data", "topic_id")),
    *(("topics", column) for column in ("name", "type", "id", "serialization_format")),
)


def damage_table(rng: random.Random, file: Path) -> None:
    """A database with odd values in its cells."""
    values: list[Any] = [None, "text", b"", -1, 2**62, 1.5, b"\x00\x01\x00\x00", "x/y/z", "a\0b"]
    table, column = rng.choice(CELLS)
    with contextlib.closing(sqlite3.connect(file)) as base, contextlib.suppress(sqlite3.Error):
        where = rng.choice(("", " WHERE id = 1", " WHERE id % 2 = 0"))
        base.execute(f"UPDATE {table} SET {column} = ?{where}", (rng.choice(values),))
        base.commit()


def damage(rng: random.Random, file: Path) -> None:
    """Damages one file."""
    data = file.read_bytes()
    if file.suffix == ".mcap" and rng.random() < 0.6:
        # What no file can hold, and what cannot be read after the damage before.
        with contextlib.suppress(ValueError, struct.error, OverflowError, TwoTypesError):
            data = rebuilt_mcap(rng, data, file.parent)
    elif file.suffix == ".db3" and rng.random() < 0.6:
        damage_table(rng, file)
        return
    elif file.suffix in (".yaml", ".csv", ".xml", ".urdf") and rng.random() < 0.85:
        data = damage_text(rng, data.decode(errors="replace")).encode(errors="surrogatepass")
    else:
        data = damage_bytes(rng, data)
    file.write_bytes(data)


# The commands

FIT = ("calibrate", "--signals", "joint", "--method", "es", "--generations", "1", "--budget", "101", "--threads", "1",
       "--free", "drive.horn.damping", "--no-axis", "--progress", "none")  # fmt: skip
FITTED = " --real {0}/real_0 --model {0}/model.yaml --checkpoint {0}/checkpoint --out OUT.yaml"
TABLE = "import-csv {0}/log.csv --time t --command joint=goal --position joint=angle --effort joint=amps --out OUT"
Command = tuple[str, str, tuple[str, ...]]
"""The line, with {0} for the folder and OUT for its output; and the files that may be damaged."""
MCAP = ("real_0/real_0.mcap", "real_0/metadata.yaml")
COMMANDS: tuple[Command, ...] = (
    ("compare", "compare --real {0}/real_0 {0}/real_1 --sim {0}/sim", MCAP),
    ("compare", "compare --real {0}/real_0 --sim {0}/sim --rig {0}/horn.yaml --time-source log", (*MCAP, "horn.yaml")),
    ("compare", "compare --real {0}/whole.mcap --sim {0}/sim", ("whole.mcap",)),
    ("compare", "compare --real {0}/killed --sim {0}/sim --cut-to-shortest", ("killed/killed.mcap",)),
    ("compare", "compare --real {0}/table --sim {0}/sim", ("table/table.db3", "table/metadata.yaml")),
    ("compare", "compare --real {0}/real_0 --model {0}/model.yaml", ("model.yaml", "horn.yaml", "horn.xml")),
    ("compare", "compare --real {0}/real_0 --sim {0}/sim --out OUT", MCAP),
    ("repair", "repair {0}/real_0 --out OUT", MCAP),
    ("repair", "repair {0}/killed --out OUT", ("killed/killed.mcap",)),
    ("import-csv", TABLE, ("log.csv",)),
    ("sequences", "sequences {0}/sequence.yaml --csv OUT", ("sequence.yaml",)),
    ("calibrate", " ".join(FIT) + FITTED, ("checkpoint", "model.yaml", "horn.yaml", "real_0/real_0.mcap")),
    ("compare", "compare --real {0}/known/real --model {0}/model.yaml", ("known/known.yaml", "known/real/real_0.mcap")),
    ("check", "check --real {0}/real_0 --model {0}/model.yaml --candidates gain_error --threads 1",
     ("model.yaml", "horn.yaml", "horn.xml", *MCAP)),
    ("sweep", "sweep drive.horn.damping=0:1:2 --real {0}/real_0 --model {0}/model.yaml --threads 1 --out OUT",
     ("model.yaml", "horn.xml", "real_0/real_0.mcap")),
    ("export", "export --model {0}/model.yaml --mjcf OUT.xml", ("model.yaml", "horn.yaml", "horn.xml")),
    ("new-rig", "new-rig {0}/horn.xml --bag {0}/real_0 --no-check --out OUT", ("horn.xml", "real_0/real_0.mcap")),
    ("new-rig", "new-rig {0}/horn.urdf --csv {0}/log.csv --no-check --out OUT", ("horn.urdf", "log.csv")),
    ("testbed", "--config {0}/testbed.yaml --bag OUT --reveal OUT.json --commands {0}/goals.csv --trials 1 --seed 1",
     ("testbed.yaml", "goals.csv")),
)  # fmt: skip
OPTIONS = {
    "compare": ("--rate", "--max-gap", "--k", "--k-sim", "--signals", "--rig", "--time-source"),
    "import-csv": ("--scale", "--time", "--position", "--namespace", "--command"),
    "sequences": ("--rate",),
    "calibrate": ("--rate", "--budget", "--hold-out", "--free", "--seed", "--signals", "--generations"),
    "check": ("--rate", "--max-gap", "--threads", "--signals", "--known"),
    "sweep": ("--rate", "--k", "--threads", "--known"),
    "new-rig": ("--match", "--threads", "--position-unit"),
    "testbed": ("--trials", "--seed", "--effect"),
}


def attempt(seed: int, valid: Path, folder: Path) -> Outcome:
    """One try, in a new folder that is removed by the caller."""
    rng = random.Random(seed)
    inputs, out = folder / "in", folder / "out"
    shutil.copytree(valid, inputs)
    out.mkdir()
    command, line, files = rng.choice(COMMANDS)
    arguments = [word.format(inputs).replace("OUT", str(out / "result")) for word in line.split()]
    if rng.random() < 0.15 and command in OPTIONS:
        value = str(rng.choice(NUMBERS)) if rng.random() < 0.6 else rng.choice(WORDS).replace("\0", "")
        arguments += [rng.choice(OPTIONS[command]), value]
    else:
        for _ in range(rng.choice((1, 1, 2))):
            damage(rng, inputs / rng.choice(files))
    before = _content(inputs)
    outcome = _run(command, arguments, folder)
    if outcome.kind in ("refused", "handled"):
        remaining = [str(path.relative_to(folder)) for path in out.rglob("*")]
        hidden = [name for name in remaining if Path(name).name.startswith(".")]
        others = [path.name for path in folder.iterdir() if path.name not in ("in", "out")]
        changed = [
            name for name, digest in _content(inputs).items() if before.get(name) != digest and name != "checkpoint"
        ]
        if (wrong := hidden + others + changed) or (outcome.kind == "refused" and (wrong := remaining)):
            return Outcome("left_behind", f"{arguments}: {wrong}")
    return outcome


def _content(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def _run(command: str, arguments: list[str], folder: Path) -> Outcome:
    call: Callable[[list[str]], int | None] = testbed if command == "testbed" else main
    output, errors = io.StringIO(), io.StringIO()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            code = call(arguments) or 0
    except SystemExit as ended:
        code = int(ended.code or 0)
    except MemoryError:
        return Outcome("memory", str(arguments))
    except BaseException as error:
        return Outcome("tracebacks", f"{arguments}: {error!r:.300}\n{traceback.format_exc()[-1500:]}")
    finally:
        os.chdir("/")
    if "out of memory" in errors.getvalue():
        return Outcome("memory", str(arguments))
    if code == 2 and errors.getvalue().strip() and "Traceback" not in errors.getvalue():
        return Outcome("refused")
    if code == 0:
        return Outcome("handled")
    return Outcome("tracebacks", f"{arguments}: exit code {code}, {errors.getvalue()[-500:]}")


# The process that is attacked, and the one that counts


def _work(seeds: list[int], valid: Path, answers: Connection) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MEMORY, used + MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for seed in seeds:
        with tempfile.TemporaryDirectory(prefix="hostile.") as folder:
            began = time.process_time()
            outcome = attempt(seed, valid, Path(folder))
            if time.process_time() - began > MOST_SECONDS:
                outcome = Outcome("hangs", f"{time.process_time() - began:.0f} s of processor time, then {outcome}")
        answers.send((seed, outcome))


def study(seeds: list[int], progress: Callable[[int, Outcome], None] | None = None) -> dict[str, Any]:
    """Runs the tries of these seeds; the counts of how they ended, and every failure with its seed."""
    counts = {"tries": len(seeds), "refused": 0, "handled": 0, **dict.fromkeys(FAILURES, 0)}
    failures = []
    remaining = list(seeds)
    context = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory(prefix="hostile.") as folder:
        maker = context.Process(target=prepare, args=(Path(folder),))  # MuJoCo's threads must not be forked
        maker.start()
        maker.join()
        if maker.exitcode:
            raise SystemExit("The valid files could not be made.")
        while remaining:
            here, there = context.Pipe(duplex=False)
            worker = context.Process(target=_work, args=(remaining, Path(folder), there))
            worker.start()
            there.close()
            alive = True
            while remaining and alive:
                seed, outcome, alive = _answer(worker, here, remaining[0])
                remaining.remove(seed)
                counts[outcome.kind] += 1
                if outcome.kind in FAILURES:
                    failures.append({"seed": seed, "kind": outcome.kind, "words": outcome.words})
                if progress:
                    progress(seed, outcome)
            worker.kill()
            worker.join()
    return {**counts, "failures": failures}


def _answer(worker: Any, here: Connection, seed: int) -> tuple[int, Outcome, bool]:
    """The next answer, and whether more will come; a failure of this seed where the process died or hangs."""
    began, used = time.monotonic(), _processor_time(worker.pid)
    while not here.poll(0.5):
        if _processor_time(worker.pid) - used > 2 * MOST_SECONDS or time.monotonic() - began > STUCK:
            worker.kill()
            worker.join()
            return seed, Outcome("hangs", "no answer"), False
    try:
        return (*here.recv(), True)
    except EOFError:
        worker.join(STUCK)
        return seed, Outcome("tracebacks", f"the process died with exit code {worker.exitcode}"), False


def _processor_time(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _tell(seed: int, outcome: Outcome) -> None:
    if outcome.kind in FAILURES:
        print(seed, outcome.kind, outcome.words, flush=True)


def command_line() -> None:
    """Parses, runs, writes the counts."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tries", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="of the first try; the others follow (default: 0)")
    parser.add_argument("--only", type=int, help="run the try of this seed alone")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of processor time, after which to stop")
    parser.add_argument("--json", type=Path, help="file for the counts and failures; replaced")
    given = parser.parse_args()
    seeds = [given.only] if given.only is not None else list(range(given.seed, given.seed + given.tries))
    total: dict[str, Any] = {}
    for at in range(0, len(seeds), 250):
        part = study(seeds[at : at + 250], _tell)
        total = {key: total[key] + value if total else value for key, value in part.items()}
        if given.json:
            given.json.write_text(json.dumps(total, indent=1) + "\n", encoding="utf-8")
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        if used.ru_utime + used.ru_stime > given.seconds:
            break
    print({key: value for key, value in total.items() if key != "failures"}, flush=True)


if __name__ == "__main__":
    command_line()
