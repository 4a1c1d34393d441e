# SPDX-License-Identifier: Apache-2.0
"""From the names of bags and a model to trials and plays."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np

from eps_tunnel_analysis.check.data import check_data, sentences
from eps_tunnel_analysis.outputs import shown_number
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.recording import (
    Recording,
    TimeSource,
    TrialsResult,
    guessed_map,
    read_all,
    to_plays,
    to_trials,
)
from eps_tunnel_analysis.recording.bag import BAG_SUFFIXES, ROS2_SUFFIXES
from eps_tunnel_analysis.recording.channel_map import channel_map, held_by_all, namespace_of
from eps_tunnel_analysis.recording.trials import MAX_GAP, RATE, PlaysResult
from eps_tunnel_analysis.simulated import roll_out
from eps_tunnel_analysis.valid import beyond
from labyrinth_sim.errors import Complaints, InputError
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.rig import Rig, load_rig
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Trials
from labyrinth_sim.yaml_file import read_yaml

POSITIONS = ("rad", "m")  # units of the signals compared unless some are named
KNOWN_FILE = "known.yaml"
KNOWN_ABOVE = 3  # folders above a bag in which such a file counts, too
DEEPEST_BAG = 6  # folders within a folder that is named, in which bags are looked for
HELD_OUT_SHARE = 0.2
"""held out by default, rounded down: nothing of fewer than five commands"""


@dataclass(frozen=True)
class Reading:
    """How bags are read.

    Attributes:
        rig: name or file; None for the model's, or all that the bags offer.
        signals: which to take; None for every position.
        time_source: the clock to trust.
        rate: Hz of the common grid; None for the rig's own, or RATE without a rig.
        max_gap: s, longest pause that is bridged by a straight line.
        cut_to_shortest: cut trials of different length instead of refusing them.
    """

    rig: str | None = None
    signals: tuple[str, ...] | None = None
    time_source: TimeSource = "header"
    rate: float | None = None
    max_gap: float = MAX_GAP
    cut_to_shortest: bool = False

    def load_rig(self, model: Model | None) -> Rig | None:
        """The rig that is named, else the model's."""
        if self.rig:
            return load_rig(self.rig)
        return model.rig if model else None

    def options(self, recordings: Sequence[Recording], rig: Rig | None, efforts: bool = False) -> dict[str, Any]:
        """What `to_trials` and `to_plays` are given.

        Args:
            efforts: read the rig's efforts too where all recordings have them, and the ball only where all have it.
        """
        names: Sequence[str] | None = self.signals
        if names is None and rig is not None and efforts:
            names = held_by_all(rig, recordings)
        elif names is None and rig is not None:
            positions = [n for n, unit in zip(rig.signals, rig.units, strict=True) if unit in POSITIONS]
            names = _recorded(positions, rig, recordings)
        elif names is None:
            first = recordings[0]
            # A camera that is not there leaves a topic without messages.
            offered = [source for source in guessed_map(first).signals if len(first.topics[source.topic])]
            names = [source.name for source in offered if source.unit in POSITIONS] or None
        return {
            "signals": names,
            "rate": self.rate or (rig.rate if rig else RATE),
            "max_gap": self.max_gap,
            "cut_to_shortest": self.cut_to_shortest,
        }


@shown
@dataclass(frozen=True)
class Sides:
    """Real and simulated trials, the model if there was one, what was read, as pairs of name and value, notes, and
    findings on the real recordings, a sentence each."""

    real: Trials
    sim: Trials
    model: Model | None
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    checked: tuple[str, ...] = ()


@shown
@dataclass(frozen=True)
class Recorded:
    """A model, the plays to compare it with, and where these came from.

    Attributes:
        bags: path and SHA-256 of each bag.
        hashes: of the sequences, one for each play, "" where the bag has none.
        held: plays that are only judged.
        held_hashes: of their sequences.
        files: the bags of each play.
        known: what was set differently in some bags, as the user said it, PATTERN:NAME=VALUE.
    """

    model: Model
    plays: tuple[Play, ...]
    hashes: tuple[str, ...]
    bags: tuple[tuple[Path, str], ...]
    notes: tuple[str, ...]
    held: tuple[Play, ...] = ()
    held_hashes: tuple[str, ...] = ()
    files: tuple[tuple[Path, ...], ...] = ()
    known: tuple[str, ...] = ()


def load_sides(
    real: Sequence[Path],
    sim: Sequence[Path] | None = None,
    model: str | Path | Model | None = None,
    effects: Path | None = None,
    reading: Reading | None = None,
    known: Sequence[str] = (),
) -> Sides:
    """Reads both sides of a comparison.

    Args:
        real, sim: bags, or folders of bags; without `sim` the model is played with the real commands.
        model: itself, or its name or file.
        effects: folder with effect files of the user.
        known: what was set differently in some bags, as PATTERN:NAME=VALUE.

    Raises:
        InputError: everything wrong with the bags, the rig and the model, at once.
    """
    reading = reading or Reading()
    complaints = Complaints()
    attempt = complaints.attempt
    loaded = attempt(lambda: model_of(model, effects)) if model else None
    rig = attempt(lambda: reading.load_rig(loaded))
    real_bags = attempt(lambda: bags(real))
    settings = attempt(lambda: known_of(real_bags, known)) if real_bags is not None else None
    attempt(lambda: _refuse_other_settings(settings or {}))
    real_read = attempt(lambda: _read(real_bags, rig, reading)) if real_bags is not None else None
    sim_bags = attempt(lambda: bags(sim)) if sim else None
    sim_read = attempt(lambda: _read(sim_bags, rig, reading)) if sim_bags else None
    complaints.check()
    assert real_read is not None and real_bags is not None
    notes = (*real_read.report.notes, *(sim_read.report.notes if sim_read else ()))
    checked = sentences(check_data(loaded, [Play("", real_read.trials, stamped=real_read.stamped)], efforts=False))
    if sim_read is not None:
        _refuse_other_sequence(real_read, sim_read)
    facts = _bag_facts("real", real_bags, real_read)
    if sim_read is not None and sim_bags is not None:
        facts += _bag_facts("simulation", sim_bags, sim_read)
        sim_trials = sim_read.trials
    else:
        assert loaded is not None
        values = next(iter((settings or {}).values()), {})
        play = Play("", real_read.trials, values, stamped=real_read.stamped)
        loaded, scale_notes = with_effort_scales(loaded, [play])
        notes += (*unstated_notes(loaded), *scale_notes)
        sim_trials = roll_out(loaded, play)
        notes += beyond(loaded, real_read.trials, sim_trials)
        facts += [("known of these bags", ", ".join(f"{n} {v:g}" for n, v in values.items()))] if values else []
        shared = [name for name in sim_trials.signals if name in real_read.trials.signals]
        sim_trials = sim_trials.select(shared) if shared else sim_trials
        facts += _model_facts(loaded)
        if sim_trials.count > 1:
            facts.append(("simulation", "rolled out for each trial, whose commands differ"))
    samples, step = len(real_read.trials.time), real_read.trials.step
    facts += [
        ("time source", f"{reading.time_source} time"),
        ("sampling", f"{1 / step if step else 0:g} Hz, {samples} samples, gaps up to {reading.max_gap:g} s bridged"),
    ]
    return Sides(real_read.trials, sim_trials, loaded, tuple(facts), tuple(dict.fromkeys(notes)), tuple(checked))


def load_recorded(
    model: str | Path | Model,
    real: Sequence[Path],
    reading: Reading | None = None,
    *,
    effects: Path | None = None,
    known: Sequence[str] = (),
    timing: float = 0.0,
    held_out: Sequence[Path] = (),
    efforts: bool = False,
) -> Recorded:
    """Reads a model and the plays to compare it with.

    Args:
        model: itself, or its name or file.
        real: bags, or folders of bags.
        effects: folder with effect files of the user.
        known: what was set differently in some bags, as PATTERN:NAME=VALUE.
        timing: s, uneven timing within trials that the rig is known to have.
        held_out: bags that are never fitted, only judged.
        efforts: read the efforts and the ball too, where all bags have them.

    Raises:
        InputError: everything wrong with either, at once.
    """
    reading = reading or Reading()
    complaints = Complaints()
    attempt = complaints.attempt
    loaded = attempt(lambda: model_of(model, effects))
    rig = attempt(lambda: reading.load_rig(loaded))
    paths = attempt(lambda: bags(real))
    held_paths = attempt(lambda: bags(held_out))
    rules = attempt(lambda: known_of([*(paths or []), *(held_paths or [])], known))
    read = held = None
    if rules is not None:
        read = attempt(lambda: _plays(paths, rig, reading, rules, timing, efforts)) if paths is not None else None
        held = attempt(lambda: _plays(held_paths, rig, reading, rules, timing, efforts)) if held_paths else None
    complaints.check()
    assert loaded is not None and read is not None and paths is not None
    loaded, scale_notes = with_effort_scales(loaded, read.plays)
    return Recorded(
        loaded,
        read.plays,
        tuple(r.sequence_hash for r in read.results),
        tuple((path, bag_hash(path)) for path in (*paths, *(held_paths or []))),
        tuple(dict.fromkeys((*read.notes, *(held.notes if held else ()), *unstated_notes(loaded), *scale_notes))),
        held.plays if held else (),
        tuple(r.sequence_hash for r in held.results) if held else (),
        tuple(r.bags for r in read.results),
        tuple(known),
    )


def model_of(model: str | Path | Model, effects: Path | None = None) -> Model:
    """A model by name or file; one that is loaded is itself. Raises InputError: as `load_model`."""
    return model if isinstance(model, Model) else load_model(model, effects)


def hold_out(plays: Sequence[Play], amount: float | None, seed: int) -> tuple[int, ...]:
    """Numbers of the plays to hold out, drawn at random.

    Whole commands, never single trials: trials of one command repeat each other but for noise, so a model that was
    fitted to some of them has as good as seen the others.

    Args:
        amount: a number of plays if 1 or more, a share of them if below 1, rounded to at least one; None for SHARE.

    Raises:
        InputError: it would leave no play to fit.
    """
    count = len(plays)
    number = int(HELD_OUT_SHARE * count) if amount is None else int(amount) if amount >= 1 else round(amount * count)
    if amount is not None and 0.0 < amount < 1.0:
        number = max(number, 1)
    if number >= count:
        raise InputError(
            f"Cannot hold out {number} of {count} commands ({', '.join(p.name for p in plays)}): at least one must "
            "be left to fit. Record more commands, or hold out none (0)."
        )
    return tuple(sorted(int(i) for i in np.random.default_rng([seed, 1]).choice(count, number, replace=False)))


def held_apart(recorded: Recorded, amount: float | None, seed: int) -> tuple[Recorded, tuple[int, ...]]:
    """Recordings with those held out by name among the plays, and the numbers of all plays that are held out.

    Args:
        amount: as in `hold_out`; None draws none where some are held out by name.

    Raises:
        InputError: no play would be left to fit.
    """
    named = tuple(range(len(recorded.plays), len(recorded.plays) + len(recorded.held)))
    drawn = () if named and amount is None else hold_out(recorded.plays, amount, seed)
    both = replace(recorded, plays=(*recorded.plays, *recorded.held), hashes=(*recorded.hashes, *recorded.held_hashes))
    return both, (*drawn, *named)


def bags(paths: Sequence[Path]) -> list[Path]:
    """The bags that the paths stand for: a folder that is no bag stands for those in it and in its folders."""
    found_bags: list[Path] = []
    for path in paths:
        found_bags += _bags_in(path) or [path]
    twice = sorted({str(p) for p in found_bags if found_bags.count(p) > 1})
    if twice:
        raise InputError([f"{p}: named twice; each bag counts as one trial." for p in twice])
    return found_bags


def _bags_in(path: Path, depth: int = 0) -> list[Path]:
    if _is_bag(path):
        return [path]
    if not path.is_dir() or depth > DEEPEST_BAG:
        return []
    return [bag for inside in sorted(path.iterdir()) for bag in _bags_in(inside, depth + 1)]


def bag_hash(bag: Path) -> str:
    """SHA-256 over a bag's data files."""
    files = sorted(p for p in bag.rglob("*") if p.suffix in BAG_SUFFIXES) if bag.is_dir() else [bag]
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _is_bag(path: Path) -> bool:
    if path.is_file():
        return path.suffix in BAG_SUFFIXES
    return path.is_dir() and (
        (path / "metadata.yaml").exists() or any(p.suffix in ROS2_SUFFIXES for p in path.iterdir())
    )


def _read(paths: Sequence[Path], rig: Rig | None, reading: Reading) -> TrialsResult:
    recordings = read_all(paths, reading.time_source)
    options = reading.options(recordings, rig)
    try:
        return to_trials(recordings, rig, **options)
    except InputError as error:
        raise InputError([*error.complaints, *_several_commands(recordings, rig, options)]) from error


def _several_commands(recordings: Sequence[Recording], rig: Rig | None, options: Mapping[str, Any]) -> list[str]:
    """What to name instead if bags of several commands were named; nothing if they hold one command."""
    try:
        results = to_plays(recordings, rig, **options).results
    except InputError:
        return []
    if len(results) < 2 or sum(len(r.bags) for r in results) != len(recordings):
        return []
    groups = "; ".join(f"{i}: {', '.join(map(str, r.bags))}" for i, r in enumerate(results, 1))
    return [
        f"These bags hold {len(results)} commands, and only trials of one can be compared. Name those of one after "
        f"--real: {groups}."
    ]


def _refuse_other_sequence(real: TrialsResult, sim: TrialsResult) -> None:
    if real.sequence_hash and sim.sequence_hash and real.sequence_hash != sim.sequence_hash:
        raise InputError(
            f"The two sides played different sequences: real '{real.sequence}' ({real.sequence_hash[:12]}), simulation "
            f"'{sim.sequence}' ({sim.sequence_hash[:12]}). Compare bags of the same sequence."
        )


def _recorded(names: list[str], rig: Rig, recordings: Sequence[Recording]) -> list[str]:
    """Those signals of a rig that some recording holds messages of, as of a ball it may not; all where it has none."""
    maps = [(r, channel_map(rig, namespace_of(r))) for r in recordings]
    there = {
        source.name
        for r, channels in maps
        for source in channels.signals
        if source.topic in r.topics and len(r.topics[source.topic])
    }
    return [name for name in names if name in there] or names


def _bag_facts(side: str, paths: Sequence[Path], result: TrialsResult) -> list[tuple[str, str]]:
    facts = [(f"{side}, {result.trials.count} trial{'s' * (result.trials.count > 1)}", "")]
    facts += [(f"{side} bag", f"{path} (SHA-256 {bag_hash(path)[:12]})") for path in paths]
    if result.sequence:
        facts.append((f"{side} sequence", f"{result.sequence} ({result.sequence_hash[:12]})"))
    gaps = result.report.gaps
    listed = [f"trial {t + 1} {s}: {length:.2f} s at {start:.2f} s" for t, s, start, length in gaps[:5]]
    more = f"; {len(gaps) - 5} more" if len(gaps) > 5 else ""
    facts.append((f"{side} gaps", "; ".join(listed) + more if gaps else "none"))
    return facts[1:] if len(paths) == result.trials.count else [(facts[0][0], "marked in the bag"), *facts[1:]]


def _model_facts(model: Model) -> list[tuple[str, str]]:
    effects = ", ".join(f"{use.effect.name} ({use.place})" for use in model.effects)
    facts = [("model", f"{model.name}, rig {model.rig.name}"), ("effects in the model", effects or "none")]
    if model.path is not None:
        facts.append(
            ("model file", f"{model.path} (SHA-256 {hashlib.sha256(model.path.read_bytes()).hexdigest()[:12]})")
        )
    return facts


def known_of(paths: Sequence[Path], rules: Sequence[str]) -> dict[Path, dict[str, float]]:
    """What is known of each bag: from the `known.yaml` in its folder or beside it, as `drive.x.kp: 100`, and by rules,
    which count before files; a file nearer to the bag counts before one further up.

    Raises:
        InputError: files and rules that cannot be read, rules that no bag matches.
    """
    complaints: list[str] = []
    known: dict[Path, dict[str, float]] = {path: {} for path in paths}
    for path in paths:
        try:
            known[path] = _known_beside(path)
        except InputError as error:
            complaints += error.complaints
    for rule in rules:
        pattern, _, setting = rule.partition(":")
        name, _, text = setting.partition("=")
        try:
            value = float(text)
        except ValueError:
            complaints.append(f"--known {rule}: expected PATTERN:NAME=NUMBER, as '*kp_100*:drive.x.kp=100'.")
            continue
        matching = [path for path in paths if fnmatch(str(path), pattern)]
        if not matching:
            complaints.append(f"--known {rule}: no bag's path matches '{pattern}'. Bags: {', '.join(map(str, paths))}.")
        for path in matching:
            known[path][name] = value
    if complaints:
        raise InputError(dict.fromkeys(complaints))
    return known


def _known_beside(bag: Path) -> dict[str, float]:
    folders = [bag, *bag.resolve().parents[:KNOWN_ABOVE]]
    known: dict[str, float] = {}
    for file in (folder / KNOWN_FILE for folder in reversed(folders)):
        if file.is_file():
            document = read_yaml(file)
            for name, value in document.mapping(()).items():
                if isinstance(value, bool) or not isinstance(value, int | float):
                    document.complain((name,), "expected a number, as 'drive.x.kp: 100'.")
                else:
                    known[name] = float(value)
            document.check()
    return known


def _refuse_other_settings(known: Mapping[Path, Mapping[str, float]]) -> None:
    if len({tuple(sorted(values.items())) for values in known.values()}) > 1:
        settings = [
            f"{bag}: {', '.join(f'{n} {v:g}' for n, v in sorted(k.items())) or 'nothing'}" for bag, k in known.items()
        ]
        raise InputError(
            "Different values are known of these bags, so they are no trials of one command: "
            f"{'; '.join(settings)}. Compare them separately."
        )


def unstated_notes(model: Model) -> tuple[str, ...]:
    """One sentence with every default that holds because the model says nothing; none where it states all."""
    defaults = [
        f"{info.name} {shown_number(info.value, 4)} {info.unit}".removesuffix(" 1") for info in model.unstated()
    ]
    return (f"Not stated by model '{model.name}', so defaults apply: {', '.join(defaults)}.",) if defaults else ()


def with_effort_scales(model: Model, plays: Sequence[Play]) -> tuple[Model, tuple[str, ...]]:
    """The model with a first guess for each effort factor that is not stated, and a sentence on each.

    The factor is that of the least squares between the effort that the model gives under the recorded commands and the
    one that was recorded; a fit goes on from there.
    """
    wanted = [name for name in model.open_scales if all(name.split(".")[1] in p.trials.signals for p in plays)]
    if not wanted:
        return model, ()
    products = {name: np.zeros(2) for name in wanted}
    for play in plays:
        try:
            simulated = roll_out(model, play)
        except InputError:  # diverged: whoever asks for this model hears of it
            continue
        for name in wanted:
            signal = name.split(".")[1]
            ours = simulated.values[:, :, simulated.index(signal)]
            theirs = play.trials.values[:, :, play.trials.index(signal)]
            ours = np.broadcast_to(ours, theirs.shape) if len(ours) == 1 else ours
            both = np.isfinite(ours) & np.isfinite(theirs)
            products[name] += [theirs[both] @ theirs[both], ours[both] @ theirs[both]]
    scales = {name: float(p[1] / p[0]) for name, p in products.items() if p[0] > 0.0 and p[1] != 0.0}
    guessed = model.with_scales(scales, "guessed from the recordings")
    infos = guessed.parameters()
    notes = tuple(
        f"{name} is not stated: {shown_number(value)} {infos[name].unit} guessed from the recordings. State it in "
        "the rig file if you know it."
        + (
            " It is negative: reverse the effort's sign, or add what uses up the effort, such as friction."
            * (value < 0)
        )
        for name, value in scales.items()
    )
    return guessed, notes


def _plays(
    paths: Sequence[Path],
    rig: Rig | None,
    reading: Reading,
    known: Mapping[Path, Mapping[str, float]],
    timing: float,
    efforts: bool,
) -> PlaysResult:
    """The plays of bags; the same command under other known values is another play."""
    recordings = read_all(paths, reading.time_source)
    options = reading.options(recordings, rig, efforts)
    groups: dict[tuple[tuple[str, float], ...], list[Recording]] = {}
    for path, recording in zip(paths, recordings, strict=True):
        groups.setdefault(tuple(sorted(known[path].items())), []).append(recording)
    plays: list[Play] = []
    results: list[TrialsResult] = []
    notes: list[str] = []
    for values, group in groups.items():
        grouped = to_plays(group, rig, **options)
        words = ", ".join(f"{name} {value:g}" for name, value in values)
        plays += [
            replace(p, name=f"{p.name}, {words}" if words else p.name, known=dict(values), timing=timing)
            for p in grouped.plays
        ]
        results += grouped.results
        notes += grouped.notes
    return PlaysResult(tuple(plays), tuple(results), tuple(dict.fromkeys(notes)))
