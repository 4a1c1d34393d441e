# SPDX-License-Identifier: Apache-2.0
"""Messages to YAML, YAML to messages, and types by their name."""

import argparse
import array
import importlib
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import yaml
from rosidl_parser.definition import AbstractNestedType, Array, BasicType, NamespacedType

from ros2_standin.cli import argument, flag

SEQUENCES = (list, tuple, array.array, np.ndarray)
MARKS = {"msg": ("SLOT_TYPES",), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
WORDS = {"msg": "message", "srv": "service", "action": "action"}
STDIN = flag("--stdin", help="Read values from standard input")
SHORTENING = (
    flag("-f", "--full-length", help="Output all elements for arrays and strings"),
    argument("-l", "--truncate-length", type=int, default=128, help="Longest array or string (default: %(default)s)"),
    flag("--no-arr", help="Don't print array fields of messages"),
    flag("--no-str", help="Don't print string fields of messages"),
)


def interface(name: str, kind: str) -> Any:
    """The class behind `package/kind/Name` or `package/Name`; kind is "msg", "srv" or "action".

    Raises:
        RuntimeError: no such type.
    """
    *packages, last = name.split("/")
    if len(packages) == 1:
        packages.append(kind)
    try:
        found = getattr(importlib.import_module(".".join(packages)), last)
    except (AttributeError, ModuleNotFoundError, ValueError):
        found = None
    if not all(hasattr(found, mark) for mark in MARKS[kind]):
        raise RuntimeError(f"The passed {WORDS[kind]} type is invalid")
    return found


def to_yaml(message: Any, args: argparse.Namespace | None = None) -> str:
    """A message as YAML, shortened as options say."""
    text: str = yaml.dump(_plain(message, None, args), sort_keys=False, allow_unicode=True, width=sys.maxsize)
    return text


def _plain(value: Any, kind: Any, args: argparse.Namespace | None) -> Any:
    longest = None if args is None or args.full_length else args.truncate_length
    if isinstance(value, (str, bytes)):
        text = value.decode("latin-1") if isinstance(value, bytes) else value
        if args is not None and args.no_str:
            return f"<string length: <{len(text)}>>"
        return text if longest is None or len(text) <= longest else f"{text[:longest]}..."
    if isinstance(value, SEQUENCES):
        if args is not None and args.no_arr:
            size = f"array type: {_element(kind)}[{kind.size}]" if isinstance(kind, Array) else None
            return f"<{size or f'sequence type: {_element(kind)}, length: {len(value)}'}>"
        items = [_plain(item, None, args) for item in value[:longest]]
        return [*items, "..."] if len(items) < len(value) else items
    if isinstance(value, np.number):
        return value.item()
    if hasattr(value, "SLOT_TYPES"):
        return {name: _plain(getattr(value, name), kind, args) for name, kind in _fields(value)}
    return value


def _fields(message: Any) -> Iterator[tuple[str, Any]]:
    return zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True)


def _element(kind: Any) -> str:
    inner = kind.value_type
    if isinstance(inner, NamespacedType):
        return "/".join(inner.namespaced_name())
    return str(inner.typename) if isinstance(inner, BasicType) else "string"


def given_values(args: argparse.Namespace, text: str) -> Any:
    """Values in YAML from an argument or, with --stdin, from there."""
    return yaml.safe_load(sys.stdin.read() if args.stdin else text)


def fill(message: Any, values: Any, stamps: list[Callable[[Any], None]] | None = None) -> None:
    """Sets fields from a dictionary as YAML gives it.

    Args:
        stamps: receives a setter for each header given as `auto` and each time given as `now`; None refuses both.

    Raises:
        AttributeError: no such field. TypeError, ValueError, AssertionError: a value that the field cannot take.
    """
    if not isinstance(values, dict):
        raise TypeError(f"Value '{values}' is expected to be a dictionary but is a {type(values).__name__}")
    kinds = dict(_fields(message))
    for name, value in values.items():
        current = getattr(message, name)
        if stamps is not None and value == "auto" and type(current).__name__ == "Header":
            stamps.append(partial(setattr, current, "stamp"))
        elif stamps is not None and value == "now" and type(current).__name__ == "Time":
            stamps.append(partial(setattr, message, name))
        else:
            setattr(message, name, _filled(current, value, kinds.get(name), stamps))


def _filled(current: Any, value: Any, kind: Any, stamps: list[Callable[[Any], None]] | None) -> Any:
    if isinstance(current, array.array):
        return array.array(current.typecode, value)
    if isinstance(current, np.ndarray):
        return np.array(value, dtype=current.dtype)
    if isinstance(kind, AbstractNestedType) and isinstance(kind.value_type, NamespacedType):
        element = interface("/".join(kind.value_type.namespaced_name()), kind.value_type.namespaces[-1])
        items = [element() for _ in value]
        for item, given in zip(items, value, strict=True):
            fill(item, given, stamps)
        return items
    if hasattr(current, "SLOT_TYPES"):
        inner = type(current)()
        fill(inner, value, stamps)
        return inner
    return value if type(value) is type(current) else type(current)(value)
