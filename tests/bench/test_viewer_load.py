"""The load test of the viewer: its requests are valid, and it counts wrong pictures."""

import json
import struct

import pytest

pytest.importorskip("websockets", reason="warpdiff[view] installs websockets")
from bench.dev import viewer_load
from warpdiff.apps.viewer.controls import checked, controls


@pytest.mark.parametrize("scene", range(len(viewer_load.SCENES)))
def test_requests_have_values_that_the_viewer_accepts(scene):
    values = json.loads(viewer_load.message(1, scene))["values"]
    assert checked(controls(), values)["height"] == 240


def test_pictures_that_differ_from_the_first_one_are_counted():
    report = viewer_load.Report()
    for scene, picture in ((0, b"a"), (1, b"b"), (0, b"a"), (1, b"c")):
        report.compare(scene, picture)
    assert (report.counts["pictures"], report.counts["wrong pictures"]) == (4, 1)


def test_messages_are_split_into_json_and_data():
    head = json.dumps({"kind": "picture"}).encode()
    assert viewer_load.parts(struct.pack("<I", len(head)) + head + b"data") == ({"kind": "picture"}, b"data")
    assert viewer_load.parts('{"kind": "hello"}') == ({"kind": "hello"}, b"")
