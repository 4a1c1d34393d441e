# SPDX-License-Identifier: Apache-2.0
"""The arrows of docs/architecture.md, read off the imports."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("labyrinth_sim", "labyrinth_hw", "eps_tunnel_analysis")
OURS = {*PACKAGES, "labyrinth_msgs"}
LONGEST = 600  # lines

# What a package may import of ours, besides itself, outside nodes/ and inside.
ALLOWED: dict[str, tuple[set[str], set[str]]] = {
    "labyrinth_sim": (set(), {"labyrinth_msgs"}),
    "labyrinth_hw": (set(), {"labyrinth_msgs"}),
    "eps_tunnel_analysis": ({"labyrinth_sim"}, {"labyrinth_sim", "labyrinth_msgs"}),
}


@cache
def modules(package: str) -> list[Path]:
    return sorted((ROOT / "src" / package / package).rglob("*.py"))


def name_of(file: Path, package: str) -> str:
    parts = file.relative_to(ROOT / "src" / package).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"), str(file))


@cache
def names(package: str) -> set[str]:
    return {name_of(file, package) for file in modules(package)}


def imported(file: Path) -> Iterator[str]:
    """First part of the name of every module that a file imports, wherever in the file."""
    for node in ast.walk(tree(file)):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]


def sources() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True
    )
    if listed.returncode:
        pytest.skip("not a git checkout, so what belongs to the sources is unknown")
    return [ROOT / line for line in listed.stdout.splitlines() if (ROOT / line).is_file()]


@pytest.mark.parametrize("package", PACKAGES)
def test_only_nodes_import_ros(package: str) -> None:
    ros = {"rclpy", "rcl_interfaces", "sensor_msgs", "std_msgs", "std_srvs", "diagnostic_msgs", "labyrinth_msgs"}
    wrong = {
        str(file.relative_to(ROOT)): sorted(found)
        for file in modules(package)
        if "nodes" not in file.relative_to(ROOT).parts and (found := ros & set(imported(file)))
    }
    assert not wrong


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_only_along_the_arrows(package: str) -> None:
    outside, inside = ALLOWED[package]
    wrong = {}
    for file in modules(package):
        allowed = inside if "nodes" in file.relative_to(ROOT).parts else outside
        if found := (OURS & set(imported(file))) - allowed - {package}:
            wrong[str(file.relative_to(ROOT))] = sorted(found)
    assert not wrong


@pytest.mark.parametrize("package", PACKAGES)
def test_everything_but_nodes_imports_without_ros(package: str) -> None:
    names = [name_of(file, package) for file in modules(package)]
    names = [name for name in names if "nodes" not in name.split(".") and not name.endswith("__main__")]
    paths = [str(ROOT / "src" / p) for p in PACKAGES]
    program = f"""
import importlib, sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("rclpy", "labyrinth_msgs"):
            raise ImportError(name + " is blocked")
sys.meta_path.insert(0, Blocked())
sys.path[:0] = {paths!r}
for name in {names!r}:
    try:
        importlib.import_module(name)
    except Exception as error:
        print(f"{{name}}: {{type(error).__name__}}: {{error}}")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


def imports_within(file: Path, package: str) -> Iterator[tuple[str, str]]:
    """(module, name) of all that a file imports from its own package, wherever in the file.

    A module that is itself imported, as by `from package.folder import module`, comes with the name "".
    """
    known = names(package)
    for node in ast.walk(tree(file)):
        found: list[tuple[str, str]] = []
        if isinstance(node, ast.Import):
            found = [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            inside = [(f"{node.module}.{alias.name}", alias.name) for alias in node.names]
            found = [(full, "") if full in known else (node.module, name) for full, name in inside]
        yield from ((module, name) for module, name in found if module.split(".")[0] == package)


def repeated(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """name -> where, of (name, where) pairs whose name comes more than once."""
    places: dict[str, list[str]] = {}
    for name, where in pairs:
        places.setdefault(name, []).append(where)
    return {name: where for name, where in places.items() if len(where) > 1}


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_imports_the_command_line(package: str) -> None:
    wrong = [
        f"{name_of(file, package)} imports {module}"
        for file in modules(package)
        for module, _ in imports_within(file, package)
        if f"{module}.".startswith(f"{package}.cli.") and not name_of(file, package).startswith(f"{package}.cli")
    ]
    assert not wrong


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_private_is_imported(package: str) -> None:
    wrong = [
        f"{name_of(file, package)} imports {name} from {module}"
        for file in modules(package)
        for module, name in imports_within(file, package)
        if name.startswith("_") and not name.startswith("__")
    ]
    assert not wrong


@pytest.mark.parametrize("package", PACKAGES)
def test_no_modules_import_each_other(package: str) -> None:
    """Neither at once nor by way of others, wherever in the file the import stands."""
    needs = {
        name_of(file, package): {module for module, _ in imports_within(file, package)} for file in modules(package)
    }
    try:
        tuple(TopologicalSorter(needs).static_order())
    except CycleError as error:
        pytest.fail(f"import cycle: {' -> '.join(error.args[1])}")


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_stands_for_one_module(package: str) -> None:
    """Besides `__init__` and `__main__`, and a folder's own main module, as `recording/recording.py`."""
    files = [file for file in modules(package) if not file.stem.startswith("__") and file.stem != file.parent.name]
    folders = {file.parent for file in modules(package)} - {ROOT / "src" / package / package}
    assert repeated((path.stem, str(path.relative_to(ROOT))) for path in (*files, *sorted(folders))) == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_stands_for_one_class(package: str) -> None:
    classes = (
        (node.name, str(file.relative_to(ROOT)))
        for file in modules(package)
        for node in tree(file).body
        if isinstance(node, ast.ClassDef)
    )
    assert repeated(classes) == {}


def numeric(node: ast.expr) -> bool:
    """Whether an expression is made of numbers only, as 2**63 - 1."""
    leaves = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop)
    parts = list(ast.walk(node))
    constants = [part.value for part in parts if isinstance(part, ast.Constant)]
    return all(isinstance(part, leaves) for part in parts) and all(type(c) in (int, float) for c in constants)


def constants(package: str) -> Iterator[tuple[str, float, str]]:
    """(name, value, where) of every public constant that is one number."""
    for file in modules(package):
        for node in tree(file).body:
            for target in node.targets if isinstance(node, ast.Assign) else ():
                pairs = [(target, node.value)]
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs = list(zip(target.elts, node.value.elts, strict=True))
                for name, value in pairs:
                    if isinstance(name, ast.Name) and name.id.isupper() and name.id[0] != "_" and numeric(value):
                        number = eval(compile(ast.Expression(value), str(file), "eval"))
                        yield name.id, float(number), str(file.relative_to(ROOT))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_stands_for_one_number(package: str) -> None:
    places: dict[str, dict[float, str]] = {}
    for name, value, where in constants(package):
        places.setdefault(name, {}).setdefault(value, where)
    assert {name: values for name, values in places.items() if len(values) > 1} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_folders_import_each_other(package: str) -> None:
    """Neither at once nor by way of others; the modules beside the folders belong to none."""
    folders = {file.parent.name for file in modules(package)} - {package}
    needs: dict[str, set[str]] = {}
    for file in modules(package):
        own = file.parent.name
        for module, _ in imports_within(file, package):
            other = f"{module}.".split(".")[1]
            if own in folders and other in folders and own != other:
                needs.setdefault(own, set()).add(other)
    try:
        tuple(TopologicalSorter(needs).static_order())
    except CycleError as error:
        pytest.fail(f"import cycle: {' -> '.join(error.args[1])}")


@pytest.mark.parametrize("package", PACKAGES)
def test_no_source_file_is_long(package: str) -> None:
    lengths = {
        str(file.relative_to(ROOT)): len(file.read_text(encoding="utf-8").splitlines())
        for file in (ROOT / "src" / package).rglob("*.py")
    }
    assert {file: length for file, length in lengths.items() if length > LONGEST} == {}


def test_no_file_names_a_path_of_one_machine() -> None:
    path = re.compile(r"(?<![\w.])/(?:work|root|home/\w+|Users/\w+)/")
    wrong = [
        f"{file.relative_to(ROOT)}:{number}"
        for file in sources()
        if file.suffix in {".py", ".md", ".yaml", ".yml", ".toml", ".txt", ".xml", ".bash", ".cfg", ""}
        for number, line in enumerate(file.read_text(encoding="utf-8", errors="replace").splitlines(), 1)
        if path.search(line) and file != Path(__file__).resolve()
    ]
    assert not wrong


def test_python_files_carry_their_licence() -> None:
    first = "# SPDX-License-Identifier: Apache-2.0"
    wrong = []
    for file in sources():
        if file.suffix == ".py":
            lines = [line for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#!")]
            if lines and lines[0] != first:
                wrong.append(str(file.relative_to(ROOT)))
    assert not wrong


def test_versions_are_pinned_once() -> None:
    names = []
    for file in ("requirements.txt", "requirements-ros.txt", "requirements-docs.txt"):
        lines = [line.split("#")[0].strip() for line in (ROOT / file).read_text().splitlines()]
        for line in filter(None, lines):
            match = re.fullmatch(r"([A-Za-z0-9._-]+)(?:\[[\w,-]+\])?==\S+", line)
            assert match, f"{file}: '{line}' is not pinned as NAME==VERSION"
            names.append(match[1].lower().replace("_", "-"))
    assert len(set(names)) == len(names)
