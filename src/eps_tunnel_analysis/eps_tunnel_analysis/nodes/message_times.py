# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages and nanoseconds."""

from builtin_interfaces.msg import Time


def nanoseconds(stamp: Time) -> int:
    """ns since the clock's epoch."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def to_time(ns: int) -> Time:
    """The stamp of ns since the clock's epoch."""
    return Time(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)
