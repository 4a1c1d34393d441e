# SPDX-License-Identifier: Apache-2.0
"""Bags: written so that a crash loses at most a second, read as they are, resampled onto one time grid."""

from eps_tunnel_analysis.recording.channel_map import ChannelMap, Source, channel_map, guessed_map
from eps_tunnel_analysis.recording.csv_import import CsvColumns, csv_to_bag
from eps_tunnel_analysis.recording.decode import read, read_all
from eps_tunnel_analysis.recording.recording import Recording, StampedTopic, TimeSource, TrialMark
from eps_tunnel_analysis.recording.trials import (
    PlaysResult,
    ResampleReport,
    TrialsResult,
    read_trials,
    to_plays,
    to_trials,
)
from eps_tunnel_analysis.recording.writer import BagWriter, RecordingError, repair

__all__ = [
    "BagWriter",
    "ChannelMap",
    "CsvColumns",
    "PlaysResult",
    "Recording",
    "RecordingError",
    "ResampleReport",
    "Source",
    "StampedTopic",
    "TimeSource",
    "TrialMark",
    "TrialsResult",
    "channel_map",
    "csv_to_bag",
    "guessed_map",
    "read",
    "read_all",
    "read_trials",
    "repair",
    "to_plays",
    "to_trials",
]
