# SPDX-License-Identifier: Apache-2.0
"""Messages to YAML or CSV, YAML to messages, and types by their name."""

import array
import importlib
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import yaml
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

INVALID = (AttributeError, ModuleNotFoundError, ValueError)  # what `interface` raises for a name that is no type
SEQUENCES = (list, tuple, array.array, np.ndarray)


def interface(name: str, kind: str) -> Any:
    """The class behind `package/kind/Name` or `package/Name`; kind is "msg", "srv" or "action"."""
    *packages, last = name.split("/")
    if len(packages) == 1:
        packages.append(kind)
    found = getattr(importlib.import_module(".".join(packages)), last)
    marks = {"msg": ("SLOT_TYPES",), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}[kind]
    if not all(hasattr(found, mark) for mark in marks):
        raise ValueError(f"{name} is no {kind}")
    return found


def fields(message: Any) -> Iterator[tuple[str, Any, Any]]:
    """Name, value and type of each field."""
    for name, kind in zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True):
        yield name, getattr(message, name), kind


def to_yaml(
    message: Any, truncate: int | None = None, no_arr: bool = False, no_str: bool = False, flow_style: bool = False
) -> str:
    plain = {name: _plain(value, kind, truncate, no_arr, no_str) for name, value, kind in fields(message)}
    text: str = yaml.dump(plain, sort_keys=False, allow_unicode=True, width=sys.maxsize, default_flow_style=flow_style)
    return text


def _plain(value: Any, kind: Any, truncate: int | None, no_arr: bool, no_str: bool) -> Any:
    if isinstance(value, bytes):
        return _cut(value.decode("latin-1"), truncate)
    if isinstance(value, str):
        return f"<string length: <{len(value)}>>" if no_str else _cut(value, truncate)
    if isinstance(value, SEQUENCES):
        if no_arr:
            return _abbreviated(value, kind)
        shown = [_plain(item, None, truncate, no_arr, no_str) for item in value[:truncate]]
        return [*shown, "..."] if len(shown) < len(value) else shown
    if isinstance(value, np.number):
        return value.item()
    if isinstance(value, (bool, float, int)):
        return value
    return {name: _plain(v, k, truncate, no_arr, no_str) for name, v, k in fields(value)}


def _cut(text: str, length: int | None) -> str:
    return text if length is None or len(text) <= length else f"{text[:length]}..."


def _abbreviated(value: Any, kind: Any) -> str:
    name = _type_name(kind.value_type)
    if isinstance(kind, Array):
        return f"<array type: {name}[{kind.size}]>"
    if isinstance(kind, BoundedSequence):
        return f"<sequence type: {name}[{kind.maximum_size}], length: {len(value)}>"
    return f"<sequence type: {name}, length: {len(value)}>"


def _type_name(kind: Any) -> str:
    if isinstance(kind, BasicType):
        return str(kind.typename)
    if isinstance(kind, AbstractString):
        return "string"
    if isinstance(kind, AbstractWString):
        return "wstring"
    return "/".join(kind.namespaced_name())


def to_csv(message: Any, truncate: int | None = None, no_arr: bool = False, no_str: bool = False) -> str:
    return ",".join(_csv(value, kind, truncate, no_arr, no_str) for _, value, kind in fields(message))


def _csv(value: Any, kind: Any, truncate: int | None, no_arr: bool, no_str: bool) -> str:
    if isinstance(value, SEQUENCES):
        if no_arr and kind is not None:
            return _abbreviated(value, kind)
        shown = [_csv(item, None, truncate, no_arr, no_str) for item in value[:truncate]]
        return ",".join([*shown, "..."] if len(shown) < len(value) else shown)
    if hasattr(value, "SLOT_TYPES"):
        return to_csv(value, truncate, no_arr, no_str)
    return str(_plain(value, kind, truncate, no_arr, no_str))


def fill(message: Any, values: Any, stamps: list[Callable[[Any], None]] | None = None) -> None:
    """Sets fields from a dictionary as YAML gives it.

    Args:
        stamps: receives a setter for each header given as `auto` and each time given as `now`; None refuses both.

    Raises:
        AttributeError: no such field. TypeError, ValueError, AssertionError: a value that the field cannot take.
    """
    if not isinstance(values, dict):
        raise TypeError(f"Value '{values}' is expected to be a dictionary but is a {type(values).__name__}")
    kinds = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
    for name, value in values.items():
        current = getattr(message, name)
        if stamps is not None and value == "auto" and _is(current, "std_msgs.msg._header", "Header"):
            stamps.append(partial(setattr, current, "stamp"))
        elif stamps is not None and value == "now" and _is(current, "builtin_interfaces.msg._time", "Time"):
            stamps.append(partial(setattr, message, name))
        else:
            setattr(message, name, _filled(current, value, kinds.get(name), stamps))


def _is(value: Any, module: str, name: str) -> bool:
    return (type(value).__module__, type(value).__name__) == (module, name)


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
