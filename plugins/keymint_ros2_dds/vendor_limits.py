"""What the vendors' authentication accepts of keys, and how large documents may become."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from comarmor.errors import Diagnostic, Severity
from comarmor.rules import Effect
from keymint.api import KeySpec, Package
from keymint.errors import KeymintError
from keymint.pki import keys
from keymint_ros2_dds.lowering.lower import Lowered

TIGHT = 45_000
"""Bytes of a signed document up to which handshakes were seen to work on every vendor."""
BROKEN = 64_000
"""Bytes of a signed document beyond which handshakes fail on some vendor: a UDP datagram ends at 65,507."""
SIGNATURE = 1_450
"""About how many bytes S/MIME adds to a document with an EC key of 256 bits; with RSA of 2048 bits it is 2,250."""


def check_key(key: KeySpec, package: Package, *, allow_vendor_specific: bool) -> Iterator[Diagnostic]:
    """Yield what is wrong with the key of an identity: vendors take RSA of 2048 bits or EC of 256 bits."""
    if key.algorithm == "rsa":
        fine, name = key.size == 2048, f"RSA with {key.size} bits"  # noqa: PLR2004 - the size in question
    else:
        try:
            name = keys.curve_name(key.curve, package.identity.origin)
        except KeymintError as error:
            yield from error.diagnostics
            return
        fine = name == "SECP256R1"
    if not fine:
        yield Diagnostic(
            "portability-key",
            Severity.WARNING if allow_vendor_specific else Severity.ERROR,
            f"the identity's key is {name}; Cyclone DDS accepts RSA with 2048 bits and SECP256R1 only",
            package.identity.origin,
            "use SECP256R1, or build with --allow-vendor-specific",
            package.subject,
        )


def check_issuers(package: Package) -> Iterator[Diagnostic]:
    """Yield warnings for what one vendor refuses of the certificates above an identity, and of how it is signed.

    Measured with participants of Cyclone DDS 0.10.2 and Fast DDS 2.9.1. They are warnings, as a deployment may know its
    vendor; and they name no subject, as one authority stands above many.
    """
    if package.identity.hash_algorithm.upper() != "SHA256":
        yield Diagnostic(
            "portability-hash",
            Severity.WARNING,
            f"identities are signed with {package.identity.hash_algorithm}; Fast DDS 2.9 refuses all but SHA256",
            package.identity.origin,
            "use SHA256",
        )
    for authority in package.issuers:
        spec = authority.certificate
        if spec.issuer:
            yield Diagnostic(
                "portability-chain",
                Severity.WARNING,
                f"the authority {authority.name!r} is an intermediate one; Cyclone DDS refuses identities of its",
                spec.origin,
                "let a self-signed authority issue identities",
            )
        if not _accepted(spec.key):
            yield Diagnostic(
                "portability-authority-key",
                Severity.WARNING,
                f"the key of the authority {authority.name!r} is not RSA with 2048 bits or SECP256R1; "
                "Cyclone DDS refuses identities that it issues",
                spec.origin,
                "use SECP256R1",
            )


def _accepted(key: KeySpec) -> bool:
    if key.algorithm == "rsa":
        return key.size == 2048  # noqa: PLR2004 - the size in question
    try:
        return keys.curve_name(key.curve) == "SECP256R1"
    except KeymintError:
        return True  # the error is of the authority, and said where its key is minted


def check_size(size: int, kind: str, package: Package, lowered: Lowered | None = None) -> Iterator[Diagnostic]:
    """Yield a warning when a signed document is so large that handshakes break.

    Args:
        size: bytes of the signed document, or of the unsigned one and what signing will add.
        kind: which document.
        package: the package it belongs to.
        lowered: its rules, to name those that contribute most.
    """
    if size <= TIGHT:
        return
    limit = BROKEN if size > BROKEN else TIGHT
    effect = "handshakes fail on Fast DDS" if size > BROKEN else "handshakes may fail on some vendors"
    message = f"the signed {kind} document has about {size:,} bytes; beyond {limit:,} {effect}"
    where = package.permissions.origin
    help_ = "allow whole namespaces with a wildcard where that is what you mean, or split the subject"
    if lowered is not None:
        rules = Counter(
            rule for sides in (lowered.allow, lowered.deny) for side in sides.values() for rule in side.values()
        )
        kinds: Counter[str] = Counter()
        for rule, count in rules.items():
            kinds[f"{rule.effect} {rule.kind}"] += count
        largest, count = rules.most_common(1)[0]
        kind_name, kind_count = kinds.most_common(1)[0]
        total = sum(rules.values())
        message += f"; {kind_count} of its {total} patterns come from {kind_name} rules, {count} of them from one rule"
        where = largest.origin
        if any(rule.effect is Effect.DENY for rule in rules) and kinds.most_common(1)[0][0].startswith("DENY"):
            help_ = "deny whole namespaces with a wildcard where that is what you mean"
    yield Diagnostic(f"size-{kind}", Severity.WARNING, message, where, help_, package.subject)


def signed_size(unsigned: bytes) -> int:
    """Return about how many bytes a document has when it is signed: a frame and a signature are added."""
    return len(unsigned) + SIGNATURE
