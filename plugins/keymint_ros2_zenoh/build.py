# SPDX-License-Identifier: Apache-2.0
"""The build stage: a session's configuration for each enclave, and the router's for all of them together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.errors import Defects, Diagnostic, Severity
from keymint.api import BuildOptions, BuildResult, Package
from keymint_ros2_zenoh import emission, key_limits
from keymint_ros2_zenoh.documents.configuration_writer import write
from keymint_ros2_zenoh.enclave_layout import ROUTER, SESSION
from keymint_ros2_zenoh.lowering.key_rules import KeyRule, combined_rules, lower_package
from keymint_ros2_zenoh.settings import BUILD_TYPE, is_router, settings_of

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
    found = list(key_limits.check_identity(package))
    defects = Defects()
    defects.found += (each for each in found if each.severity is Severity.ERROR)
    if is_router(package):
        defects.require_none()
        return BuildResult({}, tuple(found))
    documents: dict[str, bytes] = {}
    with defects:
        title = [line.format(subject=package.subject) for line in _SESSION_TITLE]
        documents[SESSION] = write(emission.session(package), title)
    with defects:
        found += lower_package(package).diagnostics
    with defects:
        emission.common_name(package)
    defects.require_none()
    return BuildResult(documents, tuple(found))


def build_shared(packages: Sequence[Package], options: BuildOptions) -> BuildResult:
    """Return the router's configuration; see :meth:`keymint.api.SharedDocuments.build_shared`.

    Raises:
        KeymintError: the packages have different routers or signers, no router, or the same common name.
    """
    if not packages:
        return BuildResult({})
    defects = Defects()
    defects.found += _differences(packages)
    routers = [package for package in packages if is_router(package)]
    enclaves = emission.enclaves_of(packages)
    if not routers and not defects.found:
        with defects:
            emission.router_of(enclaves[0])
    rules: list[tuple[Package, Sequence[KeyRule]]] = []
    for package in enclaves:
        with defects:
            rules.append((package, lower_package(package).rules))
    defects.require_none()
    notes = () if enclaves else (_admits_nobody(routers[0]),)
    plain = write(emission.router(routers[0], rules), _ROUTER_TITLE)
    if not options.optimise:
        return BuildResult({ROUTER: plain}, notes)
    fewer = [(package, combined_rules(own)) for package, own in rules]
    smaller = write(emission.router(routers[0], fewer), _ROUTER_TITLE)
    return BuildResult({ROUTER: smaller}, notes, {ROUTER: len(plain)})


def _admits_nobody(router: Package) -> Diagnostic:
    return Diagnostic.warning(
        "zenoh-enclaves",
        f"no package of a subject has the build type {BUILD_TYPE}, so the router gives nobody rights",
        settings_of(router).router.origin,
        f"write <build_type>{BUILD_TYPE}</build_type> in <export> of their keymint_package.xml", router.subject,
    )  # fmt: skip


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
            yield Diagnostic.error(
                "zenoh-routers",
                f"{package.subject} has the router {own.name} at {own.endpoint}, but {first.subject} has {router.name} "
                f"at {router.endpoint}: one router decides for all enclaves of a workspace",
                own.origin, f"give both the same router, as at {router.origin}", package.subject,
            )  # fmt: skip
        if package.identity.issuer != first.identity.issuer:
            yield Diagnostic.error(
                "zenoh-issuers",
                f"{package.identity.issuer!r} issues the certificate of {package.subject}, {first.identity.issuer!r} "
                f"that of {first.subject}: a router and a session with different issuers refuse each other",
                package.identity.origin, f"give both the same issuer_name, as at {first.identity.origin}",
                package.subject,
            )  # fmt: skip
        if package.grant.issuer != first.grant.issuer:
            yield Diagnostic.error(
                "zenoh-signers",
                f"the rights of {package.subject} are signed by {package.grant.issuer!r}, those of {first.subject} by "
                f"{first.grant.issuer!r}, but they stand in one file",
                package.grant.origin, f"give both the same issuer_name, as at {first.grant.origin}", package.subject,
            )  # fmt: skip
