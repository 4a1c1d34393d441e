# SPDX-License-Identifier: Apache-2.0
"""`ros2 launch`: the part of `launch` and `launch_ros` that this project's launch files use.

A launch file finds the classes below as `launch.actions`, `launch_ros.actions` and so on. Entities are visited one
after the other, depth first, as `launch` does: an argument given to an included file stays set for what comes after it.
"""

import argparse
import os
import runpy
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml
from ament_index_python import PackageNotFoundError, get_package_share_directory

from ros2_standin.cli import argument, flag, verb
from ros2_standin.graph import patience
from ros2_standin.pkg import executable

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
PATIENCE = 5.0  # s for a process to end after each of them, on an idle machine


@dataclass
class Context:
    """What visiting the entities has brought about so far."""

    configurations: dict[str, str]
    folder: Path  # for files of parameters
    namespace: str = ""
    commands: list[tuple[str, list[str]]] = field(default_factory=list)  # name and command of each process to start


# Substitutions: what is text only when visited.


def text(context: Context, value: Any) -> str:
    """A text, a substitution, or several that follow one another."""
    if hasattr(value, "perform"):
        return str(value.perform(context))
    if isinstance(value, (str, Path)):
        return str(value)
    return "".join(text(context, part) for part in value)


class LaunchConfiguration:
    def __init__(self, variable_name: Any, *, default: Any = None) -> None:
        self.name, self.default = variable_name, default

    def perform(self, context: Context) -> str:
        name = text(context, self.name)
        if name in context.configurations:
            return context.configurations[name]
        if self.default is None:
            raise RuntimeError(f"launch configuration '{name}' does not exist")
        return text(context, self.default)


class PathJoinSubstitution:
    def __init__(self, substitutions: Iterable[Any]) -> None:
        self.parts = list(substitutions)

    def perform(self, context: Context) -> str:
        return os.path.join(*(text(context, part) for part in self.parts))


class FindPackageShare:
    def __init__(self, package: Any) -> None:
        self.package = package

    def perform(self, context: Context) -> str:
        name = text(context, self.package)
        try:
            return str(get_package_share_directory(name))
        except (PackageNotFoundError, ValueError):
            raise RuntimeError(f"Package '{name}' not found") from None


class ParameterValue:
    """A parameter's value, evaluated as YAML unless it is to be a `str`."""

    def __init__(self, value: Any, *, value_type: Any = None) -> None:
        self.value, self.kind = value, value_type

    def evaluate(self, context: Context) -> Any:
        said = text(context, self.value)
        if self.kind is str:
            return said
        value = yaml.safe_load(said)
        if self.kind is float and type(value) is int:
            value = float(value)
        if self.kind is not None and type(value) is not self.kind:
            raise RuntimeError(f"Expected a parameter of type {self.kind.__name__}, got '{said}'")
        return value


# Conditions


class IfCondition:
    wanted = True

    def __init__(self, predicate_expression: Any) -> None:
        self.expression = predicate_expression

    def evaluate(self, context: Context) -> bool:
        said = text(context, self.expression).strip().lower()
        if said not in ("true", "1", "false", "0"):
            raise RuntimeError(f"Expected true, 1, false or 0 as a condition, got '{said}'")
        return (said in ("true", "1")) is self.wanted


class UnlessCondition(IfCondition):
    wanted = False


# Actions


class DeclareLaunchArgument:
    condition = None

    def __init__(
        self, name: str, *, default_value: Any = None, description: str = "", choices: Iterable[str] | None = None
    ) -> None:
        self.name, self.default, self.description = name, default_value, description
        self.choices = None if choices is None else tuple(choices)

    def visit(self, context: Context) -> None:
        if self.name not in context.configurations:
            if self.default is None:
                raise RuntimeError(f"Required launch argument '{self.name}' was not provided")
            context.configurations[self.name] = text(context, self.default)
        value = context.configurations[self.name]
        if self.choices is not None and value not in self.choices:
            raise RuntimeError(f"Argument '{self.name}' is '{value}', expected one of {', '.join(self.choices)}")


class PythonLaunchDescriptionSource:
    def __init__(self, launch_file_path: Any) -> None:
        self.path = launch_file_path


class IncludeLaunchDescription:
    def __init__(
        self, launch_description_source: Any, *, launch_arguments: Iterable[Any] = (), condition: Any = None
    ) -> None:
        self.source, self.arguments, self.condition = launch_description_source, list(launch_arguments), condition

    def visit(self, context: Context) -> None:
        path = getattr(self.source, "path", self.source)
        for name, value in self.arguments:
            context.configurations[text(context, name)] = text(context, value)
        visit(description_of(Path(text(context, path))), context)


class PushROSNamespace:
    def __init__(self, namespace: Any, *, condition: Any = None) -> None:
        self.namespace, self.condition = namespace, condition

    def visit(self, context: Context) -> None:
        context.namespace = joined(context.namespace, text(context, self.namespace))


class GroupAction:
    """Actions whose namespace, and with `scoped` whose configurations, end with the group."""

    def __init__(self, actions: Iterable[Any], *, scoped: bool = True, condition: Any = None) -> None:
        self.actions, self.scoped, self.condition = list(actions), scoped, condition

    def visit(self, context: Context) -> None:
        kept = context.namespace, dict(context.configurations)
        visit(self.actions, context)
        if self.scoped:
            context.namespace, context.configurations = kept


class Node:
    def __init__(
        self,
        *,
        executable: Any,
        package: Any,
        name: Any = None,
        namespace: Any = None,
        parameters: Iterable[Any] = (),
        remappings: Iterable[Any] = (),
        arguments: Iterable[Any] = (),
        ros_arguments: Iterable[Any] = (),
        output: str = "log",
        condition: Any = None,
    ) -> None:
        self.package, self.executable, self.name, self.namespace = package, executable, name, namespace
        self.parameters, self.remappings, self.condition = list(parameters), list(remappings), condition
        self.arguments, self.ros_arguments = list(arguments), list(ros_arguments)

    def visit(self, context: Context) -> None:
        def every(values: Iterable[Any]) -> list[str]:
            return [text(context, value) for value in values]

        program = text(context, self.executable)
        command = [executable(text(context, self.package), program), *every(self.arguments), "--ros-args"]
        command += every(self.ros_arguments)
        if self.name is not None:
            command += ["-r", f"__node:={text(context, self.name)}"]
        if space := joined(context.namespace, text(context, self.namespace or "")):
            command += ["-r", f"__ns:={joined('/', space)}"]
        for given in self.parameters:
            command += ["--params-file", self.file_of(given, context)]
        for before, after in self.remappings:
            command += ["-r", f"{text(context, before)}:={text(context, after)}"]
        context.commands.append((f"{program}-{len(context.commands) + 1}", command))

    def file_of(self, parameters: Any, context: Context) -> str:
        """The file that is given, or one with the values that are."""
        if not isinstance(parameters, Mapping):
            return text(context, parameters)
        values = {text(context, name): evaluated(value, context) for name, value in parameters.items()}
        with tempfile.NamedTemporaryFile("w", dir=context.folder, prefix="launch_params_", delete=False) as file:
            yaml.safe_dump({"/**": {"ros__parameters": values}}, file)
        return file.name


class LifecycleNode(Node):
    """A managed node; whoever wants it in another state than it starts in asks it to change."""

    def __init__(self, *, name: Any, namespace: Any, **options: Any) -> None:
        super().__init__(name=name, namespace=namespace, **options)


def evaluated(value: Any, context: Context) -> Any:
    if isinstance(value, ParameterValue):
        return value.evaluate(context)
    return ParameterValue(value).evaluate(context) if hasattr(value, "perform") else value


def joined(outer: str, inner: str) -> str:
    """A namespace within another; one that begins with / stands for itself."""
    return inner if inner.startswith("/") or not outer else f"{outer.rstrip('/')}/{inner}".rstrip("/")


class LaunchDescription(list[Any]):
    """The entities of a launch file."""

    def __init__(self, initial_entities: Iterable[Any] = ()) -> None:
        super().__init__(initial_entities)

    add_action = list.append


MODULES: dict[str, dict[str, Any]] = {
    "launch": {"LaunchDescription": LaunchDescription, "SomeSubstitutionsType": Any},
    "launch.actions": {c.__name__: c for c in (DeclareLaunchArgument, GroupAction, IncludeLaunchDescription)},
    "launch.conditions": {c.__name__: c for c in (IfCondition, UnlessCondition)},
    "launch.launch_description_sources": {"PythonLaunchDescriptionSource": PythonLaunchDescriptionSource},
    "launch.substitutions": {c.__name__: c for c in (LaunchConfiguration, PathJoinSubstitution)},
    "launch_ros": {},
    "launch_ros.actions": {c.__name__: c for c in (LifecycleNode, Node, PushROSNamespace)},
    "launch_ros.parameter_descriptions": {"ParameterValue": ParameterValue},
    "launch_ros.substitutions": {"FindPackageShare": FindPackageShare},
}


def description_of(file: Path) -> LaunchDescription:
    """What a launch file's generate_launch_description returns."""
    if not file.is_file():
        raise RuntimeError(f"{file}: no such launch file")
    modules = {name: ModuleType(name) for name in MODULES}
    for name, module in modules.items():
        vars(module).update(MODULES[name])
    kept = {name: sys.modules[name] for name in MODULES if name in sys.modules}
    sys.modules.update(modules)
    try:
        made: LaunchDescription = runpy.run_path(str(file))["generate_launch_description"]()
    except (ImportError, TypeError) as error:
        raise RuntimeError(
            f"{file}: {error}. This stand-in for `ros2` knows what this project's launch files use; "
            "install ROS 2 for all of launch."
        ) from error
    finally:
        for name in MODULES:
            del sys.modules[name]
        sys.modules.update(kept)
    return made


def visit(entities: Iterable[Any], context: Context) -> None:
    for entity in entities:
        if entity.condition is None or entity.condition.evaluate(context):
            entity.visit(context)


# Processes


class Processes:
    """Those of one launch: their output with a name before each line, until all have ended."""

    def __init__(self, commands: list[tuple[str, list[str]]]) -> None:
        self.running: dict[str, subprocess.Popen[str]] = {}
        self.commands = {name: shlex.join(command) for name, command in commands}
        self.readers: list[threading.Thread] = []
        for name, command in commands:
            # A session of its own: Ctrl-C is for us, who pass it on.
            process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
            )
            self.running[name] = process
            print(f"[INFO] [{name}]: process started with pid [{process.pid}]")
            self.readers.append(threading.Thread(target=self._read, args=(name, process), daemon=True))
            self.readers[-1].start()

    def _read(self, name: str, process: "subprocess.Popen[str]") -> None:
        assert process.stdout is not None
        for line in process.stdout:
            print(f"[{name}] {line}", end="")

    def poll(self) -> bool:
        """Whether any still runs; says of each that ended how it did."""
        for name, process in [(n, p) for n, p in self.running.items() if p.poll() is not None]:
            del self.running[name]
            if process.returncode == 0:
                print(f"[INFO] [{name}]: process has finished cleanly [pid {process.pid}]")
            else:
                how = f"pid {process.pid}, exit code {process.returncode}, cmd '{self.commands[name]}'"
                print(f"[ERROR] [{name}]: process has died [{how}].")
        return bool(self.running)

    def wait(self, seconds: float = float("inf"), until: Callable[[], bool] = lambda: False) -> None:
        end = time.monotonic() + seconds
        while self.poll() and time.monotonic() < end and not until():
            time.sleep(0.05)

    def end(self) -> None:
        """Ends them as Ctrl-C would, and harder if they do not."""
        for number in SIGNALS:
            for name, process in self.running.items():
                print(f"[INFO] [{name}]: sending signal '{number.name}' to process[{name}]")
                process.send_signal(number)
            self.wait(PATIENCE * patience())
        for reader in self.readers:
            reader.join(1.0)


@verb(
    argument("package_name", help="Name of the ROS package, or path of a launch file"),
    argument("launch_file_name", nargs="?", default="", help="Name of the launch file"),
    argument("launch_arguments", nargs="*", help="Arguments to the launch file as NAME:=VALUE"),
    flag("-s", "--show-args", help="Show arguments that may be given to the launch file."),
)
def launch(args: argparse.Namespace) -> int | str | None:
    """Run a launch file of this project"""
    words = [args.launch_file_name, *args.launch_arguments]
    if os.path.isfile(args.package_name):
        file = Path(args.package_name)
    else:
        file = file_in(args.package_name, words.pop(0))
    given = dict(word.partition(":=")[::2] for word in words if word)
    if wrong := [word for word in words if word and ":=" not in word]:
        return f"malformed launch argument '{wrong[0]}', expected format '<name>:=<value>'"
    description = description_of(file)
    if args.show_args:
        show_arguments(description)
        return None
    stop: list[int] = []
    for number in SIGNALS[:2]:
        signal.signal(number, lambda received, _: stop.append(received))
    with tempfile.TemporaryDirectory(prefix="launch_") as folder:
        context = Context(given, Path(folder))
        visit(description, context)
        processes = Processes(context.commands)
        try:
            processes.wait(until=lambda: bool(stop))
        finally:
            processes.end()
    return 0


def file_in(package: str, name: str) -> Path:
    """A launch file that a package installed."""
    share = Path(FindPackageShare(package).perform(Context({}, Path())))
    files = [file for file in sorted(share.rglob("*.launch.py")) if file.name == name]
    if not files:
        raise RuntimeError(f"file '{name}' was not found in the share directory of package '{package}'")
    return files[0]


def show_arguments(description: LaunchDescription) -> None:
    print("Arguments (pass arguments as '<name>:=<value>'):")
    declared = [entity for entity in description if isinstance(entity, DeclareLaunchArgument)]
    for entity in declared:
        default = entity.default if isinstance(entity.default, str) else "made from others"
        print(f"\n    '{entity.name}':\n        {entity.description}")
        print("        (required)" if entity.default is None else f"        (default: '{default}')")
    if not declared:
        print("\n  No arguments.")
