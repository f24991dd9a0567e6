"""Push-to-talk: closed at first, Enter toggles it, and what is gone closes it."""

from __future__ import annotations

import os
import queue
import threading

from modalities.voice.push_to_talk import PushToTalk


def test_it_is_closed_until_it_is_opened_and_says_so() -> None:
    said: list[str] = []
    talk = PushToTalk(said.append)
    talk.close()
    assert (talk.talking(), said) == (False, [])
    talk.toggle()
    assert talk.talking()
    talk.toggle()
    assert not talk.talking()
    assert [sentence.partition(":")[0] for sentence in said] == [
        "the microphone is open",
        "the microphone is closed, a spoken stop too is not heard",
    ]


def test_enter_in_a_terminal_opens_and_closes_it() -> None:
    said: queue.Queue[str] = queue.Queue()
    talk = PushToTalk(said.put)
    ours, theirs = os.openpty()
    talk.follow(theirs)
    os.write(ours, b"left\n")
    assert "is open" in said.get(timeout=5.0)
    assert talk.talking()
    os.write(ours, b"\n")
    assert "is closed" in said.get(timeout=5.0)
    os.write(ours, b"\n")
    assert "is open" in said.get(timeout=5.0)
    os.close(ours)  # the terminal is gone
    assert "is closed" in said.get(timeout=5.0)
    assert not talk.talking()
    os.close(theirs)
    assert all(thread.name != "push-to-talk" or not thread.is_alive() for thread in threading.enumerate())
