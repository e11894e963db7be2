"""Rooms for rays of tiles: nobody shares one, few are kept, and a part of one is a thread's own."""

import contextlib

import pytest

from warpdiff.compute.device import resolve_device
from warpdiff.render import gbuffer, pixel_filters


@pytest.fixture(autouse=True)
def none_kept(monkeypatch):
    monkeypatch.setattr(gbuffer, "_free", {kind: [] for kind in gbuffer._free})


def shared(parts, *, leaves_out=False, coloured=False):
    kind = gbuffer.BufferKind(leaves_out, coloured, materials=False)
    return gbuffer.shared_tile_buffers(parts, kind=kind, device=resolve_device("cpu"))


def test_a_room_is_found_again_where_it_is_large_enough():
    with shared(2) as first:
        assert first.parts == 2
        assert len(first.buffers.colours) >= 2 * pixel_filters.MOST_RAYS
    for parts in (1, 2):
        with shared(parts) as again:
            assert again is first
    with shared(3) as larger:
        assert larger is not first
    with shared(1, leaves_out=True) as other:
        assert other is not larger
        assert len(other.buffers.left_out) == len(other.buffers.colours)
    with shared(1, coloured=True) as other:
        assert other is not larger
        assert len(other.buffers.seen.pixels.base_colour) == len(other.buffers.colours)
    with shared(3) as again:
        assert again is larger


def test_nobody_shares_a_room_and_few_are_kept():
    with contextlib.ExitStack() as stack:
        taken = [stack.enter_context(shared(1)) for _ in range(5)]
        assert len(set(map(id, taken))) == 5
    assert len(gbuffer._free[False, False, False]) == 2


def test_a_room_where_something_failed_is_left():
    def fail():
        with shared(1):
            raise MemoryError

    with pytest.raises(MemoryError):
        fail()
    assert not gbuffer._free[False, False, False]
