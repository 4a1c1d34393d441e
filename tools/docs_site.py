# SPDX-License-Identifier: Apache-2.0
"""What mkdocs needs besides docs/ itself: README and CONTRIBUTING as pages, and Markdown as it reads it.

mkdocs.yml names this file as its hook; mkdocs calls the functions `on_...`.
"""

import posixpath
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md"}
"""File beside docs/ -> page of the site."""
LINK = re.compile(r"(!?\[[^\]]*\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
ITEM = re.compile(r"(?:-|\d+\.) +")
DEPTH = 4  # spaces by which Markdown of Python indents what belongs to an item of a list


def slug(heading: str, separator: str) -> str:
    """The name by which a heading is linked to, as on GitHub."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", separator)


def deepened(text: str) -> str:
    """What belongs to an item of a list, indented as far as mkdocs wants it."""
    lines, width, fenced = [], 0, False
    for line in text.splitlines():
        fenced ^= line.startswith("```")
        item = None if fenced else ITEM.match(line)
        if item:
            width = len(item[0])
        elif line and not line.startswith(" "):
            width = 0
        elif width and line.startswith(" " * width):
            line = " " * (DEPTH - width) + line
        lines.append(line)
    return "\n".join(lines) + "\n"


def relinked(text: str, source: str, page: str) -> str:
    """Links as a page of the site has them.

    Args:
        source: path of the page's file from the repository's root.
        page: path of the page from the site's root.
    """

    def link(found: re.Match[str]) -> str:
        before, target, after = found.groups()
        if ":" in target:
            return found[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        if (ROOT / path).is_dir():
            path = next(file.relative_to(ROOT).as_posix() for file in sorted((ROOT / path).glob("*.md")))
        inside = PAGES.get(path) or (path.removeprefix("docs/") if path.startswith("docs/") else f"source/{path}")
        return before + posixpath.relpath(inside, posixpath.dirname(page) or ".") + after

    return LINK.sub(link, text)


def sources() -> set[str]:
    """Files outside docs/ that pages link to, from the repository's root."""
    found = set()
    for file in [*(ROOT / "docs").rglob("*.md"), *(ROOT / name for name in PAGES)]:
        for _, target, _ in LINK.findall(file.read_text(encoding="utf-8")):
            path = (file.parent / target).resolve() if ":" not in target else ROOT
            if path.is_file() and not path.is_relative_to(ROOT / "docs"):
                found.add(path.relative_to(ROOT).as_posix())
    return found - set(PAGES)


def on_config(config: Any) -> Any:
    """Headings get the names that the pages' links use."""
    config["mdx_configs"]["toc"] = {"slugify": slug, "permalink": True}
    return config


def on_files(files: Any, config: Any) -> Any:
    """Adds what lies outside docs/."""
    from mkdocs.structure.files import File

    for name, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text(encoding="utf-8")))
    for name in sorted(sources()):
        files.append(File.generated(config, f"source/{name}", content=(ROOT / name).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, **given: Any) -> str:
    """Links and lists of one page."""
    path = page.file.src_uri
    source = next((name for name, made in PAGES.items() if made == path), f"docs/{path}")
    return deepened(relinked(markdown, source, path))
