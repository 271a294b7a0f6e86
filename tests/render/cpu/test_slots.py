"""Slots for bricks: taken side by side, taken again, and given up with their array."""

from __future__ import annotations

import numpy as np

from clusterviz.render.cpu.memory import LEAST_CHUNK, Slots, Taken

WORDS = LEAST_CHUNK // 4 // 3  # so that the smallest array holds three


def address(slot: Taken) -> int:
    return int(slot.words.__array_interface__["data"][0])


def test_slots_lie_side_by_side_and_do_not_overlap() -> None:
    slots = Slots()
    slots.make_room(7000)
    taken = [slots.take(1000) for _ in range(7)]
    assert np.array_equal(np.diff([address(slot) for slot in taken]), [4000] * 6)
    for number, slot in enumerate(taken):
        slot.words[:] = number
    assert [slot.words.sum() for slot in taken] == [1000 * number for number in range(7)]


def test_more_are_made_when_none_is_free() -> None:
    slots = Slots()
    taken = [slots.take(WORDS) for _ in range(5)]
    assert len({address(slot) for slot in taken}) == 5
    assert slots.bytes == 5 * 4 * WORDS


def test_what_is_given_back_is_taken_again() -> None:
    slots = Slots()
    first, second = slots.take(WORDS), slots.take(WORDS)
    slots.give_back(first)
    # It is still memory that was written to.
    assert slots.bytes == 2 * 4 * WORDS
    assert address(slots.take(WORDS)) == address(first)
    assert slots.bytes == 2 * 4 * WORDS
    assert address(slots.take(WORDS)) not in (address(first), address(second))


def test_slots_of_other_sizes_take_what_was_given_back() -> None:
    slots = Slots()
    taken = [slots.take(words) for words in (100, 200, 300, 400)]
    for slot in (taken[1], taken[2]):
        slots.give_back(slot)
    assert address(slots.take(450)) == address(taken[1]), "both parts together"
    assert address(slots.take(50)) == address(taken[1]) + 4 * 450
    assert address(slots.take(50)) == address(taken[3]) + 4 * 400
    assert slots.bytes == 4 * 1050


def test_an_array_goes_with_its_last_slot() -> None:
    slots = Slots()
    taken = [slots.take(WORDS) for _ in range(5)]
    for slot in taken[:3]:
        slots.give_back(slot)
    assert slots.bytes == 2 * 4 * WORDS
    for slot in taken[3:]:
        slots.give_back(slot)
    assert slots.bytes == 0
