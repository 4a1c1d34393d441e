# SPDX-License-Identifier: Apache-2.0
"""The site of the pages: every page is in its navigation, and Markdown reaches mkdocs as it reads it."""

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

import docs_site

ROOT = docs_site.ROOT
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
OWN = ROOT / "build" / "docs" / "bin" / "python"  # of `make docs`


def named(entry: Any) -> Iterator[str]:
    """Every page of a part of the navigation."""
    if isinstance(entry, str):
        yield entry
    else:
        for inside in entry.values() if isinstance(entry, dict) else entry:
            yield from named(inside)


def test_the_navigation_names_every_page_once() -> None:
    pages = [file.relative_to(ROOT / "docs").as_posix() for file in (ROOT / "docs").rglob("*.md")]
    assert sorted(named(CONFIG["nav"])) == sorted([*pages, *docs_site.PAGES.values()])


def test_nothing_is_fetched_when_it_is_read() -> None:
    assert CONFIG["theme"]["font"] is False
    assert CONFIG["plugins"] == ["search"]
    assert not {key for key in CONFIG if key.startswith("extra")}
    assert "```mermaid" not in "".join(f.read_text(encoding="utf-8") for f in (ROOT / "docs").rglob("*.md"))


def test_lists_are_indented_as_mkdocs_wants_it() -> None:
    rest = "\nend\n  as it is\n\n```\n- code\n  as it is\n```\n"
    text = "- one\n\n  more\n\n1. two\n\n   ```console\n   $ x\n   ```\n"
    want = "- one\n\n    more\n\n1. two\n\n    ```console\n    $ x\n    ```\n"
    assert docs_site.deepened(text + rest) == want + rest


@pytest.mark.parametrize(
    ("source", "page", "link", "made"),
    [
        ("README.md", "index.md", "docs/howto/own_rig.md#x", "howto/own_rig.md#x"),
        ("README.md", "index.md", "CONTRIBUTING.md", "contributing.md"),
        ("docs/howto/a.md", "howto/a.md", "../../CONTRIBUTING.md#y", "../contributing.md#y"),
        ("docs/howto/a.md", "howto/a.md", "../../tools/lock.py", "../source/tools/lock.py"),
        ("docs/a.md", "a.md", "pictures/b.png", "pictures/b.png"),
        ("docs/a.md", "a.md", "https://c.org/d", "https://c.org/d"),
    ],
)
def test_links_lead_to_pages_of_the_site(source: str, page: str, link: str, made: str) -> None:
    assert docs_site.relinked(f"see [it]({link}).", source, page) == f"see [it]({made})."


def test_files_beside_the_pages_come_along() -> None:
    assert all((ROOT / name).is_file() for name in docs_site.sources())


def test_a_link_that_leads_nowhere_stops_it(tmp_path: Path) -> None:
    python = OWN if OWN.is_file() else Path(sys.executable)
    if python == Path(sys.executable) and importlib.util.find_spec("mkdocs") is None:
        pytest.skip("needs mkdocs: make docs")
    for name in ("docs", "tools"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("mkdocs.yml", *docs_site.PAGES, *docs_site.sources()):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    build = [str(python), "-m", "mkdocs", "build", "--strict"]
    done = subprocess.run(build, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "docs" / "search" / "search_index.json").is_file()
    with (tmp_path / "docs" / "law.md").open("a", encoding="utf-8") as page:
        page.write("\n[nowhere](nowhere.md)\n")
    done = subprocess.run(build, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode != 0
    assert "nowhere.md" in done.stderr
