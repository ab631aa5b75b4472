# SPDX-License-Identifier: Apache-2.0
"""Turn packages into the configurations of their router and sessions, in the one shape that is sound.

The router denies by default. Each enclave has one subject entry, with the common name of its certificate, so that
exactly one entry matches its links; no entry matches any link. Sessions are clients without listeners, gossip and
multicast, since no router decides what two sessions exchange directly. They accept messages from the router alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from comarmor.errors import Defects, Diagnostic
from comarmor.rules import Effect
from keymint.api import Package
from keymint.errors import KeymintError
from keymint.pki import distinguished_names
from keymint_ros2_zenoh.documents.configuration import AccessControl, AclPolicy, AclRule, AclSubject, Configuration
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, enclave_folder
from keymint_ros2_zenoh.lowering.key_rules import KeyRule
from keymint_ros2_zenoh.messages import Flow, Message, Permission
from keymint_ros2_zenoh.settings import Router, in_endpoint, is_router, settings_of

PROTOCOLS = ("tls",)
"""Link protocols; without certificates there is no common name to decide by."""
EVERY_KEY = ("**", "**/@adv/**", "@ros2_lv/**")
"""All keys that rmw_zenoh uses: ``**`` matches no chunk that begins with ``@``."""
_LOCAL = ("localhost", "127.0.0.1", "::1")
_ROUTER_RULE = "router"

_COMMON: Mapping[str, Any] = {
    "timestamping/enabled": True,
    "transport/link/tx/keep_alive": 2,
    "transport/link/tx/lease": 60_000,
    "transport/shared_memory/enabled": False,
    "transport/unicast/accept_pending": 10_000,
    "transport/unicast/accept_timeout": 60_000,
    "transport/unicast/max_sessions": 10_000,
    "transport/unicast/open_timeout": 60_000,
}
"""Settings of both default configurations of rmw_zenoh (0.12, ``rmw_zenoh_cpp/config``) that differ from Zenoh's.

A configuration replaces these defaults, so it must repeat them. ``transient_local`` needs time stamps.
"""
ROUTER_SETTINGS: Mapping[str, Any] = _COMMON
SESSION_SETTINGS: Mapping[str, Any] = {
    **_COMMON,
    "queries_default_timeout": 600_000,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 60_000_000,
}


def common_name(package: Package) -> str:
    """Return the first common name of a package's certificate, by which a router knows it.

    Raises:
        KeymintError: the subject name has none.
    """
    origin = package.identity.origin
    for kind, value in distinguished_names.attributes(distinguished_names.parse(package.identity.subject_name, origin)):
        if kind == "CN":
            return value
    raise KeymintError(
        f"the subject name {package.identity.subject_name!r} has no common name, by which routers know a subject",
        where=origin,
        help="begin it with CN=",
        code="zenoh-common-name",
    )


def session(package: Package) -> Configuration:
    """Return the configuration of an enclave's sessions.

    Raises:
        KeymintError: the workspace has no package of the router.
    """
    settings = settings_of(package)
    name = common_name(router_of(package))
    every_message = AclRule(_ROUTER_RULE, tuple(Message), tuple(Flow), Permission.ALLOW, EVERY_KEY)
    policy = AclPolicy((_ROUTER_RULE,), (_ROUTER_RULE,))
    return Configuration(
        mode="client",
        connect=(settings.router.endpoint,),
        connect_certificate=_path(package, CERTIFICATE),
        connect_key=_path(package, KEY),
        access_control=_denying([every_message], [AclSubject(_ROUTER_RULE, (name,))], [policy]),
        other=SESSION_SETTINGS,
        **_closed(package),
    )


def router(package: Package, enclaves: Sequence[tuple[Package, Sequence[KeyRule]]]) -> Configuration:
    """Return the configuration of the router.

    Args:
        package: the router's package.
        enclaves: the packages of all enclaves, each with what the router must permit or deny on its links.

    Raises:
        KeymintError: two packages have the same common name, or one has none.
    """
    require_distinct_names([package, *(enclave for enclave, _ in enclaves)])
    rules: list[AclRule] = []
    subjects: list[AclSubject] = []
    policies: list[AclPolicy] = []
    for enclave, key_rules in enclaves:
        own = [_rule(f"{enclave.subject} {number}", rule) for number, rule in enumerate(key_rules, 1)]
        subjects.append(AclSubject(enclave.subject, (common_name(enclave),)))
        rules += own
        if own:
            policies.append(AclPolicy(tuple(rule.id for rule in own), (enclave.subject,)))
    return Configuration(
        mode="router",
        listen=(listen_endpoint(settings_of(package).router),),
        listen_certificate=_path(package, CERTIFICATE),
        listen_key=_path(package, KEY),
        access_control=_denying(rules, subjects, policies),
        other=ROUTER_SETTINGS,
        **_closed(package),
    )


def _closed(package: Package) -> dict[str, Any]:
    """Return the settings of both ends: they search nobody, and show certificates, whose names and dates count."""
    tls = {"root_ca": _path(package, IDENTITY_CA), "mutual": True, "verify_name": True, "close_expired": True}
    return {"gossip": False, "multicast": False, "protocols": PROTOCOLS, **tls}


def _denying(rules: Iterable[AclRule], subjects: Iterable[AclSubject], policies: Iterable[AclPolicy]) -> AccessControl:
    return AccessControl(True, Permission.DENY, tuple(rules), tuple(subjects), tuple(policies))


def router_of(package: Package) -> Package:
    """Return the package of the router that a package's sessions connect to.

    Raises:
        KeymintError: the workspace has none.
    """
    wanted = settings_of(package).router
    for other in (package, *package.infrastructure):
        if other.name == wanted.name:
            return other
    raise KeymintError(
        f"the workspace has no package of the router {wanted.name!r}",
        where=wanted.origin,
        help="'keymint create' creates it",
        code="zenoh-router-missing",
    )


def require_distinct_names(packages: Iterable[Package]) -> None:
    """Check that no two packages have the same common name.

    Raises:
        KeymintError: some have, or a package has none; with all of them.
    """
    holders: dict[str, Package] = {}
    defects = Defects()
    for package in packages:
        with defects:
            name = common_name(package)
            other = holders.setdefault(name, package)
            if other is not package:
                message = (
                    f"{package.subject} and {other.subject} (at {other.identity.origin}) have the same common name "
                    f"{name!r}, by which alone routers know a subject"
                )
                where, help_ = package.identity.origin, "give one of them a subject_name with another CN"
                defects.found.append(Diagnostic.error("zenoh-common-name", message, where, help_, package.subject))
    defects.require_none()


def listen_endpoint(router_: Router) -> str:
    """Return where a router listens: on the loopback interface if its host is there, else on all interfaces."""
    host = in_endpoint(router_.host) if router_.host in _LOCAL else "[::]"
    return f"tls/{host}:{router_.port}"


def _rule(name: str, rule: KeyRule) -> AclRule:
    permission = Permission.ALLOW if rule.effect is Effect.ALLOW else Permission.DENY
    return AclRule(name, rule.messages, rule.flows, permission, tuple(str(key) for key in rule.key_exprs))


def _path(package: Package, file: str) -> str:
    """Return the absolute path on the robot of a file in a package's enclave."""
    return f"{enclave_folder(settings_of(package).keystore, package.subject)}/{file}"


def enclaves_of(packages: Iterable[Package]) -> list[Package]:
    """Return the packages of enclaves: all but the router's."""
    return [package for package in packages if not is_router(package)]
