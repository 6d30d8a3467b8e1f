"""Recordings and results in an S3 store, also while it answers errors."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from daemon.apps.reprocess.engine.dask_engine import DaskEngine, connected
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.locations import location, read_if_there, write_whole
from daemon.apps.reprocess.plan.recordings import recordings_of
from daemon.apps.reprocess.run import Run
from tests.daemon.apps.reprocess import cluster
from tests.daemon.apps.reprocess.takes import replayed, write
from tests.daemon.recording import small_take

pytest.importorskip("distributed")
pytest.importorskip("s3fs")
pytest.importorskip("flask", reason="the S3 server of the tests is moto's: pip install 'moto[server]'")
server_of_moto = pytest.importorskip("moto.server", reason="pip install 'moto[server]'")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240), pytest.mark.filterwarnings("default")]


class Failing:
    """A WSGI application in front of the server's that answers errors until some time."""

    def __init__(self, inner: object) -> None:
        self.inner, self.until_s, self.refused = inner, 0.0, 0

    def __call__(self, environ: dict[str, object], start: object) -> object:
        if time.monotonic() < self.until_s:
            self.refused += 1
            start("503 Service Unavailable", [("Content-Length", "0")])  # type: ignore[operator]
            return []
        return self.inner(environ, start)  # type: ignore[operator]


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Iterator[Failing]:
    """A server with the bucket ``rig``; keys and address in the environment, as users give them."""
    from werkzeug.serving import make_server

    application = Failing(server_of_moto.DomainDispatcherApplication(server_of_moto.create_backend_app))
    server = make_server("127.0.0.1", 0, application, threaded=True)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    for name, value in (
        ("AWS_ACCESS_KEY_ID", "test"), ("AWS_SECRET_ACCESS_KEY", "test"), ("AWS_DEFAULT_REGION", "us-east-1"),
        ("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.server_port}"),
    ):  # fmt: skip
        monkeypatch.setenv(name, value)
    location("s3://rig").mkdir()
    yield application
    server.shutdown()
    thread.join()


@contextmanager
def started(workers: int, folder: Path) -> Iterator[DaskEngine]:
    """A cluster with so many worker processes; with none, its only worker is a thread of this process."""
    from distributed import Client, LocalCluster

    if workers:
        with (
            cluster.scheduler(folder) as (_, address),
            cluster.workers(address, workers, folder),
            connected(address) as engine,
        ):
            yield engine
    else:
        with (
            LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as local,
            Client(local, set_as_default=False) as client,
        ):
            yield DaskEngine(client)


@pytest.mark.parametrize(("workers", "outage_s"), [(0, 3), pytest.param(2, 10, marks=pytest.mark.long)])
def test_workers_read_from_and_write_to_a_store_that_fails_for_seconds(
    store: Failing, tmp_path: Path, images: list[small_take.Images], workers: int, outage_s: float
) -> None:
    take = write(tmp_path / "a.mcap", images, 12)
    data = take.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    for name in ("a", "cut"):
        write_whole(location(f"s3://rig/in/{name}.mcap"), (tmp_path / f"{name}.mcap").read_bytes())

    def fail_once(totals: object) -> None:
        if store.until_s == 0 and getattr(totals, "computed", 0) > 2:
            store.until_s = time.monotonic() + outage_s

    with started(workers, tmp_path) as engine:
        run = Run(Job(chunk_pairs=2), location("s3://rig/out"), engine, observe=fail_once)
        totals = run.run(recordings_of(["s3://rig/in"]))
        assert not totals.failures, totals.failures
        assert store.refused > 0
        again = Run(Job(chunk_pairs=2), location("s3://rig/out"), engine).run(recordings_of(["s3://rig/in/*.mcap"]))
    assert (again.done, again.computed) == (totals.done, 0)
    for name in ("a", "cut"):
        expected = replayed(tmp_path / f"{name}.mcap")[0]
        assert len(expected) > 3
        for file, cloud in expected.items():
            assert read_if_there(location(f"s3://rig/out/{name}/{file}")) == cloud
