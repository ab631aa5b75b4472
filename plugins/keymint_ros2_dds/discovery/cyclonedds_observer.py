# SPDX-License-Identifier: Apache-2.0
"""Observe a DDS domain through the built-in topics of Cyclone DDS 0.10, by ctypes.

Cyclone DDS reads its network configuration from ``CYCLONEDDS_URI``, as for any application. The capture includes
participants and endpoints that disappear again, but not what discovery protection hides.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from ctypes import POINTER, Structure, byref, c_bool, c_char_p, c_int32, c_int64, c_size_t, c_uint32, c_uint64, c_void_p
from functools import cache, partial
from threading import Event
from typing import Any

from comarmor.values import replace
from keymint.api import Availability, DiscoveredGraph
from keymint.errors import Diagnostic, KeymintError
from keymint_ros2_dds.discovery.capture import DiscoveredEndpoint, DiscoveredParticipant, discovered_graph

LIBRARY = "libddsc.so.0debian"
INSTALL = "apt-get install libddsc0debian"
_OTHER_NAMES = ("libddsc.so.0",)
_PARTICIPANTS, _PUBLICATIONS, _SUBSCRIPTIONS = 0x7FFF0001, 0x7FFF0003, 0x7FFF0004
"""Pseudo handles of the built-in topics (``DDS_BUILTIN_TOPIC_…``)."""
_SAMPLES = 64
_PAUSE = 0.02
"""Seconds between two calls of ``go_on``."""


class _Guid(Structure):
    _fields_ = [("octets", ctypes.c_uint8 * 16)]

    def __str__(self) -> str:
        return bytes(self.octets).hex()


class _Participant(Structure):
    """``dds_builtintopic_participant_t``."""

    _fields_ = [("key", _Guid), ("qos", c_void_p)]


class _Endpoint(Structure):
    """``dds_builtintopic_endpoint_t``."""

    _fields_ = [
        ("key", _Guid),
        ("participant", _Guid),
        ("participant_handle", c_uint64),
        ("topic", c_char_p),
        ("type", c_char_p),
        ("qos", c_void_p),
    ]


class _Info(Structure):
    """``dds_sample_info_t``."""

    _fields_ = [
        ("sample_state", c_int32),
        ("view_state", c_int32),
        ("instance_state", c_int32),
        ("valid_data", c_bool),
        ("source_timestamp", c_int64),
        ("instance_handle", c_uint64),
        ("publication_handle", c_uint64),
        ("counts", c_uint32 * 5),
    ]


_Callback = ctypes.CFUNCTYPE(None, c_int32, c_void_p)
"""``dds_on_data_available_fn``: a reader, and an argument that is not used."""


@cache
def library() -> Any:
    """Return the library, with its functions declared.

    Raises:
        OSError: it is not installed, or lacks a function.
    """
    for name in (LIBRARY, *_OTHER_NAMES):
        try:
            loaded = ctypes.CDLL(name)
            break
        except OSError:
            continue
    else:
        raise OSError(f"{LIBRARY} is not installed")
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "dds_create_participant": (c_int32, [c_uint32, c_void_p, c_void_p]),
        "dds_create_reader": (c_int32, [c_int32, c_int32, c_void_p, c_void_p]),
        "dds_create_listener": (c_void_p, [c_void_p]),
        "dds_delete": (c_int32, [c_int32]),
        "dds_delete_listener": (None, [c_void_p]),
        "dds_free": (None, [c_void_p]),
        "dds_get_guid": (c_int32, [c_int32, POINTER(_Guid)]),
        "dds_lset_data_available": (None, [c_void_p, _Callback]),
        "dds_qget_entity_name": (c_bool, [c_void_p, POINTER(c_void_p)]),
        "dds_qget_partition": (c_bool, [c_void_p, POINTER(c_uint32), POINTER(POINTER(c_void_p))]),
        "dds_qget_userdata": (c_bool, [c_void_p, POINTER(c_void_p), POINTER(c_size_t)]),
        "dds_return_loan": (c_int32, [c_int32, POINTER(c_void_p), c_int32]),
        "dds_strretcode": (c_char_p, [c_int32]),
        "dds_take": (c_int32, [c_int32, POINTER(c_void_p), POINTER(_Info), c_size_t, c_uint32]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(loaded, name, None)
        if function is None:
            raise OSError(f"{loaded._name} has no {name}")  # noqa: SLF001 - its file name
        function.restype, function.argtypes = result, arguments
    return loaded


def library_availability() -> Availability:
    """Return whether the library is installed."""
    try:
        library()
    except OSError as error:
        return Availability(usable=False, reason=str(error), help=INSTALL)
    return Availability(usable=True, version="0.10")


def observe(domain: int, go_on: Callable[[], bool], names: Mapping[str, str]) -> DiscoveredGraph:
    """Return the graph of all participants and endpoints that appear in a domain; a warning if there are none.

    Args:
        domain: DDS domain id.
        go_on: called every 20 ms; the observation ends when it returns False.
        names: subjects that the user gives, by GUID or the beginning of one.

    Raises:
        KeymintError: Cyclone DDS is not installed, or cannot join the domain.
    """
    available = library_availability()
    if not available.usable:
        raise KeymintError(available.reason, help=available.help, code="discovery-unusable")
    with closing(_Observer(domain)) as observer:
        observer.listen()
        pause = Event()
        while go_on():
            pause.wait(_PAUSE)
        observed = discovered_graph(*observer.capture(), names)
    if observed.graph.subjects:
        return observed
    help_ = "check --domain, --seconds, CYCLONEDDS_URI and the network; secured participants are invisible"
    nothing = Diagnostic.warning("discovery-empty", f"no participant seen in domain {domain}", help=help_)
    return replace(observed, diagnostics=(*observed.diagnostics, nothing))


class _Observer:
    """A participant that listens to the built-in topics.

    It uses listeners, not polling, because samples of a participant that disappears are lost if not taken before. The
    listeners run in threads of Cyclone DDS; each adds to its own dictionary.
    """

    def __init__(self, domain: int) -> None:
        self._domain = domain
        self._participants: dict[str, DiscoveredParticipant] = {}
        self._endpoints: dict[DiscoveredEndpoint, None] = {}
        self._readers: list[tuple[int, Callable[[int], None]]] = []
        self._callbacks: list[Any] = []
        self._own = _checked(library().dds_create_participant(domain, None, None), f"join domain {domain}")

    def listen(self) -> None:
        """Begin to observe."""
        self._listen(_PARTICIPANTS, self._take_participants)
        self._listen(_PUBLICATIONS, partial(self._take_endpoints, "publish"))
        self._listen(_SUBSCRIPTIONS, partial(self._take_endpoints, "subscribe"))

    def close(self) -> None:
        """Delete the participant."""
        library().dds_delete(self._own)

    def _listen(self, topic: int, take: Callable[[int], None]) -> None:
        callback = _Callback(lambda reader, _: take(reader))
        self._callbacks.append(callback)  # must live as long as the reader does
        listener = library().dds_create_listener(None)
        try:
            library().dds_lset_data_available(listener, callback)
            reader = _checked(library().dds_create_reader(self._own, topic, None, listener), "read a built-in topic")
        finally:
            library().dds_delete_listener(listener)
        self._readers.append((reader, take))

    def _take_participants(self, reader: int) -> None:
        for sample in _taken(reader, _Participant):
            guid, name, data, size = str(sample.key), c_void_p(), c_void_p(), c_size_t()
            if sample.qos:
                library().dds_qget_entity_name(sample.qos, byref(name))
                library().dds_qget_userdata(sample.qos, byref(data), byref(size))
            user_data = _freed(data.value, size.value)
            self._participants[guid] = DiscoveredParticipant(guid, self._domain, _text(_freed(name.value)), user_data)

    def _take_endpoints(self, permission: str, reader: int) -> None:
        for sample in _taken(reader, _Endpoint):
            guid, topic, type_ = str(sample.participant), _text(sample.topic), _text(sample.type)
            self._endpoints[DiscoveredEndpoint(guid, permission, topic, type_, _partitions(sample.qos))] = None

    def capture(self) -> tuple[list[DiscoveredParticipant], list[DiscoveredEndpoint]]:
        """Return everything observed but the observer itself; a participant that was missed has no name."""
        for reader, take in self._readers:
            take(reader)
        own = _Guid()
        _checked(library().dds_get_guid(self._own, byref(own)), "tell its own GUID")
        participants, endpoints = self._participants.copy(), list(self._endpoints.copy())
        for endpoint in endpoints:
            participants.setdefault(endpoint.participant, DiscoveredParticipant(endpoint.participant, self._domain))
        return (
            [participant for guid, participant in participants.items() if guid != str(own)],
            [endpoint for endpoint in endpoints if endpoint.participant != str(own)],
        )


def _checked(code: int, what: str) -> int:
    if code < 0:
        reason = _text(library().dds_strretcode(code)) or str(code)
        message = f"Cyclone DDS cannot {what}: {reason}"
        raise KeymintError(message, help="look at CYCLONEDDS_URI and the network interfaces", code="discovery-failed")
    return code


def _taken(reader: int, kind: type[Any]) -> Iterator[Any]:
    """Yield the samples of a reader, including disposed ones; each is valid until the next."""
    infos = (_Info * _SAMPLES)()
    while True:
        samples = (c_void_p * _SAMPLES)()
        count = library().dds_take(reader, samples, infos, _SAMPLES, _SAMPLES)
        if count <= 0:
            return
        try:
            for index in range(count):
                address = samples[index]
                if infos[index].valid_data and address:
                    yield kind.from_address(address)
        finally:
            library().dds_return_loan(reader, samples, count)


def _text(raw: bytes | None) -> str:
    return (raw or b"").decode("utf-8", errors="replace")


def _partitions(qos: int | None) -> tuple[str, ...]:
    count, names = c_uint32(), POINTER(c_void_p)()
    if not qos or not library().dds_qget_partition(qos, byref(count), byref(names)) or not count.value:
        return ()
    addresses = [names[index] for index in range(count.value)]
    library().dds_free(names)
    return tuple(_text(_freed(address)) for address in addresses)


def _freed(address: int | None, size: int = -1) -> bytes:
    """Return the bytes at an address, up to a zero if there is no size, and free them; nothing without an address."""
    if not address:
        return b""
    try:
        return ctypes.string_at(address, size)
    finally:
        library().dds_free(address)
