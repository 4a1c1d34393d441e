# SPDX-License-Identifier: Apache-2.0
"""The notebook of an experimenter: Markdown with pictures, complete on disk after every entry."""

import os
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

from matplotlib.figure import Figure

from eps_tunnel_analysis.diagnose.falls import RECORDING_COLUMNS
from eps_tunnel_analysis.loop.experimenter import Added, Ending, Played, Step, Tested, heading
from eps_tunnel_analysis.loop.gap import RigFailed
from eps_tunnel_analysis.loop.reason import Reason
from eps_tunnel_analysis.outputs import shown_share, shown_value
from eps_tunnel_analysis.phases import sentences
from eps_tunnel_analysis.report.pictures import (
    gap_picture,
    hypotheses_picture,
    left_over_picture,
    save,
    staircase_picture,
)
from labyrinth_sim.whole_file import write_anew

NOTEBOOK_FILE = "notebook.md"
MOST_SENTENCES = 3  # sentences on where it fails


class Notebook:
    """notebook.md and its pictures in a folder."""

    def __init__(self, folder: Path, title: str, *lines: str) -> None:
        self._folder, self._count = folder, 0
        self._pages = [f"# {title}", *lines]
        self._write()

    @property
    def path(self) -> Path:
        """Of the Markdown file."""
        return self._folder / NOTEBOOK_FILE

    def entry(self, heading: str, *blocks: str) -> None:
        """A numbered entry with the time of day; the file is replaced at once."""
        self._count += 1
        now = datetime.now(UTC).strftime("%H:%M:%S UTC")
        self._pages += [f"## {self._count}. {heading}", f"*{now}*", *(block for block in blocks if block)]
        self._write()

    def picture(self, figure: Figure, name: str, text: str) -> str:
        """Saves a picture and returns the Markdown that shows it; `text` says what it shows."""
        file = f"{self._count + 1:02d}_{name}.png"
        save(figure, self._folder / file)
        return f"![{text}]({file})"

    def link(self, text: str, path: Path) -> str:
        """Markdown for a file, as seen from the notebook."""
        return f"[{text}]({Path(os.path.relpath(path, self._folder)).as_posix()})"

    def keep(self, steps: Iterable[Step], say: Callable[[str], None]) -> Ending:
        """Writes each step into the notebook as it comes, and prints it in one line; an interruption is written, too.

        Raises:
            KeyboardInterrupt, RigFailed, InputError: as the steps do.
        """
        try:
            for step in steps:
                self.entry(heading(step), *self._page(step))
                say(heading(step))
                if isinstance(step, Ending):
                    return step
                if isinstance(step, Played):
                    say("Diagnosing ...")
        except KeyboardInterrupt:
            self._early("Interrupted", "By Ctrl-C. Everything above is on disk.", say)
            raise
        except (RigFailed, ValueError) as error:
            self._early("The run ended early", str(error), say)
            raise
        raise RuntimeError("The steps ended without an ending.")

    def _early(self, heading: str, text: str, say: Callable[[str], None]) -> None:
        self.entry(heading, text)
        say(heading)

    def _page(self, step: Step) -> list[str]:
        match step:
            case Played():
                return gap_page(step, self)
            case Reason():
                return diagnosis_page(step, self)
            case Added():
                return addition_page(step, self)
            case Tested():
                return law_page(step, self)
            case Ending():
                return ending_page(step, self)

    def _write(self) -> None:
        write_anew(self.path, "\n\n".join(self._pages) + "\n")


def markdown_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown, words left and the other columns right."""
    lines = [list(columns), ["---", *["---:"] * (len(columns) - 1)], *map(list, rows)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def gap_page(played: Played, notebook: Notebook) -> list[str]:
    """Error and alikeness, where it fails, and a picture."""
    gap = played.gap
    c = gap.comparison
    errors = {e.signal: (shown_value(e.command_error, e.unit), shown_value(e.repeat_rms, e.unit)) for e in c.errors}
    rows = []
    for curve in c.curves:
        rows.append((curve.name, *errors.get(curve.name, ("", "")), *map(shown_share, curve.shares)))
        rows += [("the rig against itself", "", "", *map(shown_share, curve.itself))] if curve.itself else []
    columns = ("signal", "error E", "rig repeats within", *(f"alike, k = {a.k_real:g}" for a in c.alikeness))
    return [
        markdown_table(columns, rows),
        "\n".join(f"- {sentence}" for sentence in [*sentences(c.where)[:MOST_SENTENCES], *gap.notes]),
        notebook.picture(gap_picture(c), "gap", "simulation in the tunnel of the real trials"),
        notebook.link("report", played.report),
    ]


def diagnosis_page(reason: Reason, notebook: Notebook) -> list[str]:
    """Sentence, probabilities, remaining error, notes."""
    d, v = reason.diagnosis, reason.diagnosis.verdict
    floors = ", ".join(f"{axis}: {old**0.5:.1f} before, {new**0.5:.1f} after" for axis, (old, new) in v.floor.items())
    return [
        f"**{v.sentence}**",
        notebook.picture(hypotheses_picture(v), "hypotheses", "probabilities of the hypotheses"),
        notebook.picture(left_over_picture(d), "left_over", "simulation minus real"),
        f"Misfit in units of the noise floor, below which no model goes far: {floors}.",
        "\n".join(f"- {note}" for note in v.notes),
        f"{v.evaluations} roll-outs in {v.seconds:.0f} s, {notebook.link('report', reason.report)}",
    ]


def addition_page(added: Added, notebook: Notebook) -> list[str]:
    """Why it was added, what was fitted, and how much it helps, recording by recording."""
    addition = added.addition
    rows = [(name, f"{value:.5g}") for name, value in addition.values.items()]
    return [
        added.why,
        markdown_table(("parameter", "value"), rows),
        " ".join(addition.sentences),
        markdown_table(RECORDING_COLUMNS, [one.row for one in addition.recordings]),
        f"Loaded into the simulation: {notebook.link(added.file.name, added.file)}",
    ]


def law_page(tested: Tested, notebook: Notebook) -> list[str]:
    """The proposed law, its test on another command, and its files."""
    folder = tested.reason.folder
    files = [folder / name for name in ("proposed_effect.py", "proposed_model.yaml")]
    links = ", ".join(notebook.link(file.name, file) for file in files if file.exists())
    return [f"**{tested.proposal.sentence}**", f"Its files: {links}" if links else ""]


def ending_page(ending: Ending, notebook: Notebook) -> list[str]:
    """Verdict, staircase, and, if no known effect explains the remaining error, a picture of it."""
    unit = ending.last.recorded.model.rig.position_unit
    rows = [(s.step, shown_value(s.error, unit), *map(shown_share, (s.alikeness, s.itself))) for s in ending.steps]
    stairs = staircase_picture([(s.step, s.error) for s in ending.steps], ending.steps[-1].repeats, unit)
    blocks = [
        f"**{ending.sentence}**",
        markdown_table(("model", "error E", "alike in every signal, k = 1", "rig against itself"), rows),
        notebook.picture(stairs, "staircase", "error after each step"),
    ]
    diagnosis = ending.last.diagnosis
    if diagnosis.verdict.verdict == "unknown":
        picture = left_over_picture(diagnosis, alone=True)
        blocks.append(notebook.picture(picture, "unknown", "what no known effect explains"))
    return [*blocks, f"The model, running in the simulation: {notebook.link(ending.model.name, ending.model)}"]
