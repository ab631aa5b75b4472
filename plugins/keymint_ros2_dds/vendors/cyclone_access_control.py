# SPDX-License-Identifier: Apache-2.0
"""Call the access-control plugin of Cyclone DDS 0.10 directly: no participant, no network, no handshake.

The shared object is the one that participants load. It exports ``init_access_control``, which fills a table of
functions (``dds_security_access_control`` in ``dds/security/dds_security_api_access_control.h``). Of its domain a
plugin only uses the queue of timed events, and that only after it is enabled, so a zeroed structure is enough. It only
requires that an authentication plugin is present, and reads the subject from the certificate itself.

A plugin instance keeps one set of local rights while it exists, hence one instance for each
:class:`CycloneAccessControl`.
"""

from __future__ import annotations

import ctypes
import functools
import os
import weakref
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from ctypes import POINTER, Structure, byref, c_char_p, c_int, c_int32, c_int64, c_ubyte, c_uint32, c_void_p
from pathlib import Path
from typing import Any

from comarmor.values import Data
from keymint_ros2_dds.enclave_layout import PERMISSIONS_CA, authority_file

_SONAMES = ("libddsc.so.0debian", "libddsc.so.0", "libddsc.so")
_FOLDERS = ("/usr/lib/*/libddsc*", "/usr/lib/*", "/usr/lib", "/usr/local/lib", "/opt/ros/*/lib", "/opt/ros/*/lib/*")
_ROOM_FOR_DOMAIN = 1 << 16
"""Bytes for a zeroed ``struct ddsi_domaingv``; the real one has about two thousand."""


class _String(Structure):
    _fields_ = (("maximum", c_uint32), ("length", c_uint32), ("buffer", POINTER(c_char_p)))


class _Property(Structure):
    _fields_ = (("name", c_char_p), ("value", c_char_p), ("propagate", c_ubyte))


class _PropertySeq(Structure):
    _fields_ = (("maximum", c_uint32), ("length", c_uint32), ("buffer", POINTER(_Property)))


class _EmptySeq(Structure):
    _fields_ = (("maximum", c_uint32), ("length", c_uint32), ("buffer", c_void_p))


class _Qos(Structure):
    _fields_ = (("properties", _PropertySeq), ("binary_properties", _EmptySeq), ("data_tags", _EmptySeq))


class _Exception(Structure):
    _fields_ = (("message", c_void_p), ("code", c_int32), ("minor_code", c_int32))


_VALIDATE_LOCAL_PERMISSIONS = ctypes.CFUNCTYPE(
    c_int64, c_void_p, c_void_p, c_int64, c_int32, POINTER(_Qos), POINTER(_Exception)
)
_CHECK_CREATE_PARTICIPANT = ctypes.CFUNCTYPE(c_ubyte, c_void_p, c_int64, c_int32, POINTER(_Qos), POINTER(_Exception))
_TOPIC = c_void_p, c_int64, c_int32, c_char_p, POINTER(_Qos)
_CHECK_CREATE_TOPIC = ctypes.CFUNCTYPE(c_ubyte, *_TOPIC, POINTER(_Exception))
_CHECK_CREATE_ENDPOINT = ctypes.CFUNCTYPE(c_ubyte, *_TOPIC, POINTER(_String), POINTER(_EmptySeq), POINTER(_Exception))


class _Plugin(Structure):
    """The head of ``struct dds_security_access_control``: the part of the table that is called."""

    _fields_ = (
        ("gv", c_void_p),
        ("validate_local_permissions", _VALIDATE_LOCAL_PERMISSIONS),
        ("validate_remote_permissions", c_void_p),
        ("check_create_participant", _CHECK_CREATE_PARTICIPANT),
        ("check_create_datawriter", _CHECK_CREATE_ENDPOINT),
        ("check_create_datareader", _CHECK_CREATE_ENDPOINT),
        ("check_create_topic", _CHECK_CREATE_TOPIC),
    )


class Library(Data):
    """The loaded shared objects of the plugin and of Cyclone DDS, and a domain for plugin instances."""

    core: ctypes.CDLL
    plugin: ctypes.CDLL
    domain: Any

    @property
    def folder(self) -> Path:
        """The folder of the security plugins, which on Debian is not on the loader's path."""
        return Path(self.plugin._name).parent  # noqa: SLF001 - where the loader found it


@functools.cache
def library() -> Library:
    """Return the plugin's shared object.

    Raises:
        OSError: Cyclone DDS, or its access-control plugin, is not installed.
    """
    core = _load_first(_SONAMES)
    found = [file for folder in _FOLDERS for file in sorted(Path("/").glob(f"{folder[1:]}/libdds_security_ac.so"))]
    plugin = _load_first([*map(str, found), "libdds_security_ac.so"])
    core.ddsrt_free.argtypes = [c_void_p]
    core.ddsrt_free.restype = None
    core.dds_set_log_mask(c_uint32(0))  # messages are also in the exception of each call
    plugin.init_access_control.argtypes = [c_char_p, POINTER(POINTER(_Plugin)), c_void_p]
    plugin.init_access_control.restype = c_int
    plugin.finalize_access_control.argtypes = [POINTER(_Plugin)]
    plugin.finalize_access_control.restype = c_int
    return Library(core, plugin, ctypes.create_string_buffer(_ROOM_FOR_DOMAIN))


def _load_first(names: Iterable[str]) -> ctypes.CDLL:
    *preferred, last = names
    for name in preferred:
        with suppress(OSError):
            return ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
    return ctypes.CDLL(last, mode=ctypes.RTLD_GLOBAL)


class CycloneAccessControl(AbstractContextManager["CycloneAccessControl"]):
    """Decides what one enclave may do in a domain, by the local checks of the access-control plugin.

    Use it as a context manager, or :meth:`close` it: that frees the plugin instance.

    Args:
        folder: the enclave, in the layout of sros2, current or of Ardent (one file for both authorities).
        domain: DDS domain id.

    Attributes:
        reason: the plugin's message about the last denial.
    """

    def __init__(self, folder: Path, domain: int = 0) -> None:
        self._library = library()
        self._domain = domain
        self._exception = _Exception()
        files = {
            b"dds.sec.auth.identity_certificate": "cert.pem",
            b"dds.sec.access.permissions_ca": authority_file(folder, PERMISSIONS_CA),
            b"dds.sec.access.governance": "governance.p7s",
            b"dds.sec.access.permissions": "permissions.p7s",
        }
        place = b"file:" + os.fsencode(folder.resolve()) + b"/"
        properties = [_Property(name, place + file.encode(), 0) for name, file in files.items()]
        listed = (_Property * len(properties))(*properties)
        self._qos = _Qos(_PropertySeq(len(listed), len(listed), listed))
        self.reason = ""
        self._plugin = POINTER(_Plugin)()
        if self._library.plugin.init_access_control(None, byref(self._plugin), byref(self._library.domain)):
            raise OSError("Cyclone DDS cannot initialise its access-control plugin")
        self._finalizer = weakref.finalize(self, self._library.plugin.finalize_access_control, self._plugin)
        table = self._plugin.contents
        self._check_participant = table.check_create_participant
        self._check_topic = table.check_create_topic
        self._check_endpoint = {
            "publish": table.check_create_datawriter,
            "subscribe": table.check_create_datareader,
        }
        self._references = (byref(self._qos), byref(_EmptySeq()), byref(self._exception))
        any_authentication_plugin, any_identity = self._plugin, 1
        with _silent():
            self._handle: int = table.validate_local_permissions(
                self._plugin, any_authentication_plugin, any_identity, domain, self._qos, self._exception
            )
        self._noted(self._handle != 0)

    @property
    def valid(self) -> bool:
        """Whether the plugin accepted the documents: signatures, syntax, subject and period of validity."""
        return self._handle != 0

    def joins(self) -> bool:
        """Tell whether the enclave may create a participant."""
        if not self._handle:
            return False
        qos, _, exception = self._references
        return self._noted(self._check_participant(self._plugin, self._handle, self._domain, qos, exception))

    def allows(self, direction: str, topic: str, partitions: Iterable[str] = ()) -> bool:
        """Tell whether the enclave may create a writer (``publish``) or a reader (``subscribe``), and its topic."""
        if not self._handle:
            return False
        qos, tags, exception = self._references
        subject = self._plugin, self._handle, self._domain, _octets(topic), qos
        if not self._noted(self._check_topic(*subject, exception)):
            return False
        names = [_octets(partition) for partition in partitions]
        partition_qos = _String(len(names), len(names), (c_char_p * len(names))(*names))
        return self._noted(self._check_endpoint[direction](*subject, byref(partition_qos), tags, exception))

    def ask(self, direction: str, topic: str, partitions: Iterable[str] = ()) -> tuple[bool, str]:
        """Tell the same, with the plugin's message if it denies."""
        allowed = self.allows(direction, topic, partitions)
        return allowed, "the access-control plugin allows it" if allowed else self.reason

    def allow(self, endpoints: Iterable[tuple[str, str, Iterable[str]]]) -> list[bool]:
        """Tell which endpoints the enclave may create: direction, topic and partitions of each."""
        return [self.allows(*endpoint) for endpoint in endpoints]

    def close(self) -> None:
        """Free the plugin instance; it denies everything afterwards."""
        self._handle = 0
        self._finalizer()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _noted(self, answer: object) -> bool:
        """Save and free the plugin's message, which it allocates for every refusal."""
        message = self._exception.message
        if message:
            self.reason = ctypes.string_at(message).decode(errors="replace")
            self._library.core.ddsrt_free(message)
            self._exception.message = None
        return bool(answer)


@contextmanager
def _silent() -> Iterator[None]:
    """Suppress what the plugin's parser prints on standard output."""
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        libc.fflush(None)
        os.dup2(kept, 1)
        os.close(nowhere)
        os.close(kept)


def _octets(name: str) -> bytes:
    """Return the bytes of a name; surrogates are bytes that are not UTF-8 (PEP 383)."""
    return name.encode("utf-8", "surrogateescape")
