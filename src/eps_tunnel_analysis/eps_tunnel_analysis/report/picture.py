# SPDX-License-Identifier: Apache-2.0
"""A picture that a notebook shows and that can be saved."""

import io
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from eps_tunnel_analysis.report.pictures import DPI, STYLE
from labyrinth_sim.errors import InputError
from labyrinth_sim.whole_file import beside

SUFFIXES = (".svg", ".png", ".pdf")


@dataclass(frozen=True)
class Picture:
    """A drawing as SVG, and the figure that it was drawn from."""

    svg: str = field(repr=False)
    figure: Figure = field(repr=False, compare=False)

    @classmethod
    def of(cls, figure: Figure) -> "Picture":
        text = io.StringIO()
        with mpl.rc_context(STYLE):
            figure.savefig(text, format="svg", metadata={"Date": None})
        drawing = text.getvalue()
        return cls(drawing[drawing.index("<svg") :], figure)  # without the XML declaration, so that it goes into HTML

    def _repr_svg_(self) -> str:
        return self.svg

    def save(self, path: str | Path) -> Path:
        """Writes .svg, .png or .pdf; a picture of that name is replaced.

        Raises:
            InputError: another suffix, or the file cannot be written.
        """
        file = Path(path)
        if file.suffix not in SUFFIXES:
            raise InputError(f"{file}: expected a name that ends in {', '.join(SUFFIXES)}.")
        try:
            with mpl.rc_context(STYLE), beside(file) as partial:
                self.figure.savefig(partial, dpi=DPI, metadata={"Date": None} if file.suffix == ".svg" else None)
                partial.replace(file)
        except OSError as error:
            raise InputError(f"{file}: cannot be written ({error.strerror}).") from error
        return file
