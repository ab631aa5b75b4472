# SPDX-License-Identifier: Apache-2.0
"""What makes a configuration unsafe, whoever wrote it: each finding has the line that decides it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from comarmor.errors import Diagnostic, Severity
from comarmor.text import quoted
from comarmor.values import dataclass
from keymint_ros2_zenoh.documents.access_control import AclSubject
from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.messages import Permission


@dataclass(frozen=True, slots=True)
class _Setting:
    """A setting that must have the value of the sources.

    Attributes:
        path: its path in a configuration.
        code: code of the finding.
        of: returns its value.
        reason: what any other value does.
    """

    path: str
    code: str
    of: Callable[[Configuration], Any]
    reason: str


_TLS = "transport/link/tls"
_SETTINGS = (
    _Setting("mode", "zenoh-mode", lambda it: it.mode, "in another mode, no router decides what it exchanges"),
    _Setting("connect/endpoints", "zenoh-endpoint", lambda it: it.connect, "the policy names the router alone"),
    _Setting("listen/endpoints", "zenoh-listen", lambda it: it.listen, "others reach it there past the router"),
    _Setting(
        "scouting/gossip/enabled", "zenoh-scouting", lambda it: it.gossip, "gossip tells sessions to bypass the router"
    ),
    _Setting(
        "scouting/multicast/enabled", "zenoh-scouting", lambda it: it.multicast, "multicast lets anyone answer first"
    ),
    _Setting(
        "transport/link/protocols", "zenoh-endpoint", lambda it: it.protocols, "other links have no common name"
    ),
    _Setting(f"{_TLS}/root_ca_certificate", "zenoh-tls", lambda it: it.tls.root_ca, "it decides whom to trust"),
    _Setting(f"{_TLS}/listen_certificate", "zenoh-tls", lambda it: it.tls.listen_certificate, "it is another identity"),
    _Setting(f"{_TLS}/listen_private_key", "zenoh-tls", lambda it: it.tls.listen_key, "it is another identity"),
    _Setting(
        f"{_TLS}/connect_certificate", "zenoh-tls", lambda it: it.tls.connect_certificate, "it is another identity"
    ),
    _Setting(f"{_TLS}/connect_private_key", "zenoh-tls", lambda it: it.tls.connect_key, "it is another identity"),
    _Setting(f"{_TLS}/enable_mtls", "zenoh-tls", lambda it: it.tls.mutual, "without it the router sees no identity"),
    _Setting(
        f"{_TLS}/verify_name_on_connect", "zenoh-tls", lambda it: it.tls.verify_name,
        "without it any certificate can stand for the router",
    ),
    _Setting(
        f"{_TLS}/close_link_on_expiration", "zenoh-tls", lambda it: it.tls.close_expired,
        "without it a link outlives its certificate",
    ),
)  # fmt: skip


def hazards(found: Configuration, expected: Configuration, file: str) -> Iterator[Diagnostic]:
    """Yield the settings on which access depends and that are not those of the sources.

    Args:
        found: the installed configuration.
        expected: what the sources build.
        file: the installed file as the user would type it.
    """
    for setting in _SETTINGS:
        value, wanted = setting.of(found), setting.of(expected)
        if value != wanted:
            message = f"{setting.path} is {_shown(value)}, expected {_shown(wanted)}: {setting.reason}"
            yield _error(setting.code, message, found, setting.path, file)
    for path in sorted(found.other.keys() | expected.other.keys()):
        value, wanted = found.other.get(path), expected.other.get(path)
        if value != wanted:
            message = f"{path} is {_shown(value)}, expected {_shown(wanted)}"
            yield _error("zenoh-setting", message, found, path, file, Severity.WARNING)
    yield from _access_control(found, file)


def _access_control(found: Configuration, file: str) -> Iterator[Diagnostic]:
    control = found.access_control
    if not control.enabled:
        yield _error("zenoh-default", "the access control is off: everything is allowed", found, "access_control", file)
    if control.default_permission is not Permission.DENY:
        message = "what no rule names is allowed by default"
        yield _error("zenoh-default", message, found, "access_control/default_permission", file)
    counts = Counter(name for subject in control.subjects for name in subject.common_names)
    for subject in control.subjects:
        problem = _problem(subject, counts)
        if problem:
            code, message = problem
            yield Diagnostic(code, Severity.ERROR, message, subject.where)


def _problem(subject: AclSubject, counts: Counter[str]) -> tuple[str, str] | None:
    """Return code and message of what is wrong with a subject entry: it must match the links of one enclave only."""
    shown = f"the subject {quoted(subject.id)}"
    if not subject.common_names:
        return "zenoh-wildcard-subject", f"{shown} has no common name: it is every link that its other properties match"
    doubled = [name for name in subject.common_names if counts[name] > 1]
    if doubled:
        message = (
            f"{shown} is not the only one with the common name {quoted(doubled[0])}, which may what any of them may"
        )
        return "zenoh-common-name", message
    if len(subject.common_names) > 1:
        return "zenoh-common-name", f"{shown} has {len(subject.common_names)} common names, which share its rights"
    if subject.usernames or subject.interfaces or subject.protocols or subject.zids:
        return "zenoh-subject", f"{shown} has more properties than a common name: its rules do not apply to every link"
    return None


def _error(
    code: str, message: str, found: Configuration, path: str, file: str, severity: Severity = Severity.ERROR
) -> Diagnostic:
    return Diagnostic(code, severity, message, found.place(path, file))


def _shown(value: Any) -> str:
    if value is None or value in ("", ()):
        return "not set"
    if isinstance(value, bool):
        return "true" if value else "false"
    return quoted(", ".join(value) if isinstance(value, tuple) else str(value), 200)
