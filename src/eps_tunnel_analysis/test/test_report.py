# SPDX-License-Identifier: Apache-2.0
"""The report: one page that fetches nothing, says the figures that were computed, and holds a chart a signal."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pytest
from tunnel_cases import make_trials

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.report.compare_report import compare_report
from eps_tunnel_analysis.report.page import Bar, Chart, Section, Table, Text, render
from eps_tunnel_analysis.report.pictures import write_pictures
from eps_tunnel_analysis.shown import shown_share, shown_value

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
    return compare_report(comparison, "Real against <model>", "a & b", [("real bag", "some/<bag>")])


def test_the_page_fetches_nothing(html):
    for tag, attributes in Page(html).elements:
        for name in ("src", "href", "srcset", "data", "action"):
            target = attributes.get(name) or ""
            assert target.startswith(("#", "data:")) or not target, (tag, target)
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


def test_each_signal_has_a_chart_whose_curves_are_the_tunnel(html, comparison):
    charts = [c for c in Page(html).data if "yaxis2" in c["layout"]]
    assert len(charts) == 2
    for i, chart in enumerate(charts):
        sim = next(t for t in chart["data"] if t["name"] == "simulation")
        assert np.allclose(sim["y"], np.degrees(comparison.sim_tunnel.mean[:, i]), rtol=1e-5)
        low, high = (t["meta"]["deviation"] for t in chart["data"][:2])
        expected = comparison.real_tunnel.lower[:, i], comparison.real_tunnel.upper[:, i]
        for got, want in zip((low, high), expected, strict=True):
            assert np.allclose([np.nan if v is None else v for v in got], np.degrees(want), rtol=1e-5, equal_nan=True)
        for a in comparison.alikeness:
            spans = [[s.start, s.end] for s in a.spans("ab"[i])]
            assert np.allclose(np.reshape(chart["outside"][f"{a.k_real:g}"], (-1, 2)), np.reshape(spans, (-1, 2)))


def test_names_cannot_break_the_page(html):
    assert "Real against &lt;model&gt;" in html
    assert "<bag>" not in html
    chart = Chart(data=[{"name": "</script><b>"}], layout={}, label="")
    page = render("t", "", [Section("S", [chart])])
    assert Page(page).data[0]["data"][0]["name"] == "</script><b>"


def test_a_page_without_charts_carries_no_plotly():
    page = render("t", "s", [Section("A title", [Text("hello"), Table(("a", "b"), [("x", Bar(0.5, "50%"))])])])
    assert len(page) < 20_000
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
    page = compare_report(compare(real, make_trials(np.zeros((1, 30, 1)))), "t", "s", [])
    assert "–" in page


def test_units_are_shown_as_people_read_them():
    assert shown_value(np.pi, "rad") == "180 deg"
    assert shown_value(0.0127, "m") == "12.7 mm"
    assert shown_value(0.5, "A") == "0.5 A"
    assert shown_value(2.0, "1") == "2"
    assert shown_value(np.nan, "rad") == "–"
    assert shown_share(0.13741) == "13.74 %"


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
    drawn = re.findall(r'class="chart js-plotly-plot"', result.stdout)
    assert len(drawn) == len(Page(html).data)
    assert "var(--" not in re.sub(r"<(style|script).*?</\1>", "", result.stdout, flags=re.DOTALL)
