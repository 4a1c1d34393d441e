# SPDX-License-Identifier: Apache-2.0
"""Reports as a browser lays them out: nothing is cut off, on a desk's screen or a telephone's."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from browser import browser, chromium

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.report.reports import compare_report
from labyrinth_sim.trials import Trials

CUT_OFF = """[...document.querySelectorAll("body *")].filter((e) => e.getBoundingClientRect().right > innerWidth + 1 ||
    (e.matches(".scroll") && e.scrollWidth > e.clientWidth + 1)).map((e) => `${e.tagName}.${e.className}`)"""


def page(spread: float = 1e-4) -> str:
    """A comparison that fails in phases of long names, on signals of long names; its next command is long, too.

    Args:
        spread: rad, by which trials differ.
    """
    time = np.arange(1200) * 0.01
    command = 0.1 * np.round(np.sin(2.0 * time)) * (time > 2.0) + 0.05 * np.sin(7.0 * time) * (time > 8.0)
    noise = np.random.default_rng(2).normal(0.0, spread, (3, 1200, 2))
    real = Trials(
        time=time, signals=("shoulder_left", "elbow_left"), units=("rad", "rad"),
        values=noise + command[None, :, None], command_channels=("shoulder_left", "elbow_left"),
        commands=np.repeat(np.stack([command, command[::-1]], axis=1)[None], 3, axis=0),
    )  # fmt: skip
    wrong = replace(real, values=0.9 * real.values[:1] - 0.012, commands=real.commands[:1])
    step = ("Next.", "eps-tunnel diagnose --real " + " ".join(f"bags/left_arm_{i}" for i in range(12)) + " --out why")
    return compare_report(compare(real, wrong), "arm", [("real", "bags/left_arm_0")], step)


def test_nothing_is_cut_off_on_any_screen(tmp_path: Path) -> None:
    program = chromium()
    if program is None:
        pytest.skip("needs Chromium or Chrome; name it by $CHROMIUM")
    (tmp_path / "report.html").write_text(page(), encoding="utf-8")
    with browser(program, tmp_path) as shown:
        for width in (1200, 820, 390):
            shown.look(width, 900, dark=False)
            shown.open((tmp_path / "report.html").as_uri())
            shown.until("document.readyState == 'complete' && document.querySelector('canvas') !== null")
            shown.evaluate("document.querySelectorAll('details').forEach((e) => { e.open = true; })")
            assert "after moving downwards" in shown.evaluate("document.body.innerText")
            assert shown.evaluate(CUT_OFF) == [], width
        assert not shown.troubles


def test_the_legend_reads_from_the_lower_edge_to_the_upper(tmp_path: Path) -> None:
    program = chromium()
    if program is None:
        pytest.skip("needs Chromium or Chrome; name it by $CHROMIUM")
    (tmp_path / "report.html").write_text(page(0.01), encoding="utf-8")
    chart = "document.querySelectorAll('.pair .uplot')[1]"
    with browser(program, tmp_path) as shown:
        shown.look(1200, 900, dark=False)
        shown.open((tmp_path / "report.html").as_uri())
        shown.until(f"{chart} !== undefined")
        over = f"{chart}.querySelector('.u-over').getBoundingClientRect()"
        left, top, width = shown.evaluate(f"[{over}.left, {over}.top, {over}.width]")
        shown.command("Input.dispatchMouseEvent", type="mouseMoved", x=left + 0.5 * width, y=top + 20)
        rows = f"[...{chart}.querySelectorAll('.u-series')].map((e) => [...e.children].map((c) => c.innerText.trim()))"
        (_, _), (one, low), (other, high), *_ = shown.until(f"{rows}[1][1] !== '–' && {rows}")
        assert (one, other) == ("tunnel, from", "to")
        assert float(low) < float(high)
        band = shown.evaluate(f"""(() => {{
            const c = {chart}.querySelector("canvas");
            const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
            let n = 0; for (let i = 0; i < d.length; i += 4) if (d[i + 3] > 40 && d[i + 3] < 52 && d[i + 2] > 180) n++;
            return n; }})()""")
        assert band > 100, "the tunnel is filled"
