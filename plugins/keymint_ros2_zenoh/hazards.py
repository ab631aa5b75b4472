# SPDX-License-Identifier: Apache-2.0
"""What makes a configuration unsafe, whoever wrote it: each finding has the line that decides it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from comarmor.errors import Diagnostic, Severity
from comarmor.text import quoted
from keymint_ros2_zenoh.documents.access_control import AclSubject
from keymint_ros2_zenoh.documents.configuration import TLS, Configuration
from keymint_ros2_zenoh.messages import Permission

_SETTINGS: Mapping[str, tuple[str, str]] = {
    "mode": ("zenoh-mode", "in another mode, no router decides what it exchanges"),
    "connect/endpoints": ("zenoh-endpoint", "the policy names the router alone"),
    "listen/endpoints": ("zenoh-listen", "others reach it there past the router"),
    "scouting/gossip/enabled": ("zenoh-scouting", "gossip tells sessions to bypass the router"),
    "scouting/multicast/enabled": ("zenoh-scouting", "multicast lets anyone answer first"),
    "transport/link/protocols": ("zenoh-endpoint", "other links have no common name"),
    f"{TLS}/root_ca_certificate": ("zenoh-tls", "it decides whom to trust"),
    f"{TLS}/listen_certificate": ("zenoh-tls", "it is another identity"),
    f"{TLS}/listen_private_key": ("zenoh-tls", "it is another identity"),
    f"{TLS}/connect_certificate": ("zenoh-tls", "it is another identity"),
    f"{TLS}/connect_private_key": ("zenoh-tls", "it is another identity"),
    f"{TLS}/enable_mtls": ("zenoh-tls", "without it the router sees no identity"),
    f"{TLS}/verify_name_on_connect": ("zenoh-tls", "without it any certificate can stand for the router"),
    f"{TLS}/close_link_on_expiration": ("zenoh-tls", "without it a link outlives its certificate"),
}
"""The settings that must have the value of the sources: the code of the finding, and what any other value does."""


def hazards(found: Configuration, expected: Configuration, file: str) -> Iterator[Diagnostic]:
    """Yield the settings on which access depends and that are not those of the sources.

    Args:
        found: the installed configuration.
        expected: what the sources build.
        file: the installed file as the user would type it.
    """
    wanted = expected.settings()
    for path, value in found.settings().items():
        if value != wanted[path]:
            code, reason = _SETTINGS[path]
            message = f"{path} is {_shown(value)}, expected {_shown(wanted[path])}: {reason}"
            yield _error(code, message, found, path, file)
    for path in sorted(found.other.keys() | expected.other.keys()):
        value, other = found.other.get(path), expected.other.get(path)
        if value != other:
            message = f"{path} is {_shown(value)}, expected {_shown(other)}"
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
            yield Diagnostic.error(code, message, subject.where)


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
    if subject.depends_on_more:
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
