# SPDX-License-Identifier: Apache-2.0
"""The report: one page that fetches nothing, says the figures that were computed, and holds a chart a signal."""

import json
import math
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from tunnel_cases import make_trials

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.outputs import shown_number, shown_share, shown_times, shown_value
from eps_tunnel_analysis.phases import sentences
from eps_tunnel_analysis.report.comparison_sections import at_a_glance, headline
from eps_tunnel_analysis.report.next_step import after_comparison
from eps_tunnel_analysis.report.page import Bar, Chart, Line, Section, Table, Text, joined_spans, render
from eps_tunnel_analysis.report.pictures import write_pictures
from eps_tunnel_analysis.report.reports import compare_report

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
TIME = np.arange(200) * 0.01
COMMAND = np.where(TIME >= 0.5, 0.05, 0.0)[None, :, None]


class Page(HTMLParser):
    """Elements of a page with their attributes, and the text of its JSON scripts."""

    def __init__(self, html):
        super().__init__()
        self.elements, self.data, self.json = [], [], False
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self.json = tag == "script" and dict(attrs).get("type") == "application/json"

    def handle_data(self, data):
        if self.json and data.strip():
            self.data.append(json.loads(data))

    def handle_endtag(self, tag):
        self.json = False


@pytest.fixture(scope="module")
def comparison():
    rng = np.random.default_rng(1)
    real = np.repeat(COMMAND, 3, axis=0) + rng.normal(0, 1e-3, (3, 200, 2))
    real[:, 20:25, 1] = np.nan
    sim = np.repeat(COMMAND, 2, axis=2) * 0.9
    return compare(make_trials(real, commands=np.repeat(COMMAND, 3, axis=0)), make_trials(sim, commands=COMMAND))


@pytest.fixture(scope="module")
def html(comparison):
    step = ("Next.", "eps-tunnel diagnose --real '<bag>'")
    return compare_report(comparison, "<model>", [("real bag", "some/<bag>")], step)


def test_the_page_fetches_nothing(html):
    for tag, attributes in Page(html).elements:
        for name in ("src", "href", "srcset", "data", "action"):
            target = attributes.get(name) or ""
            assert target.startswith(("#", "data:")) or not target, (tag, target)
    assert "//" not in re.sub(r"/\*!? https://github.com/leeoniya/uPlot.*?\*/", "", html).split("<body>")[0]
    styles = "".join(re.findall(r"<style>(.*?)</style>", html, flags=re.DOTALL))
    assert "url(" not in styles
    assert "@import" not in styles


def test_the_page_says_the_figures_that_were_computed(html, comparison):
    for a in comparison.alikeness:
        for share in (*a.shares.values(), a.joint):
            assert shown_share(share) in html
    for e in comparison.errors:
        assert shown_value(e.rms, e.unit) in html
        assert shown_value(e.command_error, e.unit) in html


def numbers(values):
    return np.array([np.nan if v is None else v for v in values])


def test_each_signal_has_charts_whose_curves_are_the_tunnel(html, comparison):
    charts = Page(html).data[2:6]  # after the pair at the top: trajectory and deviation of each signal
    for i, (whole, apart) in enumerate(zip(charts[::2], charts[1::2], strict=True)):
        lines = {line["name"]: numbers(line["y"]) for line in whole["lines"] + apart["lines"]}
        sim, real = comparison.sim_tunnel.mean[:, i], comparison.real_tunnel.mean[:, i]
        close = {"rtol": 0, "atol": 1e-3, "equal_nan": True}
        assert np.allclose(lines["simulation"], np.degrees(sim), **close)
        assert np.allclose(lines["real mean"], np.degrees(real), **close)
        assert np.allclose(lines["simulation − real"], np.degrees(sim - real), **close)
        for chart in (whole, apart):
            low, high = numbers(chart["band"]["lower"]), numbers(chart["band"]["upper"])
            assert np.allclose(low, np.degrees(comparison.real_tunnel.lower[:, i]), **close)
            assert np.allclose(high, np.degrees(comparison.real_tunnel.upper[:, i]), **close)
        for a in comparison.alikeness:
            spans = joined_spans([(s.start, s.end) for s in a.spans("ab"[i])], 1.99 / 2000)
            assert [tuple(span) for span in whole["outside"][f"{a.k_real:g}"]] == spans
        assert whole["x"] == pytest.approx({"from": 0.0, "step": 0.01, "count": 200})


def off_by(error, trials=5, spread=1e-3):
    """A comparison whose simulation is off by `error` rad where the command is up; the rig repeats within `spread`."""
    draw = np.random.default_rng(4).normal(0, spread, (trials, 200, 1))
    real = np.repeat(COMMAND, trials, axis=0) + draw - draw.mean(axis=0)
    return compare(make_trials(real, commands=np.repeat(COMMAND, trials, axis=0)),
                   make_trials(COMMAND + error * (COMMAND > 0), commands=COMMAND))  # fmt: skip


def test_the_title_is_the_answer():
    assert headline(off_by(0.02), "m").startswith("m is off by 1")
    assert "times what the rig itself repeats, most on a" in headline(off_by(0.02), "m")
    assert headline(off_by(1e-5), "m") == "m is as close to the rig as the rig is to itself"
    assert "one trial gives no repeat spread" in headline(off_by(0.02, trials=1), "m")
    page = compare_report(off_by(0.02), "m", [], ("Next.", "eps-tunnel diagnose"))
    assert re.search(r"<h1>(.*)</h1>", page)[1] == headline(off_by(0.02), "m")


def test_the_next_command_is_there_to_copy_until_the_rig_itself_is_no_closer():
    said, command = after_comparison(off_by(0.02), [Path("my bags/real")], "pendulum", Path("own"))
    assert command == "eps-tunnel diagnose --real 'my bags/real' --effects own --model pendulum --out why"
    assert "lacks" in said
    assert after_comparison(off_by(1e-5), [Path("real")], "pendulum", None)[1] == ""
    assert "<code>eps-tunnel diagnose --real &#39;&lt;bag&gt;&#39;</code><button" in compare_report(
        off_by(0.02), "m", [], ("Next.", "eps-tunnel diagnose --real '<bag>'")
    )


@pytest.mark.parametrize("trials", [1, 2, 5])
def test_three_numbers_open_the_page_and_the_third_says_so_where_it_is_unknown(trials):
    after, before = off_by(0.002, trials), off_by(0.02, trials)
    figures = at_a_glance(after, ("", ""), before).blocks[0].items
    error, alike, rig = figures
    assert error[0] == shown_value(after.errors[0].command_error, "rad")
    assert f"{shown_value(before.errors[0].command_error, 'rad')} before" in error[2]
    assert alike[0] == shown_share(after.alikeness[0].joint)
    assert rig[0] == (shown_share(after.against_itself[0].joint) if trials > 2 else "–")
    assert ("three trials" in rig[2]) == (trials < 3)


def test_before_and_after_stand_side_by_side_on_one_scale():
    pair = at_a_glance(off_by(0.002), ("", ""), off_by(0.02)).blocks[1]
    (first, before), (second, after) = pair.charts
    assert (first, second) == ("a before", "a after")
    assert before.y_range == after.y_range
    assert np.nanmax(np.abs(before.lines[0].values)) > 5 * np.nanmax(np.abs(after.lines[0].values))


def test_the_rig_against_itself_stands_beside_every_alikeness(html, comparison):
    for a in comparison.against_itself:
        for share in (*a.shares.values(), a.joint):
            assert shown_share(share) in html
    assert html.count("the rig against itself") > len(comparison.signals)


@pytest.mark.study
def test_a_long_recording_of_many_signals_stays_under_a_megabyte():
    rng = np.random.default_rng(2)
    real = rng.normal(size=(3, 30_000, 8))
    page = compare_report(compare(make_trials(real), make_trials(rng.normal(size=(1, 30_000, 8)))), "m", [])
    assert len(page.encode()) < 1_000_000


def test_paths_are_links_from_where_the_page_is(comparison, tmp_path):
    (tmp_path / "bags" / "a bag").mkdir(parents=True)
    bag, out = tmp_path / "bags" / "a bag", tmp_path / "gap"
    facts = [("real bag", f"{bag} (SHA-256 0123)"), ("model", "labyrinth, rig labyrinth"), ("note", "/none (of)")]
    links = [a["href"] for tag, a in Page(compare_report(comparison, "m", facts, at=out)).elements if tag == "a"]
    assert [link for link in links if not link.startswith("#")] == ["../bags/a%20bag"]


def test_nothing_has_a_width_that_a_phone_lacks(html):
    page = Page(html)
    viewport = {"name": "viewport", "content": "width=device-width, initial-scale=1"}
    assert ("meta", viewport) in page.elements
    for tag, attributes in page.elements:
        for name, size, unit in re.findall(r"((?:min-)?width):\s*([\d.]+)(\S*?)(?:;|$)", attributes.get("style") or ""):
            assert unit == "%", (tag, name, size, unit)
    for row in re.findall(r"<tbody>(.*?)</tbody>", html, flags=re.DOTALL):
        assert row.count("<td ") == row.count("data-label=") > 0  # a folded table tells what each value is


def test_names_cannot_break_the_page(html):
    assert "&lt;model&gt; is off by" in html
    assert "<bag>" not in html
    line = Line("</script><b>", np.zeros(3), "real")
    page = render("t", "", [Section("S", [Chart(np.arange(3.0), [line], "x", "y", label="")])])
    assert Page(page).data[0]["lines"][0]["name"] == "</script><b>"


def test_a_page_without_charts_carries_no_charting_library():
    page = render("t", "s", [Section("A title", [Text("hello"), Table(("a", "b"), [("x", Bar(0.5, "50%"))])])])
    assert len(page) < 25_000
    assert "uPlot" not in page.split("<script>")[0]
    assert 'id="a-title"' in page
    assert "width:50.0%" in page


def test_pictures_are_the_same_bytes_each_time(comparison, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one, two = write_pictures(comparison, tmp_path / "a"), write_pictures(comparison, tmp_path / "b")
    assert [p.name for p in one] == [
        f"{stem}{suffix}" for stem in ("tunnel_a", "tunnel_b", "alikeness_over_k") for suffix in (".svg", ".png")
    ]
    for a, b in zip(one, two, strict=True):
        assert a.read_bytes() == b.read_bytes()
        assert a.stat().st_size > 1000


def test_a_signal_never_seen_still_gives_a_report():
    real = make_trials(np.full((2, 30, 1), np.nan))
    page = compare_report(compare(real, make_trials(np.zeros((1, 30, 1)))), "t", [])
    assert "–" in page


def test_units_are_shown_as_people_read_them():
    assert shown_value(np.pi, "rad") == "180 deg"
    assert shown_value(0.0127, "m") == "12.7 mm"
    assert shown_value(0.5, "A") == "0.5 A"
    assert shown_value(2.0, "1") == "2"
    assert shown_value(np.nan, "rad") == "–"
    assert shown_share(0.13741) == "13.74 %"


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [
        (163.2, 2, "160"),
        (-1234.0, 3, "-1230"),
        (999.6, 3, "1000"),
        (0.000042, 2, "0.000042"),
        (0.0, 3, "0"),
        (0.25, 3, "0.25"),
        (3.43e9, 3, "3.43 × 10^9"),
        (1e6, 4, "10^6"),
        (-1e-9, 2, "-10^-9"),
        (math.nan, 3, "–"),
        (math.inf, 3, "inf"),
    ],
)
def test_numbers_are_written_as_people_write_them(value, digits, shown):
    assert shown_number(value, digits) == shown


def test_a_large_ratio_is_only_called_large():
    assert [shown_times(t) for t in (0.0, 4.83, 163.2, 1000.0)] == ["0", "4.8", "160", "1000"]
    assert shown_times(3.43e9) == shown_times(math.inf) == "over 1000"
    assert shown_times(math.nan) == "–"
    assert shown_value(25.0, "rad") == "1430 deg"
    assert "is off by 260 times what the rig itself repeats" in headline(off_by(0.3), "m")
    assert "is off by over 1000 times what the rig itself repeats" in headline(off_by(3.0), "m")
    words = sentences(off_by(0.3).where)
    assert "300 times the rig's repeat spread" in words[0]


@pytest.mark.skipif(not CHROMIUM, reason="no chromium on PATH")
def test_a_browser_draws_every_chart(html, tmp_path):
    (tmp_path / "report.html").write_text(html, encoding="utf-8")
    flags = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--virtual-time-budget=10000",
        f"--user-data-dir={tmp_path}",
    ]
    page = (tmp_path / "report.html").as_uri()
    result = subprocess.run([CHROMIUM, *flags, "--dump-dom", page], capture_output=True, text=True, timeout=120)
    drawn = re.findall(r'class="chart".{0,200}? data-drawn="', result.stdout, flags=re.DOTALL)
    assert len(drawn) == len(Page(html).data)
    assert result.stdout.count("<canvas") == len(drawn)
