# SPDX-License-Identifier: Apache-2.0
"""A pool on a cluster of Dask: the machines compute, and never see a secret.

The cluster is outside of the trust of the workspace's authorities. Dask's own options keep it from sending pickles as
results, but not as exceptions, types and messages (measured with Dask 2026.8), so unpickling is refused as a whole.

What a worker carries out (:func:`carry_out`) is a request as bytes, answered as bytes. Answers are JSON of data types.
Unlike a pickle, an answer cannot make its reader carry out anything: it is read as data of the one type that is
expected, field by field.
"""

from __future__ import annotations

import contextlib
import functools
import ipaddress
import json
import pickle
import socket
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints
from urllib.parse import urlsplit

import msgspec

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint import __version__
from keymint.api import Environment
from keymint.api.plugin_loader import Plugins, how_to_add
from keymint.errors import ExitCode, KeymintError
from keymint.executors.pool import PARTS_FOR_EACH, Pool, Result, Task, Work, in_order

if TYPE_CHECKING:
    from distributed import Client, Security


# -- what a worker does ----------------------------------------------------------------------------------------------


def dump(value: object) -> bytes:
    """Return a value of data types as JSON."""
    # The library does not write names that are not UTF-8; JSON's own escapes can.
    return json.dumps(msgspec.to_builtins(value, enc_hook=_plain), separators=(",", ":")).encode()


def load(content: object, kind: Any) -> Any:
    """Return the value of a type that :func:`dump` wrote.

    Raises:
        KeymintError: the content is not bytes, not JSON, or not of this type.
    """
    why = f"a {type(content).__name__} in place of bytes"
    if isinstance(content, bytes):
        try:
            return msgspec.convert(json.loads(content), kind, dec_hook=_path)
        except (ValueError, RecursionError, msgspec.ValidationError) as error:
            why = str(error)
    raise KeymintError(
        f"a worker answered something else than it was asked: {why}",
        help="find out what runs on the cluster before you use it again",
        code="executor-answer",
    )


def _plain(value: object) -> object:
    if isinstance(value, Path):
        return str(value)
    raise NotImplementedError(type(value).__name__)


def _path(kind: type, value: object) -> object:
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise NotImplementedError(kind.__name__)


DONE, REFUSED = b"+", b"-"
"""How an answer begins."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a worker has no result.

    Attributes:
        diagnostics: the errors of the work.
        exit_code: its exit code.
        versions: what the worker has installed, if the user has something else.
    """

    diagnostics: tuple[Diagnostic, ...] = ()
    exit_code: ExitCode = ExitCode.FAILURE
    versions: str = ""


def versions(plugins: Plugins) -> str:
    """Return what must be the same here and on a worker, a line each."""
    return f"keymint/{__version__}\n{plugins.versions}"


def result_of(work: Work[Any, Any], answer: object, installed: str) -> Any:
    """Return the result in the answer to a request.

    Raises:
        KeymintError: the work failed, the worker has other versions, or the answer is none.
    """
    if isinstance(answer, bytes) and answer[:1] == DONE:
        return load(answer[1:], get_type_hints(work)["return"])
    refusal: Refusal = load(answer[1:] if isinstance(answer, bytes) else answer, Refusal)
    if refusal.diagnostics:
        raise KeymintError.of(refusal.diagnostics, refusal.exit_code)
    here, there = installed.splitlines(), refusal.versions.splitlines()
    raise KeymintError(
        f"a worker has {_first(there, here)}, where this machine has {_first(here, there)}",
        help="all machines need the same versions of Keymint and of its plugins",
        code="executor-version",
    )


def _first(lines: Sequence[str], others: Sequence[str]) -> str:
    return next((line for line in lines if line not in others), "nothing")


def request(work: Work[Any, Any], task: object, now: datetime, installed: str) -> bytes:
    """Return a request.

    Args:
        work: a function of a module.
        task: plain data without secrets.
        now: the clock of the run, UTC.
        installed: see :func:`versions`.
    """
    # The worker is told the versions before it reads anything that depends on them.
    return pickle.dumps((installed, now, pickle.dumps((work, task))))


def carry_out(content: bytes) -> bytes:
    """Carry out a request, and return the answer. It never raises: an exception would be pickled."""
    try:
        installed, now, inner = pickle.loads(content)  # noqa: S301 - from the user, whom a worker trusts
        plugins = _plugins(now)
        if (here := versions(plugins)) != installed:
            return REFUSED + dump(Refusal(versions=here))
        work, task = pickle.loads(inner)  # noqa: S301 - the same
        return DONE + dump(work(plugins, task))
    except KeymintError as error:
        return REFUSED + dump(Refusal(error.diagnostics, error.exit_code))
    except Exception as error:  # noqa: BLE001 - the user gets one line for our bugs too
        failed = KeymintError(f"a worker failed: {type(error).__name__}: {error}", code="executor-failed")
        return REFUSED + dump(Refusal(failed.diagnostics))


@functools.cache
def _plugins(now: datetime) -> Plugins:
    # No transport that runs on a worker builds programs, so none needs a cache or variables.
    return Plugins(environment=Environment(now, Path(tempfile.gettempdir()), {}))


# -- the pool --------------------------------------------------------------------------------------------------------

CONNECT_SECONDS = 5
"""How long to wait for the scheduler, for a first worker, and for workers to come back when all are lost."""
_HARMLESS = {("builtins", "bytes")}
"""What Dask pickles beside each result: its type."""
_CREDENTIALS = ("DASK_DISTRIBUTED__COMM__TLS__CA_FILE", "…CLIENT__CERT", "…CLIENT__KEY")


class Cluster(Pool):
    """A pool that sends bytes.

    Args:
        plugins: the installed plugins.
        now: the clock of the run, UTC.
        submit: lets another machine call :func:`carry_out`.
        size: number of tasks that it carries out at a time.
        trusted: the user trusts the cluster like this machine.
    """

    shares_memory = False

    def __init__(
        self, plugins: Plugins, now: datetime, submit: Callable[[bytes], Future[bytes]], size: int, *, trusted: bool
    ) -> None:
        super().__init__(plugins, size)
        self._installed, self._now, self._submit = versions(plugins), now, submit
        self.trusted = trusted

    def map(self, work: Work[Task, Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """See :meth:`keymint.executors.Pool.map`."""
        requests = (request(work, task, self._now, self._installed) for task in tasks)
        for future in in_order(self._submit, requests, PARTS_FOR_EACH * self.size):
            yield result_of(work, future.result(), self._installed)


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
    with _guarded_library(), contextlib.ExitStack() as closing:
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
        waiting = ThreadPoolExecutor(PARTS_FOR_EACH * threads)

        def submit(content: bytes) -> Future[bytes]:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return waiting.submit(_result, client, address, client.submit(carry_out, content, pure=False))

        try:
            yield Cluster(plugins, now, submit, threads, trusted=trusted)
        finally:
            waiting.shutdown(wait=False, cancel_futures=True)


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


def _result(client: Client, address: str, future: Any) -> Any:
    """Return the result of a task; a thread waits for each, so that a failure of any kind reaches the caller."""
    try:
        while True:
            with contextlib.suppress(TimeoutError):
                return future.result(timeout=CONNECT_SECONDS)
            client.wait_for_workers(1, CONNECT_SECONDS)
    except BaseException as error:
        raise _lost(address, error) from error


# -- a guard around the library --------------------------------------------------------------------------------------


class RefusedPickleError(pickle.UnpicklingError, TypeError):
    """The cluster sent a pickle that names a class or function. Dask expects a TypeError if it cannot read one."""


_guarded = threading.Event()


@contextlib.contextmanager
def _guarded_library() -> Iterator[None]:
    """Refuse pickles that name classes or functions, in all threads but this one: those of Dask.

    Dask and its libraries write nothing to the terminal meanwhile: what the user must know is an error of ours.
    """
    import logging  # noqa: PLC0415 - nothing else here needs it

    _hook()
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    _guarded.set()
    try:
        yield
    finally:
        _guarded.clear()
        logging.disable(before)


@functools.cache
def _hook() -> None:
    """Let Python ask before it unpickles a class or function; this cannot be undone, so it is done once."""
    sys.addaudithook(_refuse)


def _refuse(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "pickle.find_class" or not _guarded.is_set() or tuple(arguments) in _HARMLESS:
        return
    if threading.current_thread() is not threading.main_thread():
        raise RefusedPickleError("pickles from a cluster are not read")
