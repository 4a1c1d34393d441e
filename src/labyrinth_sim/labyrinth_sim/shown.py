# SPDX-License-Identifier: Apache-2.0
"""How values print: a line for each field, arrays as shape, unit and range, so that any value fits a screen."""

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from pathlib import Path
from textwrap import fill
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

WIDTH = 100  # characters of a line
LINES = 3  # of one field
LISTED = 12  # entries of a list that are named
ABOUT = 45  # characters of what a docstring says of an array
T = TypeVar("T")


def shown(cls: type[T]) -> type[T]:
    """Class decorator above @dataclass: such a value prints as `summary` and shows as a table in a notebook."""
    cls.__repr__ = summary  # type: ignore[assignment,method-assign]
    cls._repr_html_ = html_table  # type: ignore[attr-defined]
    return cls


def summary(value: object) -> str:
    """The class, and a line for each field of a dataclass."""
    rows = dict(_rows(value))
    wide = max((len(name) for name in rows), default=0)
    lines = [
        fill(text, WIDTH, initial_indent=f"  {name:<{wide}}  ", subsequent_indent=" " * (wide + 4), max_lines=LINES,
             placeholder=" ...")
        for name, text in rows.items()
    ]  # fmt: skip
    return "\n".join([type(value).__name__, *lines])


def html_table(value: object) -> str:
    """The same as HTML."""
    rows = (
        f'<tr><th style="text-align:left">{escape(n)}</th><td style="text-align:left">{escape(text)}</td></tr>'
        for n, text in _rows(value)
    )
    return f"<table><caption>{escape(type(value).__name__)}</caption>{''.join(rows)}</table>"


def brief(value: object) -> str:
    """A value in part of a line."""
    match value:
        case str():
            return " ".join(value.split())
        case float():
            return f"{value:.6g}"
        case np.ndarray():
            return f"array {value.shape}"
        case Path() | None | bool() | int():
            return str(value)
        case Mapping():
            return _listed([_entry(key, entry) for key, entry in value.items()])
        case list() | tuple() | set() | frozenset():
            return _sequence(list(value))
        case type():
            return value.__name__
    if callable(value) and not is_dataclass(value):
        return f"function {getattr(value, '__name__', type(value).__name__)}"
    name = getattr(value, "name", "")
    return f"{type(value).__name__} {name}" if isinstance(name, str) and name else type(value).__name__


def _rows(value: object) -> Iterator[tuple[str, str]]:
    assert is_dataclass(value)
    about = _documented(type(value))
    for field in fields(value):
        if field.repr:
            content = getattr(value, field.name)
            is_array = isinstance(content, np.ndarray)
            yield field.name, _array(content, about.get(field.name, "")) if is_array else brief(content)


def _documented(cls: type[Any]) -> Mapping[str, str]:
    """Field -> the first words that the class's docstring has under "Attributes:"."""
    _, _, listed = (inspect.getdoc(cls) or "").partition("Attributes:")
    meanings = {}
    for names, text in re.findall(r"^ +([a-z]\w*(?:, \w+)*): +(.+)$", listed, flags=re.MULTILINE):
        meanings.update(dict.fromkeys(names.split(", "), re.split(r"[;,.](?: |$)(?![^(]*\))", text)[0]))
    return meanings


def _array(values: NDArray[Any], about: str) -> str:
    """Shape, what else the docstring says about it (its unit), and range: "(5, 1201, 4) rad, -0.052 to 0.054"."""
    meaning = re.sub(r"^\([^)]*\) *", "", about)
    text = f"{values.shape} {meaning if len(meaning) <= ABOUT else ''}".rstrip()
    if not np.issubdtype(values.dtype, np.number) or not values.size:
        return text
    finite = values[np.isfinite(values)]
    return f"{text}, {finite.min():.4g} to {finite.max():.4g}" if finite.size else f"{text}, NaN throughout"


def _entry(key: object, entry: object) -> str:
    return f"{key} {brief(entry)}" if isinstance(entry, bool | int | float | str) else str(key)


def _sequence(values: Sequence[object]) -> str:
    """What is short one by one; of the rest how many there are."""
    if all(isinstance(v, bool | int | float | str | Path) for v in values):
        return _listed([brief(v) for v in values])
    kinds = {type(v).__name__ for v in values}
    named = all(isinstance(getattr(v, "name", None), str) for v in values)
    return f"{len(values)} {' or '.join(sorted(kinds))}{f': {_listed([v.name for v in values])}' if named else ''}"  # type: ignore[attr-defined]


def _listed(texts: Sequence[str]) -> str:
    more = f", ... ({len(texts)} in all)" if len(texts) > LISTED else ""
    return ", ".join(texts[:LISTED]) + more if texts else "none"
