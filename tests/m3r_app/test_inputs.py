"""Inputs that break while they are played: one sentence, whatever task it came from."""

from __future__ import annotations

import time

import pytest

from m3r_app.inputs import InputError, Inputs, Senses


async def test_a_voice_that_breaks_off_is_one_sentence_and_no_group() -> None:
    class Torn:
        async def play(self, *_: object) -> None:
            raise InputError("the voice can no longer be heard (it broke): start again")

    inputs = Inputs(voice=Torn())  # type: ignore[arg-type]
    with pytest.raises(InputError, match="start again"):
        await inputs.play(time.monotonic, lambda _request: None, Senses())
