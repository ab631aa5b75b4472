# SPDX-License-Identifier: Apache-2.0
"""The build stage: a session's configuration for each enclave, and the router's for all of them together.

They have the one shape that is sound. The router denies by default. Each enclave has one subject entry, with the common
name of its certificate, so that exactly one entry matches its links; no entry matches any link. Sessions are clients
without listeners, gossip and multicast, since no router decides what two sessions exchange directly. They accept
messages from the router alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from comarmor.values import replace
from keymint.api import BuildOptions, BuildResult, Package
from keymint.errors import Defects, Diagnostic, Severity
from keymint_ros2_zenoh.documents.configuration import (
    ROUTER_SETTINGS,
    SESSION_SETTINGS,
    AccessControl,
    AclPolicy,
    AclRule,
    AclSubject,
    Configuration,
    Flow,
    Message,
    Permission,
    write,
)
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, ROUTER, SESSION, enclave_folder
from keymint_ros2_zenoh.identities import check_identity, common_name, enclaves_of, require_distinct_names, router_of
from keymint_ros2_zenoh.lowering.key_rules import combined_rules, lower_package
from keymint_ros2_zenoh.settings import BUILD_TYPE, in_endpoint, is_router, settings_of

_SESSION_TITLE = (
    "Zenoh session of the enclave {subject}. Written by keymint; edit the sources instead.",
    "ZENOH_SESSION_CONFIG_URI names this file. What the enclave may do stands in the router's configuration.",
)
_ROUTER_TITLE = (
    "Zenoh router: the rights of all enclaves. Written by keymint; edit the sources instead.",
    "ZENOH_ROUTER_CONFIG_URI names this file. A router reads it when it starts, and never again.",
    "The number behind the name of an enclave in an id tells its rules apart.",
)


def build(package: Package, options: BuildOptions) -> BuildResult:  # noqa: ARG001 - an interface
    """Return the configuration of an enclave's sessions; nothing for the router, whose document is a shared one.

    Raises:
        KeymintError: Zenoh cannot express a rule, or refuses the key or the certificate; with ``file:line``.
    """
    found = list(check_identity(package))
    defects = Defects()
    defects.found += (each for each in found if each.severity is Severity.ERROR)
    documents: dict[str, bytes] = {}
    if not is_router(package):
        with defects:
            title = [line.format(subject=package.subject) for line in _SESSION_TITLE]
            documents[SESSION] = write(session_configuration(package), title)
        with defects:
            found += lower_package(package)[1]
        with defects:
            common_name(package)
    defects.require_none()
    return BuildResult(documents, tuple(found))


def build_shared(packages: Sequence[Package], options: BuildOptions) -> BuildResult:
    """Return the router's configuration; see :meth:`keymint.api.BuildType.build_shared`.

    Raises:
        KeymintError: the packages have different routers or signers, no router, or the same common name.
    """
    if not packages:
        return BuildResult({})
    defects = Defects()
    defects.found += _differences(packages)
    routers = [package for package in packages if is_router(package)]
    enclaves = enclaves_of(packages)
    if not routers and not defects.found:
        with defects:
            router_of(enclaves[0])
    rules: list[tuple[Package, Sequence[AclRule]]] = []
    for package in enclaves:
        with defects:
            rules.append((package, lower_package(package)[0]))
    defects.require_none()
    notes = () if enclaves else (_admits_nobody(routers[0]),)
    plain = write(router_configuration(routers[0], rules), _ROUTER_TITLE)
    if not options.optimise:
        return BuildResult({ROUTER: plain}, notes)
    fewer = [(package, combined_rules(own)) for package, own in rules]
    smaller = write(router_configuration(routers[0], fewer), _ROUTER_TITLE)
    return BuildResult({ROUTER: smaller}, notes, {ROUTER: len(plain)})


def _admits_nobody(router: Package) -> Diagnostic:
    message = f"no package of a subject has the build type {BUILD_TYPE}, so the router gives nobody rights"
    help_ = f"write <build_type>{BUILD_TYPE}</build_type> in <export> of their keymint_package.xml"
    return Diagnostic.warning("zenoh-enclaves", message, settings_of(router).router.origin, help_, router.subject)


def _differences(packages: Sequence[Package]) -> Iterator[Diagnostic]:
    """Yield what packages must have in common and have not: the router and both authorities.

    An enclave shows its own certificate alone, and trusts its own issuer and those above it. So the certificate of
    another issuer has no path to what the other side trusts, even below the same root (measured).
    """
    first = next((package for package in packages if is_router(package)), packages[0])
    router = settings_of(first).router
    for package in packages:
        own = settings_of(package).router
        if own != router:
            its, expected = (f"{each.name} at {each.endpoint}" for each in (own, router))
            routers = f"{package.subject} has the router {its}, but {first.subject} has {expected}"
            message = f"{routers}: one router decides for all enclaves of a workspace"
            help_ = f"give both the same router, as at {router.origin}"
            yield Diagnostic.error("zenoh-routers", message, own.origin, help_, package.subject)
        identity, usual = package.identity, first.identity
        if identity.issuer != usual.issuer:
            issuers = f"{identity.issuer!r} issues the certificate of {package.subject}, {usual.issuer!r} that of"
            message = f"{issuers} {first.subject}: a router and a session with different issuers refuse each other"
            help_ = f"give both the same issuer_name, as at {usual.origin}"
            yield Diagnostic.error("zenoh-issuers", message, identity.origin, help_, package.subject)
        grant, other = package.grant, first.grant
        if grant.issuer != other.issuer:
            signers = f"are signed by {grant.issuer!r}, those of {first.subject} by {other.issuer!r}"
            message = f"the rights of {package.subject} {signers}, but they stand in one file"
            help_ = f"give both the same issuer_name, as at {other.origin}"
            yield Diagnostic.error("zenoh-signers", message, grant.origin, help_, package.subject)


PROTOCOLS = ("tls",)
"""Link protocols; without certificates there is no common name to decide by."""
EVERY_KEY = ("**", "**/@adv/**", "@ros2_lv/**")
"""All keys that rmw_zenoh uses: ``**`` matches no chunk that begins with ``@``."""
_LOCAL = ("localhost", "127.0.0.1", "::1")
"""Hosts for which a router listens on the loopback interface; for all others it listens on all interfaces."""
_ROUTER_RULE = "router"


def session_configuration(package: Package) -> Configuration:
    """Return the configuration of an enclave's sessions.

    Raises:
        KeymintError: the workspace has no package of the router.
    """
    settings = settings_of(package)
    name = common_name(router_of(package))
    every_message = AclRule(_ROUTER_RULE, tuple(Message), tuple(Flow), Permission.ALLOW, EVERY_KEY)
    subject, policy = AclSubject(_ROUTER_RULE, (name,)), AclPolicy((_ROUTER_RULE,), (_ROUTER_RULE,))
    return Configuration(
        mode="client",
        connect=(settings.router.endpoint,),
        connect_certificate=_path(package, CERTIFICATE),
        connect_key=_path(package, KEY),
        access_control=AccessControl(True, Permission.DENY, (every_message,), (subject,), (policy,)),
        other=SESSION_SETTINGS,
        **_closed(package),
    )


def router_configuration(package: Package, enclaves: Sequence[tuple[Package, Sequence[AclRule]]]) -> Configuration:
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
        own = [replace(rule, id=f"{enclave.subject} {number}") for number, rule in enumerate(key_rules, 1)]
        subjects.append(AclSubject(enclave.subject, (common_name(enclave),)))
        rules += own
        if own:
            policies.append(AclPolicy(tuple(rule.id for rule in own), (enclave.subject,)))
    router = settings_of(package).router
    host = in_endpoint(router.host) if router.host in _LOCAL else "[::]"
    return Configuration(
        mode="router",
        listen=(f"tls/{host}:{router.port}",),
        listen_certificate=_path(package, CERTIFICATE),
        listen_key=_path(package, KEY),
        access_control=AccessControl(True, Permission.DENY, tuple(rules), tuple(subjects), tuple(policies)),
        other=ROUTER_SETTINGS,
        **_closed(package),
    )


def _closed(package: Package) -> dict[str, Any]:
    """Return the settings of both ends: they search nobody, and show certificates, whose names and dates count."""
    tls = {"root_ca": _path(package, IDENTITY_CA), "mutual": True, "verify_name": True, "close_expired": True}
    return {"gossip": False, "multicast": False, "protocols": PROTOCOLS, **tls}


def _path(package: Package, file: str) -> str:
    """Return the absolute path on the robot of a file in a package's enclave."""
    return f"{enclave_folder(settings_of(package).keystore, package.subject)}/{file}"
