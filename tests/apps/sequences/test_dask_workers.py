"""Frames rendered by Dask workers equal those rendered locally, even if workers are killed; see ``make test-dask``."""

import os
import signal

import pytest

import warpdiff as wd

distributed = pytest.importorskip("distributed", reason="make test-dask installs Dask")

pytestmark = [pytest.mark.dask, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
LIGHT = wd.DirectionalLight((0.3, 1.0, 0.4))
VIEW = wd.View((0.0, 2.0, 3.0), (0.0, 0.0, 0.0), fov_y_deg=50.0, width=80, height=60)
SHOTS = wd.turntable(LIGHT, VIEW, count=16)


@pytest.fixture(scope="module")
def renderer():
    body = wd.meshes.tube(segments_along=24, segments_around=12)
    heightfield = wd.gratings.fingers(size_um=6.4)
    return wd.Renderer(body, heightfield, LIGHT, VIEW, tolerance=0.1, coherence=wd.Coherence(sigma_um=3.0), threads=1)


@pytest.fixture(scope="module")
def expected(renderer, tmp_path_factory):
    paths = wd.sequence(renderer, SHOTS, tmp_path_factory.mktemp("here"), formats=[".png", ".exr"])
    return [path.read_bytes() for path in paths]


@pytest.mark.parametrize(("workers", "killed"), [(1, 0), (2, 0), (2, 1), (1, 1)])
def test_frames_equal_those_rendered_locally(renderer, expected, tmp_path, workers, killed):
    options = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        left = list(client.run(os.getpid).values())[:killed]

        def kill(share):
            if share > 0.3 and left:
                os.kill(left.pop(), signal.SIGKILL)

        paths = wd.sequence(renderer, SHOTS, tmp_path / "turn", formats=[".png", ".exr"], client=client, progress=kill)
    assert not left
    assert [path.read_bytes() for path in paths] == expected


def test_an_error_of_a_worker_is_raised_and_existing_frames_stay(renderer, tmp_path):
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(**options, processes=False) as cluster, distributed.Client(cluster) as client:

        def stop(share):
            if share > 0.5:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            wd.sequence(renderer, SHOTS, tmp_path, client=client, progress=stop)
        there = {path: path.stat().st_mtime_ns for path in tmp_path.glob("frame_*")}
        assert len(there) == 9
        wd.sequence(renderer, SHOTS, tmp_path, client=client)
    assert {path: path.stat().st_mtime_ns for path in there} == there
    assert len(list(tmp_path.glob("frame_*"))) == 16
