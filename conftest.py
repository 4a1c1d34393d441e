# SPDX-License-Identifier: Apache-2.0
"""What all tests share: ROS domains of their own, and a second try and the machine to themselves for tests that run
against real time.
"""

import fcntl
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import count
from pathlib import Path

import pytest

RERUNS = 2
_failed = pytest.StashKey[bool]()
_worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
_firsts = count(os.getpid() + 50 * _worker)  # domains far from those of another worker, whose nodes may linger


def _domain() -> Iterator[int]:
    from eps_tunnel_analysis.nodes.domain import own_domain

    # Another one each time: what a killed node said may still linger on the last.
    with own_domain(next(_firsts)) as domain:
        yield domain


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine has, for one test."""
    yield from _domain()


@pytest.fixture(scope="module")
def module_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine has, for the tests of a file."""
    yield from _domain()


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput"):
        config.stash[_turns] = Turns(config.rootpath)
    # A shell's background job ignores Ctrl-C and hands that on to every child; some tests press it.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


class Turns:
    """Who may use the machine, of the workers of one run: real-time tests alone, all others side by side."""

    def __init__(self, root: Path) -> None:
        # Locked, never written: any two files that every worker finds.
        self._turn, self._machine = (root / "conftest.py").open(), (root / "pyproject.toml").open()
        self._alone = False

    @contextmanager
    def of(self, alone: bool, last: bool) -> Iterator[None]:
        """For one test; a file's tests that need the machine alone keep it until the `last` of them."""
        if not self._alone:
            # Who waits for the machine holds the turn meanwhile, lest the others hand it on among themselves.
            fcntl.flock(self._turn, fcntl.LOCK_EX)
            fcntl.flock(self._machine, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
            fcntl.flock(self._turn, fcntl.LOCK_UN)
            self._alone = alone
        try:
            yield
        finally:
            if last or not self._alone:
                fcntl.flock(self._machine, fcntl.LOCK_UN)
                self._alone = False


_turns = pytest.StashKey[Turns]()


def _alone(item: pytest.Item | None) -> bool:
    return item is not None and item.get_closest_marker("realtime") is not None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    # The real-time tests last, for they have the machine to themselves; the long ones first, for those fill it best.
    items.sort(key=lambda item: (_alone(item), item.path.parent != config.rootpath / "test"))
    if config.option.usepdb or not config.pluginmanager.hasplugin("rerunfailures"):
        return
    for item in items:
        if item.get_closest_marker("realtime"):
            item.add_marker(pytest.mark.flaky(reruns=RERUNS))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    turns = item.config.stash.get(_turns, None)
    last = not _alone(nextitem) or nextitem.path != item.path
    with turns.of(_alone(item), last) if turns else nullcontext():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    report = yield
    item.stash[_failed] = report.failed or (call.when != "setup" and item.stash.get(_failed, False))
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> None:
    """After a failure the processes of a file's fixtures are in an unknown state: they are ended, and begun anew."""
    if item.get_closest_marker("realtime") and item.stash.get(_failed, False):
        item.session._setupstate.teardown_exact(item.session)
