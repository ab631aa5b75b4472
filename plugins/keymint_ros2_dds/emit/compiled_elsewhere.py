# SPDX-License-Identifier: Apache-2.0
"""Permissions that another machine compiled. They count only after they are proven here, unless the user trusts it.

A worker sends rules, not documents: what no proof covers, the head of the document, is written from the sources here.
Rules about relaying are not covered either, so subjects that have some are compiled here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from comarmor.values import dataclass
from keymint.api import BuildOptions, Claim, Package, Proof
from keymint.errors import KeymintError
from keymint.keymake.kinds import kind_of
from keymint_ros2_dds.compiling.grant_compiler import vendor_notes
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.emit.emission import Emitted, comparison, emit
from keymint_ros2_dds.enclave_layout import PERMISSIONS, PERMISSIONS_XML
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.grant_rules import GrantRule
from keymint_ros2_dds.proving import proof_cache, prove_content
from keymint_ros2_dds.vendor_limits import TIGHT, signed_size


@dataclass(frozen=True, slots=True)
class Compilation:
    """What the engine made of a package.

    Attributes:
        rules: the rules of its document.
        plain_size: bytes of the plain form of the document.
        claims: what is proven about the document.
    """

    rules: tuple[GrantRule[str], ...]
    plain_size: int
    claims: tuple[Claim, ...]


_received: dict[str, tuple[Package, BuildOptions, Compilation, bool]] = {}
"""By subject: what other machines compiled, and whether the user trusts them."""


def part_compiler() -> Callable[..., Sequence[Compilation | None]]:
    """See :meth:`keymint.api.BuildType.compiling`."""
    return compile_part


def compile_part(_plugins: object, packages: Sequence[tuple[Package, BuildOptions]]) -> tuple[Compilation | None, ...]:
    """Compile packages on a worker; None for one about which there is more to say than its document."""
    return tuple(_compiled(package, options) for package, options in packages)


def _compiled(package: Package, options: BuildOptions) -> Compilation | None:
    try:
        emitted = emit(package, options)
    except KeymintError:
        return None  # the error is found again where the user is
    if not emitted.is_usual(package.grant):
        return None
    return Compilation(emitted.rules, emitted.plain_size, emitted.claims)


def receive(package: Package, options: BuildOptions, compilation: object, *, trusted: bool) -> None:
    """Keep what a worker compiled for the build of the package."""
    if isinstance(compilation, Compilation):
        _received[package.subject] = package, options, compilation, trusted


def emit_received(package: Package, options: BuildOptions) -> Emitted | None:
    """Return the document of a package that another machine compiled; None if there is none, or it is not proven."""
    known = _received.pop(package.subject, None)
    if known is None or (known[0].grant, known[0].distro, known[1]) != (package.grant, package.distro, options):
        return None
    _, _, compilation, trusted = known
    rules = compilation.rules
    if any(TopicAction.RELAY in rule.topics for rule in rules) or not is_remote(package):
        return None
    try:
        document = permissions_document.render(package.grant, rules)
        dds_xml.require_valid(document, PERMISSIONS, PERMISSIONS_XML)
        task = comparison(package, document)
        claims = compilation.claims if trusted else prove_content(task)
    except KeymintError:
        return None
    if not claims or any(claim.proof is not Proof.PROVEN for claim in claims) or signed_size(document) > TIGHT:
        return None
    if trusted:
        proof_cache.remember(task, kind_of(package.grant.rules.rules), claims)
    return Emitted(document, rules, compilation.plain_size, None, claims, tuple(vendor_notes(rules, package.grant)))


def is_remote(package: Package) -> bool:
    """Tell whether another machine may compile a package: it has no rules about relaying, which no proof covers."""
    return not any("relay" in permission for rule in package.grant.rules.rules for permission in rule.permissions)
