# SPDX-License-Identifier: Apache-2.0
"""What all tests share: ROS domains of their own; a second try, and precedence, for those against real time."""

import os
import signal
from collections.abc import Iterator
from itertools import count

import pytest
from domain_coordinator import domain_id

# It sets the threads of BLAS, and many tests import numpy before it: threads that wait for one another take the
# processors from the other workers.
import eps_tunnel_analysis  # noqa: F401

RERUNS = 2
NICE = 10  # of a worker's other tests
_failed = pytest.StashKey[bool]()
_numbers = count(os.getpid())


def _domain() -> Iterator[int]:
    # Another one each time: what a killed node said may still linger on the last.
    with domain_id(lambda: 1 + next(_numbers) % 100) as domain:
        yield domain


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine has, for one test."""
    yield from _domain()


@pytest.fixture(scope="module")
def module_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine has, for the tests of a file."""
    yield from _domain()


def pytest_configure() -> None:
    # A shell's background job ignores Ctrl-C and hands that on to every child; some tests press it.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _realtime(item: pytest.Item) -> bool:
    return item.get_closest_marker("realtime") is not None


def _shared(item: pytest.Item) -> str:
    """A name for those tests of a file that share its fixtures with the same parameters; empty without any."""
    definitions = item._fixtureinfo.name2fixturedefs
    names = [name for name, (*_, last) in definitions.items() if last.scope != "function" and last.baseid]
    given = getattr(getattr(item, "callspec", None), "indices", {})
    return " ".join([item.path.stem, *(f"{name}={given[name]}" for name in names if name in given)]) if names else ""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With workers, one takes all real-time tests, each of which wants most of the machine, the others the rest.

    Of the rest, one worker takes what needs the same fixture of a file, so that it is made once.
    """
    items.sort(key=lambda item: not _realtime(item))
    marks = []
    if config.pluginmanager.hasplugin("xdist"):
        marks.append(pytest.mark.xdist_group("realtime"))
        for item in items:
            if not _realtime(item) and (shared := _shared(item)):
                item.add_marker(pytest.mark.xdist_group(shared))
    if config.pluginmanager.hasplugin("rerunfailures") and not config.option.usepdb:
        marks.append(pytest.mark.flaky(reruns=RERUNS))
    for item in items:
        for mark in marks if _realtime(item) else ():
            item.add_marker(mark)


def pytest_runtest_setup(item: pytest.Item) -> None:
    # Real-time tests come first in their worker, so none of them ever runs at this lower priority.
    if hasattr(item.config, "workerinput") and not _realtime(item) and os.nice(0) < NICE:
        os.nice(NICE)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    report = yield
    item.stash[_failed] = report.failed or (call.when != "setup" and item.stash.get(_failed, False))
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> None:
    """After a failure the processes of a file's fixtures are in an unknown state: they are ended, and begun anew."""
    if _realtime(item) and item.stash.get(_failed, False):
        item.session._setupstate.teardown_exact(item.session)
