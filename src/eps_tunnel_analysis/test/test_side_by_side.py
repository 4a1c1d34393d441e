# SPDX-License-Identifier: Apache-2.0
import threading

import pytest

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, Stopped, side_by_side
from eps_tunnel_analysis.diagnose.progress import RolloutCount

DEADLINE = 20.0  # s, after which a test that hangs is given up


@pytest.mark.parametrize("nthread", [1, 2])
def test_answers_come_in_the_order_of_the_items(nthread: int) -> None:
    assert side_by_side(lambda item, run: 2 * item, [3, 1, 2], SearchOptions(None, nthread)) == [6, 2, 4]


def test_two_axes_are_searched_at_once() -> None:
    both = threading.Barrier(2)
    side_by_side(lambda item, run: both.wait(DEADLINE), ["x", "y"], SearchOptions(None, 2))


@pytest.mark.parametrize(("wrong", "other"), [("x", "y"), ("y", "x")])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_error_in_one_ends_the_others_at_their_next_rollouts(
    error: type[BaseException], wrong: str, other: str
) -> None:
    begun, ended = threading.Event(), []

    def search(item: str, run: SearchOptions) -> None:
        if item == wrong:
            assert begun.wait(DEADLINE)
            raise error
        begun.set()
        assert run.progress is not None
        try:
            for number in range(int(1000 * DEADLINE)):
                run.progress(item, number)
                threading.Event().wait(1e-3)
        except Stopped:
            ended.append(item)
            raise

    with pytest.raises(error):
        side_by_side(search, ["x", "y"], SearchOptions(None, 2))
    assert ended == [other]


def test_rollouts_of_searches_side_by_side_add_up() -> None:
    told: list[tuple[str, int, int]] = []
    count = RolloutCount(lambda *one: told.append(one), 100)
    for what, number in [("axis x", 5), ("axis y", 7), ("axis x", 9), ("axis x", 2), ("axis y", 8)]:
        count(what, number)
    assert [made for _, made, _ in told] == [5, 12, 16, 18, 19]  # the second search of x began at 0
    assert [of for *_, of in told] == [100] * 5
