"""A thread that works off a queue: nothing is lost, nobody waits, and it ends."""

from __future__ import annotations

import threading

from m3r_app.queue_thread import QueueThread


def test_all_that_was_put_in_is_worked_off_in_order_before_it_ends() -> None:
    done: list[int] = []
    items: QueueThread[int] = QueueThread("test", lambda: done.extend(items))
    for number in range(100):
        assert items.put(number)
    items.start()
    assert items.close(5.0)
    assert done == list(range(100))
    assert not items.alive


def test_what_comes_when_it_is_full_or_closed_is_dropped() -> None:
    done: list[int] = []
    items: QueueThread[int] = QueueThread("test", lambda: done.extend(items), longest=2)
    assert [items.put(number) for number in range(3)] == [True, True, False]
    assert items.waiting == 2
    items.start()
    assert items.close(5.0)
    assert not items.put(3)
    assert items.close(5.0), "closing twice is harmless"
    assert done == [0, 1]


def test_a_stuck_one_is_not_waited_for() -> None:
    free = threading.Event()
    items: QueueThread[int] = QueueThread("test", lambda: [free.wait(10.0) for _ in items] and None)
    items.start()
    items.put(1)
    assert not items.close(0.05)
    free.set()
    assert items.close(5.0)


def test_it_looks_up_where_nothing_comes() -> None:
    seen: list[int | None] = []
    looked = threading.Event()

    def work() -> None:
        for item in items.or_after(lambda: 0.01):
            seen.append(item)
            if item is None:
                looked.set()

    items: QueueThread[int] = QueueThread("test", work)
    items.put(7)
    items.start()
    assert looked.wait(5.0)
    assert items.close(5.0)
    assert seen[0] == 7
    assert set(seen[1:]) == {None}
