# SPDX-License-Identifier: Apache-2.0
"""Clusters of Dask: a real scheduler and workers on this machine, honest ones and others."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.conftest import CHECKOUT, NOW
from tests.keymint.executors.certificates import write_credentials
from tests.keymint.executors.key_material import key_material

pytestmark = [
    pytest.mark.dask,
    pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="the extra 'dask' is not installed"),
]

POLICY = CHECKOUT / "examples/talker_listener"


@dataclass
class Cluster:
    """A scheduler and its workers."""

    folder: Path
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)
    address: str = ""

    def start(self, name: str, *arguments: object) -> None:
        """Start a process of Dask."""
        command = [sys.executable, "-m", f"distributed.cli.dask_{name}", *map(str, arguments), "--no-dashboard"]
        environment = {**os.environ, "HOSTILE_WORKER": str(self.order)}
        with self.folder.joinpath(f"{name}{len(self.processes)}.log").open("wb") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, env=environment, cwd=self.folder)
        self.processes.append(process)

    @property
    def order(self) -> Path:
        """The file that tells workers what to do."""
        return self.folder / "order"

    def stop(self) -> None:
        """Kill everything."""
        for process in self.processes:
            process.kill()
            process.wait()


@contextlib.contextmanager
def started(folder: Path, workers: int, *options: object, protocol: str = "tcp") -> Iterator[Cluster]:
    """Start a scheduler, which listens when this returns, and workers, which connect later."""
    cluster = Cluster(folder)
    cluster.order.write_text("")
    written = folder / "scheduler.json"
    try:
        cluster.start("scheduler", "--host", f"{protocol}://127.0.0.1:0", "--scheduler-file", written, *options)
        until(lambda: written.exists() and written.read_bytes().rstrip().endswith(b"}"))
        cluster.address = json.loads(written.read_bytes())["address"].partition("://")[2]
        for _ in range(workers):
            cluster.start(
                "worker", f"{protocol}://{cluster.address}", "--nworkers", 1, "--nthreads", 1, "--no-nanny",
                "--host", "127.0.0.1", "--local-directory", folder,
                "--preload", Path(__file__).with_name("hostile_worker.py"), *options,
            )  # fmt: skip
        yield cluster
    finally:
        cluster.stop()


def keymint(folder: Path, *arguments: object, env: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    process = start_keymint(folder, *arguments, env=env)
    out, err = process.communicate(timeout=100)
    return subprocess.CompletedProcess([str(process.pid)], process.returncode, out, err)


def start_keymint(folder: Path, *arguments: object, env: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "keymint", *map(str, arguments)], cwd=folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "SOURCE_DATE_EPOCH": str(NOW), "PYTHONPATH": str(CHECKOUT), **(env or {})},
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a workspace ``ws``."""
    folder = tmp_path_factory.mktemp("dask")
    assert keymint(folder, "provision", POLICY, "-w", "ws", "-q").returncode == 0
    return folder


@pytest.fixture(scope="module")
def shared_cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with started(tmp_path_factory.mktemp("cluster"), 2) as cluster:
        yield cluster


@pytest.fixture
def cluster(shared_cluster: Cluster) -> Iterator[Cluster]:
    """Two workers, which are honest at first."""
    yield shared_cluster
    shared_cluster.order.write_text("")


QUESTIONS: Mapping[str, tuple[str, ...]] = {
    "verify": ("verify", "-w", "ws", "-t", "omg", "-t", "cyclonedds-0.10", "--json"),
    "prove": ("prove", "-w", "ws", "--json"),
}
"""Calls that compute on a cluster."""


class Relay:
    """Passes on what a client and a scheduler say to each other, and keeps it."""

    def __init__(self, target: str) -> None:
        host, _, port = target.partition(":")
        self._target = (host, int(port))
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self.heard = {"to": bytearray(), "from": bytearray()}
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with client, socket.create_connection(self._target) as scheduler:
            back = threading.Thread(target=self._pass_on, args=(scheduler, client, "from"), daemon=True)
            back.start()
            self._pass_on(client, scheduler, "to")
            back.join()

    def _pass_on(self, source: socket.socket, sink: socket.socket, way: str) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                self.heard[way] += data
                sink.sendall(data)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        self._server.close()


@pytest.mark.parametrize("verb", QUESTIONS)
def test_a_cluster_gives_the_bytes_of_a_local_run_and_hears_no_key(verb: str, folder: Path, cluster: Cluster) -> None:
    call = QUESTIONS[verb]
    record = folder / "ws/.keymint/state.json"
    record.unlink(missing_ok=True)  # else proofs are cached
    here = keymint(folder, *call)
    record.unlink(missing_ok=True)
    relay = Relay(cluster.address)
    try:
        there = keymint(folder, *call, "--executor", f"dask://{relay.address}")
    finally:
        relay.close()
    assert (there.returncode, there.stdout, there.stderr) == (here.returncode, here.stdout, here.stderr)
    assert b"carry_out" in relay.heard["to"], "nothing was sent to the cluster"
    assert b"/talker" in relay.heard["to"], "the relay cannot read what was sent"
    secrets = key_material(folder / "ws")
    assert len(secrets) > 10
    assert [name for name, secret in secrets.items() if secret in relay.heard["to"]] == []


def documents(workspace: Path) -> dict[str, bytes]:
    return {str(each.relative_to(workspace)): each.read_bytes() for each in sorted(workspace.glob("build/**/*.xml"))}


def test_what_a_cluster_compiled_is_signed_as_if_it_were_compiled_here(folder: Path, cluster: Cluster) -> None:
    relay = Relay(cluster.address)
    try:
        done = keymint(folder, "provision", POLICY, "-w", "there", "-q", "--executor", f"dask://{relay.address}")
    finally:
        relay.close()
    assert (done.returncode, done.stderr) == (0, "")
    assert b"rt/chatter" in relay.heard["from"], "the cluster compiled nothing"
    assert documents(folder / "there") == documents(folder / "ws")
    secrets = key_material(folder / "there")
    assert [name for name, secret in secrets.items() if secret in relay.heard["to"]] == []
    # Keys that are there already do not leave either.
    again = keymint(folder, "build", "-w", "there", "-f", "-q", "--executor", f"dask://{cluster.address}")
    assert again.returncode == 0, again


def test_what_a_cluster_compiled_wrongly_is_compiled_here(folder: Path, cluster: Cluster) -> None:
    cluster.order.write_text("widen")
    call = ("provision", POLICY, "-q", "--executor", f"dask://{cluster.address}", "-w")
    assert keymint(folder, *call, "wrong").returncode == 0
    assert documents(folder / "wrong") == documents(folder / "ws")
    assert keymint(folder, *call, "trusted", "--trust-executor").returncode == 0
    assert b"rt/other" in b"".join(documents(folder / "trusted").values()), "trust makes no difference"


def test_documents_of_a_cluster_are_not_signed_without_a_proof(folder: Path, cluster: Cluster) -> None:
    done = keymint(
        folder, "provision", POLICY, "-w", "none", "-q", "--no-prove", "--executor", f"dask://{cluster.address}"
    )
    assert done.returncode == 2
    assert "--trust-executor" in done.stderr
    assert not (folder / "none").exists()


def refused(folder: Path, cluster: Cluster, order: str) -> tuple[subprocess.CompletedProcess[str], bool]:
    """Run a verb while the workers are hostile; return whether its process unpickled what they sent."""
    cluster.order.write_text(order)
    done = keymint(folder, *QUESTIONS["verify"][:-1], "--executor", f"dask://{cluster.address}")
    return done, (cluster.folder / f"read-by-{done.args[0]}").exists()


def one_line(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode == 1, done
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("error: ")
    for word in words:
        assert word in done.stderr


@pytest.mark.parametrize("order", ["object", "exception"])
def test_a_pickle_from_a_worker_is_not_read(order: str, folder: Path, cluster: Cluster) -> None:
    done, read = refused(folder, cluster, order)
    assert not read
    one_line(done, "is lost")


def test_a_pickle_in_an_event_is_not_read(folder: Path, cluster: Cluster) -> None:
    done, read = refused(folder, cluster, "event")
    assert not read
    assert done.returncode == 0, done


def test_without_the_guard_dask_reads_such_pickles(folder: Path, cluster: Cluster) -> None:
    """The attacks of these tests work: Dask's options for serializers do not keep a client from unpickling."""
    cluster.order.write_text("exception")
    client = f"""
import os, distributed
from keymint.executors import cluster as worker
client = distributed.Client("tcp://{cluster.address}", serializers=["msgpack"], deserializers=["msgpack"])
try: client.submit(worker.carry_out, b"").result()
except Exception: pass
print(os.getpid())
client.close()
"""
    run = subprocess.run([sys.executable, "-c", client], cwd=folder, capture_output=True, text=True, check=False)
    assert (cluster.folder / f"read-by-{run.stdout.split()[0]}").exists(), run.stderr


def test_tls_needs_client_certificates_and_works_with_them(folder: Path, tmp_path: Path) -> None:
    env = write_credentials(tmp_path)
    options = (
        "--protocol", "tls", "--tls-ca-file", tmp_path / "ca.pem", "--tls-cert", tmp_path / "cluster.pem",
        "--tls-key", tmp_path / "cluster.key",
    )  # fmt: skip
    with started(tmp_path, 1, *options, protocol="tls") as cluster:
        call = (*QUESTIONS["verify"], "--executor", f"tls://{cluster.address}")
        with_certificate = keymint(folder, *call, env=env)
        assert with_certificate.stdout == keymint(folder, *QUESTIONS["verify"]).stdout, with_certificate.stdout
        one_line(keymint(folder, *call[:-3], *call[-2:]), "needs a client certificate")


def test_a_worker_that_is_killed_changes_nothing(folder: Path, cluster: Cluster) -> None:
    cluster.order.write_text("die once")
    done = keymint(folder, "provision", POLICY, "-w", "killed", "-q", "--executor", f"dask://{cluster.address}")
    assert any(process.poll() is not None for process in cluster.processes), "no worker died"
    assert (done.returncode, done.stderr) == (0, "")
    assert documents(folder / "killed") == documents(folder / "ws")


def test_a_scheduler_that_is_lost_ends_the_run(folder: Path, cluster: Cluster) -> None:
    cluster.order.write_text("wait")
    call = ("provision", POLICY, "-w", "lost", "-q", "--executor", f"dask://{cluster.address}")
    running = start_keymint(folder, *call)
    until(cluster.order.with_name("waiting").exists)
    cluster.processes[0].send_signal(signal.SIGKILL)
    out, err = running.communicate(timeout=60)
    one_line(subprocess.CompletedProcess([], running.returncode, out, err), f"{cluster.address} is lost")
    assert not (folder / "lost").exists()


def until(happened: Callable[[], bool]) -> None:
    for _ in range(600):
        if happened():
            return
        time.sleep(0.1)
    pytest.fail("it did not happen within a minute")
