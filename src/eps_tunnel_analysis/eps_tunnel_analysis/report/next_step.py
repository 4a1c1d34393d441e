# SPDX-License-Identifier: Apache-2.0
"""What to do next, as a sentence and a command to copy: after a check, a comparison, an addition, and each verdict."""

import shlex
from collections import Counter
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.inputs import bags

if TYPE_CHECKING:
    from eps_tunnel_analysis.compare import Comparison
    from eps_tunnel_analysis.diagnose.axes import Diagnosis
    from eps_tunnel_analysis.inputs import Recorded
    from eps_tunnel_analysis.law.proposal import Proposal

MODEL_FILE = "model.yaml"


def after_comparison(
    comparison: "Comparison", real: Sequence[Path], model: str | None, own: Path | None, known: Sequence[str] = ()
) -> tuple[str, str]:
    """What to do after a comparison: a sentence and a command, "" where there is none.

    Args:
        real, model: as the user named them; without a model recordings of a simulation were compared.
        own: folder of the user's effects.
        known: what was set differently in some bags, as PATTERN:NAME=VALUE.
    """
    errors = [e for e in comparison.errors if e.samples]
    if errors and all(e.repeat_rms > 0 and e.rms <= e.repeat_rms for e in errors):
        return "Nothing is left to do: the simulation's error is within the rig's own repeatability.", ""
    words = [*_reading(real, own, known), "--model", model or "MODEL", "--out", "why"]
    said = "Next: find out which physical effect the model lacks." + (
        "" if model else " MODEL is the one that was simulated."
    )
    return said, shlex.join(["eps-tunnel", "diagnose", *words])


def after_check(
    serious: bool, real: Sequence[Path], model: str, own: Path | None, known: Sequence[str] = ()
) -> tuple[str, str]:
    """What to do after a check of recordings: a sentence and a command.

    Args:
        serious: whether something in them should be fixed first.
        real, model: as the user named them.
        own, known: as in `after_comparison`.
    """
    said = "Next: find out which physical effect the model lacks."
    if serious:
        said = "Next: deal with the lines that begin with !, and record again where they say so. Then diagnose:"
    return said, shlex.join(["eps-tunnel", "diagnose", *_reading(real, own, known), "--model", model, "--out", "why"])


def after_addition(recorded: "Recorded", real: Sequence[Path], model: Path) -> tuple[str, str]:
    """What to do after effects were added into the file `model`: a sentence and a command."""
    return "Next: check that the gap is closed.", compare_with(recorded, real, str(model), f"{model.stem}-gap")


def compare_with(
    recorded: "Recorded", real: Sequence[Path], model: str, out: str = "", effects: Path | None = None
) -> str:
    """The command that compares a model with what was recorded.

    Only trials of one command under one setting can be compared; of several, the first is taken.

    Args:
        real: as the user named them.
        out: folder for the report; "" for none.
        effects: folder of the effects that the model needs; None for the one they were read with.
    """
    chosen = real
    if len(recorded.files) > 1:
        count = Counter(bag for files in recorded.files for bag in files)
        chosen = next((files for files in recorded.files if all(count[bag] == 1 for bag in files)), real)
    words = _reading(chosen, effects or recorded.model.registry.folder, _settings(recorded, chosen))
    return shlex.join(["eps-tunnel", "compare", *words, "--model", model, *(["--out", out] if out else [])])


def play_command(file: Path) -> str:
    """The command that turns a sequence file into the commands to be played."""
    return shlex.join(["eps-tunnel", "sequences", str(file), "--csv", "next.csv"])


def next_commands(
    effects: Sequence[str], recorded: "Recorded", real: Sequence[Path], model: str, out: Path
) -> tuple[str, str]:
    """After a diagnosis into `out`: the command that compares its model, and the one that adds effects by choice."""
    reading = _reading(real, recorded.model.registry.folder, _settings(recorded, real))
    add = ["add-effect", *effects, *reading, "--model", model, "--out", f"{Path(model).stem}_more.yaml"]
    compare = compare_with(recorded, real, str(out / MODEL_FILE), f"{out.name}-gap")
    return compare, shlex.join(["eps-tunnel", *add])


def next_step(
    diagnosis: "Diagnosis", recorded: "Recorded", real: Sequence[Path], model: str, out: Path,
    proposal: "Proposal | None" = None,
) -> tuple[str, str]:  # fmt: skip
    """What to do after a diagnosis into `out`: a sentence and a command, "" where there is none."""
    v, own = diagnosis.verdict, recorded.model.registry.folder
    compare, _ = next_commands(v.effects, recorded, real, model, out)
    if v.verdict == "effect":
        return f"Next: check that the gap is closed. {out / MODEL_FILE} has the missing effect, fitted.", compare
    if v.verdict == "complete":
        return f"Next: check the remaining error. {out / MODEL_FILE} has the values refitted.", compare
    if v.verdict == "undecided" and diagnosis.experiment:
        file = out / "next_experiment.yaml"
        said = f"Next: play {file}, record it, and diagnose these recordings and the new ones together. Its commands:"
        return said, play_command(file)
    if proposal is not None and proposal.model:
        law = compare_with(recorded, real, str(out / "proposed_model.yaml"), effects=out)
        return "Next: check how far the proposed law closes the gap.", law
    reading = _reading(real, own or Path("EFFECTS"), _settings(recorded, real))
    again = shlex.join(["eps-tunnel", "diagnose", *reading, "--model", model, "--out", f"{out.name}-again"])
    if own:
        return "Next: record a command that excites it more, or try another effect of your own:", again
    return (
        "Next: record a command that excites it more, or write your guess as an effect file in a folder EFFECTS:",
        again,
    )


def _settings(recorded: "Recorded", real: Sequence[Path]) -> list[str]:
    """The --known rules that match some of these bags."""
    paths = bags(real)
    return [rule for rule in recorded.known if any(fnmatch(str(path), rule.partition(":")[0]) for path in paths)]


def _reading(real: Sequence[Path], own: Path | None, known: Sequence[str]) -> list[str]:
    """The words of a command that reads these bags, with the user's own effects and the --known rules."""
    words = ["--real", *map(str, real), *(["--effects", str(own)] if own else [])]
    return [*words, *(["--known", *known] if known else [])]
