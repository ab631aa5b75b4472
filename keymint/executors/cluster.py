# SPDX-License-Identifier: Apache-2.0
"""A pool on a cluster of Dask: the machines compute, and never see a secret.

The cluster is outside of the trust of the workspace's authorities. Dask's own options keep it from sending pickles as
results, but not as exceptions, types and messages (measured with Dask 2026.8), so unpickling is refused as a whole.
"""

from __future__ import annotations

import contextlib
import functools
import ipaddress
import pickle
import socket
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from datetime import datetime
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from keymint.api.plugin_loader import Plugins, how_to_add
from keymint.errors import ExitCode, KeymintError
from keymint.executors import worker
from keymint.executors.pool import PARTS_FOR_EACH, Result, Task, Work, divide, in_order

if TYPE_CHECKING:
    from distributed import Client, Security

CONNECT_SECONDS = 5
"""How long to wait for the scheduler, for a first worker, and for workers to come back when all are lost."""
_HARMLESS = {("builtins", "bytes")}
"""What Dask pickles beside each result: its type."""
_CREDENTIALS = ("DASK_DISTRIBUTED__COMM__TLS__CA_FILE", "…CLIENT__CERT", "…CLIENT__KEY")


class Cluster:
    """Implements :class:`keymint.executors.Pool` on an executor for bytes.

    Args:
        plugins: the installed plugins.
        now: the clock of the run, UTC.
        executor: calls :func:`keymint.executors.worker.carry_out` elsewhere.
        size: number of tasks that it carries out at a time.
        trusted: the user trusts the cluster like this machine.
    """

    shares_memory = False

    def __init__(self, plugins: Plugins, now: datetime, executor: Executor, size: int, *, trusted: bool) -> None:
        self._installed, self._now, self._executor = worker.versions(plugins), now, executor
        self.size = size
        self.trusted = trusted

    def parts(self, items: Sequence[Task], least: int) -> list[Sequence[Task]]:
        """See :meth:`keymint.executors.Pool.parts`; the user wants all of them to be carried out there."""
        del least
        return divide(items, max(1, min(self.size * PARTS_FOR_EACH, len(items))))

    def map(self, work: Work[Task, Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """See :meth:`keymint.executors.Pool.map`."""

        def submit(task: Task) -> Future[bytes]:
            return self._executor.submit(worker.carry_out, worker.request(work, task, self._now, self._installed))

        for future in in_order(submit, tasks, PARTS_FOR_EACH * self.size):
            yield worker.result_of(work, future.result(), self._installed)


@contextlib.contextmanager
def cluster(
    address: str, plugins: Plugins, now: datetime, environment: Mapping[str, str], *, trusted: bool
) -> Iterator[Cluster]:
    """Connect to a scheduler of Dask.

    Args:
        address: ``dask://HOST:PORT`` or ``tls://HOST:PORT``.
        plugins: the installed plugins.
        now: the clock of the run, UTC.
        environment: environment variables, which configure Dask.
        trusted: the user trusts the cluster like this machine.

    Raises:
        KeymintError: the address is refused, Dask is not installed, or the cluster cannot be reached.
    """
    scheme, place = _parsed(address)
    try:
        import dask  # noqa: PLC0415 - slow, and an extra
        import distributed  # noqa: PLC0415
    except ImportError as error:
        raise KeymintError(
            "clusters need Dask, which is not installed", help=how_to_add("distributed"), code="executor-missing"
        ) from error
    dask.config.refresh(env=environment)
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"})
    with _silent(), _no_pickles(), contextlib.ExitStack() as closing:
        try:
            client = closing.enter_context(
                distributed.Client(
                    f"{scheme}://{place}",
                    security=_security(distributed.Security, address) if scheme == "tls" else None,
                    timeout=CONNECT_SECONDS,
                    set_as_default=False,
                    direct_to_workers=False,
                    serializers=["msgpack"],
                    deserializers=["msgpack"],
                )
            )
            client.wait_for_workers(1, CONNECT_SECONDS)
            threads = sum(client.nthreads().values())
        except Exception as error:
            raise _lost(address, error) from error
        executor = _DaskExecutor(client, address, PARTS_FOR_EACH * threads)
        try:
            yield Cluster(plugins, now, executor, threads, trusted=trusted)
        finally:
            executor.shutdown(wait=False, cancel_futures=True)


def _parsed(address: str) -> tuple[str, str]:
    """Return how Dask names the protocol and the place of a scheduler.

    Raises:
        KeymintError: the address is none, or names another machine without TLS.
    """
    scheme, host, port = "", None, None
    with contextlib.suppress(ValueError):
        split = urlsplit(address)
        scheme, host, port = split.scheme, split.hostname, split.port
    if scheme not in {"dask", "tls"} or not host or not port:
        raise KeymintError(
            f"no executor {address!r}",
            help="expected processes, dask://HOST:PORT, or tls://HOST:PORT",
            code="executor-address",
            exit_code=ExitCode.USAGE,
        )
    if scheme == "dask":
        try:
            found = [ipaddress.ip_address(str(each[4][0])) for each in socket.getaddrinfo(host, None)]
        except OSError as error:
            raise KeymintError(f"the host {host} is not known: {error.strerror}", code="executor-lost") from error
        if not all(each.is_loopback for each in found):
            raise KeymintError(
                f"{address} is on the network, where others could read the work and change the answers",
                help=f"use tls://{host}:{port} with client certificates, or a scheduler on this machine",
                code="executor-tls",
            )
        # The name is not looked up again: it could be another machine by then.
        scheme, host = "tcp", str(found[0])
    return scheme, f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _security(kind: type[Security], address: str) -> Security:
    """Return the credentials that Dask's configuration names.

    Raises:
        KeymintError: one is missing.
    """
    security = kind(require_encryption=True)
    if not (security.tls_ca_file and security.tls_client_cert and security.tls_client_key):
        raise KeymintError(
            f"{address} needs a client certificate, its key and the authority of the cluster",
            help=f"name their files in Dask's configuration: {', '.join(_CREDENTIALS)}",
            code="executor-tls",
        )
    return security


def _lost(address: str, error: BaseException) -> KeymintError:
    if isinstance(error, KeymintError):
        return error
    why = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    if error.args and isinstance(error.args[0], bytes):  # a pickled exception
        why = "a worker failed, or several died of the same work"
    return KeymintError(
        f"the cluster at {address} is lost: {why}",
        help="nothing was written; run the command again when the scheduler and its workers are back",
        code="executor-lost",
    )


class _DaskExecutor(Executor):
    """Submits to Dask; a thread waits for each task, so that a failure of any kind reaches the caller."""

    def __init__(self, client: Client, address: str, most: int) -> None:
        self._client = client
        self._address = address
        self._threads = ThreadPoolExecutor(most)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """See :meth:`concurrent.futures.Executor.submit`."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return self._threads.submit(self._wait, self._client.submit(fn, *args, **kwargs, pure=False))

    def _wait(self, future: Any) -> Any:
        try:
            while True:
                with contextlib.suppress(TimeoutError):
                    return future.result(timeout=CONNECT_SECONDS)
                self._client.wait_for_workers(1, CONNECT_SECONDS)
        except BaseException as error:
            raise _lost(self._address, error) from error

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See :meth:`concurrent.futures.Executor.shutdown`."""
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)


# -- a guard around the library --------------------------------------------------------------------------------------


class RefusedPickleError(pickle.UnpicklingError, TypeError):
    """The cluster sent a pickle that names a class or function. Dask expects a TypeError if it cannot read one."""


_guarded = threading.Event()


@contextlib.contextmanager
def _no_pickles() -> Iterator[None]:
    """Refuse pickles that name classes or functions, in all threads but this one: those of Dask."""
    _hook()
    _guarded.set()
    try:
        yield
    finally:
        _guarded.clear()


@functools.cache
def _hook() -> None:
    """Let Python ask before it unpickles a class or function; this cannot be undone, so it is done once."""
    sys.addaudithook(_refuse)


def _refuse(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "pickle.find_class" or not _guarded.is_set() or tuple(arguments) in _HARMLESS:
        return
    if threading.current_thread() is not threading.main_thread():
        raise RefusedPickleError("pickles from a cluster are not read")


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep Dask and its libraries from writing to the terminal: what the user must know is an error of ours."""
    import logging  # noqa: PLC0415 - nothing else here needs it

    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)
