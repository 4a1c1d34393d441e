# SPDX-License-Identifier: Apache-2.0
"""What to do next, as a sentence and a command to copy: after a comparison, and after each verdict."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from labyrinth_sim.registry import Registry

if TYPE_CHECKING:
    from eps_tunnel_analysis.compare import Comparison
    from eps_tunnel_analysis.diagnose.diagnose import Diagnosis
    from eps_tunnel_analysis.law.proposal import Proposal

MODEL_FILE = "model.yaml"


def after_comparison(
    comparison: "Comparison", real: Sequence[Path], model: str | None, own: Path | None
) -> tuple[str, str]:
    """What to do after a comparison: a sentence and a command, "" where there is none.

    Args:
        real, model: as the user named them; without a model recordings of a simulation were compared.
        own: folder of the user's effects.
    """
    errors = [e for e in comparison.errors if e.samples]
    if errors and all(e.repeat_rms > 0 and e.rms <= e.repeat_rms for e in errors):
        return "Nothing is left to do: the simulation is off by no more than the rig itself repeats.", ""
    words = [*_reading(real, own), "--model", model or "MODEL", "--out", "why"]
    said = "Next: which physical effect the model lacks." + ("" if model else " MODEL is the one that was simulated.")
    return said, shlex.join(["eps-tunnel", "diagnose", *words])


def compare_with(real: Sequence[Path], model: str, own: Path | None) -> str:
    """The command that compares a model with these bags."""
    return shlex.join(["eps-tunnel", "compare", *_reading(real, own), "--model", model])


def next_commands(
    effects: Sequence[str], real: Sequence[Path], model: str, out: Path, registry: Registry
) -> tuple[str, str]:
    """After a diagnosis into `out`: the command that compares its model, and the one that adds effects by choice."""
    reading = _reading(real, registry.folder)
    compare = ["compare", *reading, "--model", str(out / MODEL_FILE), "--out", f"{out.name}-gap"]
    add = ["add-effect", *effects, *reading, "--model", model, "--out", f"{Path(model).stem}_more.yaml"]
    return shlex.join(["eps-tunnel", *compare]), shlex.join(["eps-tunnel", *add])


def next_step(
    diagnosis: "Diagnosis", real: Sequence[Path], model: str, out: Path, proposal: "Proposal | None" = None
) -> tuple[str, str]:
    """What to do after a diagnosis into `out`: a sentence and a command, "" where there is none."""
    v, own = diagnosis.verdict, diagnosis.model.registry.folder
    compare, _ = next_commands(v.effects, real, model, out, diagnosis.model.registry)
    if v.verdict == "effect":
        return f"Next: see the gap closed. {out / MODEL_FILE} has what is missing, fitted.", compare
    if v.verdict == "complete":
        return f"Next: see what is left. {out / MODEL_FILE} has the values refitted.", compare
    if v.verdict == "undecided" and diagnosis.experiment:
        file = out / "next_experiment.yaml"
        said = f"Next: play {file}, record it, and diagnose these recordings and the new ones together. Its commands:"
        return said, shlex.join(["eps-tunnel", "sequences", str(file), "--csv", "next.csv"])
    if proposal is not None and proposal.model:
        words = ["--real", *map(str, real), "--effects", str(out), "--model", str(out / "proposed_model.yaml")]
        return "Next: see what the proposed law makes of the gap.", shlex.join(["eps-tunnel", "compare", *words])
    again = shlex.join(
        [
            "eps-tunnel",
            "diagnose",
            *_reading(real, own or Path("EFFECTS")),
            "--model",
            model,
            "--out",
            f"{out.name}-again",
        ]
    )
    if own:
        return "Next: record what excites it more, or try another effect of your own:", again
    return "Next: record what excites it more, or write what it may be as an effect file into a folder EFFECTS:", again


def _reading(real: Sequence[Path], own: Path | None) -> list[str]:
    """The words of a command that reads these bags, with effects of the user's own."""
    return ["--real", *map(str, real), *(["--effects", str(own)] if own else [])]
