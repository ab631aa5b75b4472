# SPDX-License-Identifier: Apache-2.0
"""What a configuration must be so that the router alone decides, and knows who sends: the rules of check and prove.

The values of settings are stated twice on purpose: ``check`` compares them with what the sources build, and ``prove``
with what :func:`required_settings` says by itself, whatever the compiler writes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from comarmor.text import quote
from comarmor.values import replace
from keymint.api import Package
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint_ros2_zenoh.documents.configuration import (
    ROUTER_SETTINGS,
    SESSION_SETTINGS,
    TLS,
    AclSubject,
    Configuration,
    Permission,
)
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, enclave_folder
from keymint_ros2_zenoh.settings import is_router, settings_of

AUTHENTICATED = ("tls", "quic")
"""Links whose other end shows a certificate."""
_PLAIN = "limited to endpoints of tls or quic without settings of their own"
"""What a router may listen on: ``tls/[::]:7447#root_ca_certificate_file=/tmp/ca.pem`` overrides the settings of TLS."""
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
"""The settings on which access depends: the code of the finding, and what another value does."""


def as_built(found: Configuration, expected: Configuration) -> Iterator[Diagnostic]:
    """Yield the settings that are not those of the sources.

    Args:
        found: the installed configuration.
        expected: what the sources build.
    """
    wanted = expected.settings()
    for path, value in found.settings().items():
        if value != wanted[path]:
            yield _setting(found, path, f"{_shown(value)}, expected {_shown(wanted[path])}")
    for path in sorted(found.other.keys() | expected.other.keys()):
        value, other = found.other.get(path), expected.other.get(path)
        if value != other:
            message = f"{path} is {_shown(value)}, expected {_shown(other)}"
            yield Diagnostic("zenoh-setting", Severity.WARNING, message, found.place(path))


def check_findings(
    content: bytes, built: bytes, file: str, help_: str, more: Callable[[Configuration], Iterable[Diagnostic]]
) -> Iterator[Diagnostic]:
    """Yield findings on a configuration.

    Args:
        content: the installed one.
        built: what the sources build.
        file: the installed file as the user would type it.
        help_: help for findings without one.
        more: returns further findings on what it says.
    """
    if content != built:
        message = "the sources build another document: they changed, or the built one was edited by hand"
        yield Diagnostic.warning("drift", message, Origin(file), help_)
    try:
        found = read(content, file)
    except KeymintError as error:
        yield from error.diagnostics
        return
    for each in (*as_built(found, read(built, file)), *open_default(found), *entries(found), *more(found)):
        yield replace(each, help=each.help or help_)


def by_itself(found: Configuration, package: Package) -> Iterator[Diagnostic]:
    """Yield the settings that let messages pass the router, or reach it without an identity.

    Args:
        found: the installed configuration.
        package: the package of the enclave, or of the router.
    """
    values = found.settings()
    for path, wanted in required_settings(package).items():
        if values[path] != wanted:
            yield _setting(found, path, f"not {_shown(wanted) if wanted != () else 'empty'}")
    if not found.protocols or not set(found.protocols) <= set(AUTHENTICATED):
        yield _setting(found, "transport/link/protocols", f"not limited to {' and '.join(AUTHENTICATED)}")
    plain = (each.partition("/")[0] in AUTHENTICATED and not {"?", "#"} & set(each) for each in found.listen)
    if is_router(package) and not all(plain):
        yield _setting(found, "listen/endpoints", f"not {_PLAIN}")


def required_settings(package: Package) -> Mapping[str, Any]:
    """Return the settings, by path, that may have one value only; the files are those that other claims refer to."""
    settings = settings_of(package)
    folder = enclave_folder(settings.keystore, package.subject)
    own: dict[str, Any]
    if is_router(package):
        side, own = "listen", {"mode": "router", "connect/endpoints": ()}
    else:
        side, own = "connect", {"mode": "client", "connect/endpoints": (settings.router.endpoint,)}
        own |= {"listen/endpoints": (), f"{TLS}/verify_name_on_connect": True}
    return own | {
        "scouting/gossip/enabled": False,
        "scouting/multicast/enabled": False,
        f"{TLS}/root_ca_certificate": f"{folder}/{IDENTITY_CA}",
        f"{TLS}/{side}_certificate": f"{folder}/{CERTIFICATE}",
        f"{TLS}/{side}_private_key": f"{folder}/{KEY}",
        f"{TLS}/enable_mtls": True,
        f"{TLS}/close_link_on_expiration": True,
    }


def unmodelled_setting(found: Configuration, router: bool) -> str:
    """Return a setting whose effect on access is not known, in words; empty if there is none.

    A setting that is missing has Zenoh's default, which is another value than the known one.

    Args:
        found: the configuration.
        router: it is a router's.
    """
    known: Mapping[str, Any] = ROUTER_SETTINGS if router else SESSION_SETTINGS
    for path, value in found.other.items():
        if path not in known or known[path] != value:
            return f"what the setting {path} does to access is not known"
    missing = next((path for path in known if path not in found.other), "")
    return missing and f"the setting {missing} is missing; what its default does to access is not known"


def open_default(found: Configuration) -> Iterator[Diagnostic]:
    """Yield what allows messages that no rule allows."""
    control = found.access_control
    if not control.enabled:
        message = "the access control is off: everything is allowed"
        yield Diagnostic.error("zenoh-default", message, found.place("access_control"))
    if control.default_permission is not Permission.DENY:
        where = found.place("access_control/default_permission")
        yield Diagnostic.error("zenoh-default", "what no rule names is allowed by default", where)


def pin_findings(found: Configuration, router: str) -> Iterator[Diagnostic]:
    """Yield that a session has other subjects than the router, which has this common name."""
    if [subject.cert_common_names for subject in found.access_control.subjects] != [(router,)]:
        message = (
            f"the only subject of its access control must be the router, {quote(router)}: otherwise others can stand "
            "for the router"
        )
        yield Diagnostic.error("zenoh-router-pin", message, found.place("access_control/subjects"))


def entries(found: Configuration) -> Iterator[Diagnostic]:
    """Yield the subject entries that do not match the links of one enclave only, or not all of them."""
    subjects = found.access_control.subjects
    counts = Counter(name for subject in subjects for name in subject.cert_common_names)
    for subject in subjects:
        if problem := _problem(subject, counts):
            yield Diagnostic.error(*problem, subject.where)


def holders(found: Configuration, names: Mapping[str, str]) -> Iterator[Diagnostic]:
    """Yield common names that have rights and are nobody's, and those that lack an entry or are those of several.

    Args:
        found: the router's configuration.
        names: the common name of each subject.
    """
    named = {name: subject for subject in found.access_control.subjects for name in subject.cert_common_names}
    holding = Counter(names.values())
    for name, entry in named.items():
        if name not in holding:
            message = f"the common name {quote(name)} has rights, but no package of the workspace has it"
            yield Diagnostic.error("zenoh-subject-unknown", message, entry.where)
    where = found.place("access_control/subjects")
    for subject, name in names.items():
        if name not in named:
            message = f"the common name {quote(name)} is missing: {subject} has no rights"
            yield Diagnostic.error("zenoh-subject-missing", message, where, subject=subject)
        elif holding[name] > 1:
            message = f"{subject} is not the only one with the common name {quote(name)}"
            yield Diagnostic.error("zenoh-common-name", message, where, subject=subject)


def _problem(subject: AclSubject, counts: Counter[str]) -> tuple[str, str] | None:
    """Return code and message of what is wrong with a subject entry."""
    shown = f"the subject {quote(subject.id)}"
    if not subject.cert_common_names:
        return "zenoh-wildcard-subject", f"{shown} has no common name: it is every link that its other properties match"
    doubled = [name for name in subject.cert_common_names if counts[name] > 1]
    if doubled:
        message = (
            f"{shown} is not the only one with the common name {quote(doubled[0])}, which may what any of them may"
        )
        return "zenoh-common-name", message
    if len(subject.cert_common_names) > 1:
        return "zenoh-common-name", f"{shown} has {len(subject.cert_common_names)} common names, which share its rights"
    if subject.depends_on_more:
        return "zenoh-subject", f"{shown} has more properties than a common name: its rules do not apply to every link"
    return None


def _setting(found: Configuration, path: str, problem: str) -> Diagnostic:
    code, reason = _SETTINGS[path]
    return Diagnostic.error(code, f"{path} is {problem}: {reason}", found.place(path))


def _shown(value: Any) -> str:
    if value is None or value in ("", ()):
        return "not set"
    if isinstance(value, bool):
        return "true" if value else "false"
    return quote(", ".join(value) if isinstance(value, tuple) else str(value), 200)
