# SPDX-License-Identifier: Apache-2.0
"""Checks a command line without running it: programs, options, parameters, topics and services exist."""

import argparse
import contextlib
import importlib
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from reference_page import nodes
from reference_page.page import launch_files

ROOT = Path(__file__).resolve().parents[1]


def check(command: str) -> None:
    """Raises AssertionError with what is wrong with a command line."""
    words = shlex.split(command.rstrip("& "))
    while words and re.fullmatch(r"\w+=.*", words[0]):
        words = words[1:]
    program, *rest = words
    if program == "eps-tunnel":
        from eps_tunnel_analysis.cli.main import parser

        parse(parser(), rest, command)
    elif program == "make":
        targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
        assert rest[0] in targets, command
    elif program == "source":
        assert (ROOT / rest[0]).is_file(), command
    elif words[:3] == ["python", "-m", "labyrinth_hw.testbed"]:
        from labyrinth_hw.testbed.command_line import parser as testbed

        parse(testbed(), words[3:], command)
    elif program == "dask":
        told = subprocess.run(["dask", rest[0], "--help"], capture_output=True, text=True, check=True).stdout
        assert all(word in told for word in rest if word.startswith("--")), command
    elif program == "ros2":
        check_ros2(rest, command)
    else:
        raise AssertionError(f"{command}: nothing is known about '{program}'")


def check_ros2(words: list[str], command: str) -> None:
    """`ros2 run`, `launch`, `topic echo`, `service call`."""
    every = [
        end for package in nodes.PACKAGES for file in nodes.executables(package).values() for end in nodes.ends(file)
    ]
    verb = " ".join(words[: 1 if words[0] == "run" else 2])
    if words[0] == "launch":
        declared = {argument.name for argument in launch_files()[words[1], words[2]]}
        assert {word.split(":=")[0] for word in words[3:]} <= declared, command
    elif verb == "run":
        check_run(words[1], words[2], words[3:], command)
    elif verb == "topic echo":
        known = {name_in(end.name, words[2]) for end in every if end.how == "publishes"}
        assert words[2] in known, command
    elif verb == "service call":
        served = {(name_in(end.name, words[2]), end.kind) for end in every if end.how == "serves"}
        assert (words[2], words[3]) in served, command
    else:
        raise AssertionError(f"{command}: nothing is known about 'ros2 {verb}'")


def name_in(name: str, given: str) -> str:
    """A name of the reference with its placeholders filled in from the name on the command line."""
    pattern = re.escape(name).replace("NS/", r"/\w+/").replace("SIGNAL", r"\w+")
    return given if re.fullmatch(pattern, given) else name


def check_run(package: str, executable: str, words: list[str], command: str) -> None:
    """A program of ours with its options and parameters."""
    programs = nodes.executables(package)
    assert executable in programs, command
    at = words.index("--ros-args") if "--ros-args" in words else len(words)
    own, ros = words[:at], words[at + 1 :]
    declared = {p.name for p in nodes.parameters(programs[executable])} | {"use_sim_time"}
    for flag, value in zip(ros[::2], ros[1::2], strict=True):
        assert flag in ("-p", "-r", "--params-file"), command
        assert flag != "-p" or value.split(":=")[0] in declared, f"{command}: {value}"
    if own:
        if executable == "testbed":
            from labyrinth_hw.testbed.command_line import parser
        else:
            relative = programs[executable].relative_to(ROOT / "src" / package).with_suffix("")
            parser = importlib.import_module(".".join(relative.parts)).parser
        parse(parser(), own, command)


def parse(parser: argparse.ArgumentParser, words: list[str], command: str) -> None:
    """Parses, and says what argparse said if that fails."""
    told = io.StringIO()
    try:
        with contextlib.redirect_stderr(told):
            parser.parse_args(words)
    except SystemExit as end:
        raise AssertionError(f"{command}\n{told.getvalue()}") from end
