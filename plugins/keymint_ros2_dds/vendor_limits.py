# SPDX-License-Identifier: Apache-2.0
"""Checks limits of DDS vendors: keys and certificates that they accept, and the size of documents.

The private key of an identity may lie in a token of the robot, which ``key.p11`` names. Fast DDS loads such keys with
the engine ``pkcs11`` of OpenSSL. Cyclone DDS 0.10 refuses them, and rmw_cyclonedds never asks for ``key.p11``, so it
would start without a key.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress

from comarmor.rules import Effect
from keymint.api import KeySpec, Package
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.pki import distinguished_names, keys
from keymint_ros2_dds.enclave_layout import KEY, KEY_URI, READS_KEY_URI
from keymint_ros2_dds.lowering.lowered_rules import Lowered
from keymint_ros2_dds.settings import settings_of

TIGHT = 45_000
"""Bytes of a signed document up to which handshakes worked on every vendor."""
BROKEN = 64_000
"""Bytes of a signed document beyond which handshakes fail on some vendor: a UDP datagram has at most 65,507."""
SIGNATURE = 1_450
"""Approximate bytes that S/MIME adds with an EC key of 256 bits; with RSA of 2048 bits it adds 2,250."""
_ACCEPTED_KEYS = ("RSA with 2048 bits", "SECP256R1")


def check_key(package: Package, *, allow_vendor_specific: bool) -> Iterator[Diagnostic]:
    """Yield the defects of an identity's key: vendors accept RSA with 2048 bits or EC with 256 bits."""
    try:
        name = _key_name(package.identity.key, package.identity.origin)
    except KeymintError as error:
        yield from error.diagnostics
        return
    if name not in _ACCEPTED_KEYS:
        severity = Severity.WARNING if allow_vendor_specific else Severity.ERROR
        message = f"the identity's key is {name}; Cyclone DDS accepts RSA with 2048 bits and SECP256R1 only"
        help_ = "use SECP256R1, or build with --allow-vendor-specific"
        yield Diagnostic("portability-key", severity, message, package.identity.origin, help_, package.subject)


def check_root_name(package: Package, *, allow_vendor_specific: bool) -> Iterator[Diagnostic]:
    """Yield an error if the root enclave has no name but ``CN=/``, whose only part occurs in the name of every grant.

    Cyclone DDS requires only that the grant has all parts of the identity (``ac_check_subjects_are_equal`` in its
    ``access_control_utils.c``), so the root enclave could use the signed permissions of any other one.
    It is a warning where another tool signed it: the owner has that already, and takes the keystore over first.
    """
    if package.subject != "/":
        return
    try:
        parts = tuple(distinguished_names.attributes(distinguished_names.parse(package.identity.subject_name)))
    except KeymintError:
        return  # reported with the name
    if parts == (("CN", "/"),):
        severity = Severity.WARNING if allow_vendor_specific or package.kept else Severity.ERROR
        message = (
            f"the root enclave is named {package.identity.subject_name!r} alone: on Cyclone DDS that identity can use "
            "the permissions of every other enclave"
        )
        help_ = (
            "write <subject_name>CN={common_name},OU={unique}</subject_name> for certificate and permissions, or use "
            "the subject format 'unique'; where only Fast DDS runs, build with --allow-vendor-specific"
        )
        yield Diagnostic("portability-root-name", severity, message, package.identity.origin, help_, package.subject)


def check_issuers(package: Package) -> Iterator[Diagnostic]:
    """Yield warnings for authorities and signatures of an identity that some vendor refuses.

    Measured with participants of Cyclone DDS 0.10.2 and Fast DDS 2.9.1. They are warnings, since a deployment may know
    its vendor. They have no subject, since one authority issues many identities.
    """
    if (algorithm := package.identity.hash_algorithm).upper() != "SHA256":
        message = f"identities are signed with {algorithm}; Fast DDS 2.9 refuses all but SHA256"
        yield Diagnostic.warning("portability-hash", message, package.identity.origin, "use SHA256")
    for authority in package.issuers:
        spec, named = authority.certificate, f"the authority {authority.name!r}"
        if spec.issuer:
            message = f"{named} is an intermediate CA; Cyclone DDS refuses identities it issues"
            help_ = "issue identities by a self-signed authority"
            yield Diagnostic.warning("portability-chain", message, spec.origin, help_)
        with suppress(KeymintError):  # reported where the authority's key is generated
            if _key_name(spec.key, spec.origin) not in _ACCEPTED_KEYS:
                what = f"the key of {named} is not RSA with 2048 bits or SECP256R1"
                message = f"{what}; Cyclone DDS refuses identities that it issues"
                yield Diagnostic.warning("portability-authority-key", message, spec.origin, "use SECP256R1")


def _key_name(key: KeySpec, where: Origin) -> str:
    return f"RSA with {key.size} bits" if key.algorithm == "rsa" else keys.curve_name(key.curve, where)


def check_size(size: int, kind: str, package: Package, lowered: Lowered | None = None) -> Iterator[Diagnostic]:
    """Yield a warning if a signed document is so large that handshakes may fail.

    Args:
        size: bytes of the signed document.
        kind: ``permissions`` or ``governance``.
        package: the package of the document.
        lowered: its rules, to report those with the most patterns.
    """
    if size <= TIGHT:
        return
    limit = BROKEN if size > BROKEN else TIGHT
    effect = "handshakes fail on Fast DDS" if size > BROKEN else "handshakes may fail on some vendors"
    message = f"the signed {kind} document has about {size:,} bytes; beyond {limit:,} {effect}"
    where = package.grant.origin
    help_ = "allow entire namespaces with a wildcard where that is intended, or split the subject"
    if lowered is not None:
        rules = Counter(rule for *_, rule in lowered.patterns())
        kinds = Counter(f"{rule.effect} {rule.kind}" for rule in rules.elements())
        ((largest, count),), ((of_kind, number),) = rules.most_common(1), kinds.most_common(1)
        share = f"{number} of its {rules.total()} patterns come from {of_kind} rules"
        message += f"; {share}, {count} of them from one rule"
        where = largest.origin
        if of_kind.startswith(Effect.DENY):
            help_ = "deny entire namespaces with a wildcard where that is intended"
    yield Diagnostic.warning(f"size-{kind}", message, where, help_, package.subject)


def signed_size(unsigned: bytes) -> int:
    """Return the approximate bytes of a document after signing, which adds a frame and a signature."""
    return len(unsigned) + SIGNATURE


ACCEPT = "<exceptions><token_keys/></exceptions> in profile/keymint_profile.xml"


def check_token_key(package: Package, *, allow_vendor_specific: bool) -> Iterator[Diagnostic]:
    """Yield what hinders participants from using the key of a package, if it lies in a token.

    Args:
        package: the package.
        allow_vendor_specific: this build accepts differences between vendors.
    """
    spec = package.identity
    if not spec.key.uri:
        return
    if package.distro not in READS_KEY_URI:
        message = f"the key of the identity lies in a token, but ROS 2 {package.distro} reads keys from files only"
        help_ = f"leave out <pkcs11>, or use {READS_KEY_URI[0]} or later"
        yield Diagnostic.error("key-token-distro", message, spec.origin, help_, package.subject)
        return
    from keymint.pki.tokens.pkcs11_uri import parse  # noqa: PLC0415 - few packages need it

    if parse(spec.key.uri, spec.origin).module_path:
        message = "the URI of the key names a module, but Fast DDS finds modules through p11-kit"
        help_ = "leave out module-path; put the module into /etc/pkcs11/modules on the robot"
        yield Diagnostic.error("key-token-module", message, spec.origin, help_, package.subject)
    accepted = settings_of(package).accepts_token_keys
    severity = Severity.NOTE if accepted else Severity.WARNING if allow_vendor_specific else Severity.ERROR
    message = (
        f"the key of the identity lies in a token; only Fast DDS reads {KEY_URI}, through rmw_fastrtps: with Cyclone "
        f"DDS the node finds no {KEY} and does not start"
    )
    help_ = (
        "the profile accepts it" if accepted else f"leave out <pkcs11>; or, where only Fast DDS runs, write {ACCEPT}"
    )
    yield Diagnostic("portability-key-token", severity, message, spec.origin, help_, package.subject)


def is_key_uri(content: bytes | None, uri: str) -> bool:
    """Tell whether a file ``key.p11`` has this URI, as ROS 2 reads it: the first word counts."""
    return bool(uri) and content == f"{uri}\n".encode()
