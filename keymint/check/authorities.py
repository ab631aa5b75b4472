"""What is found on the authorities: their keys and certificates, and whether they are what the profile asks for."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import timedelta
from functools import partial

from cryptography import x509

from keymint.check.places import modes
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.pki import certificates, keys
from keymint.plan.authorities import in_order, satisfies
from keymint.plan.inputs import Inputs, LoadedProfile
from keymint.plan.secrets import password


def authorities(inputs: Inputs, loaded: LoadedProfile, within: timedelta) -> Iterator[Diagnostic]:
    """Yield what is found on the keys and certificates of all authorities."""
    workspace = inputs.workspace
    issuers: dict[str, x509.Certificate] = {}
    for authority in in_order(loaded.profile.authorities):
        key_path, path = (
            workspace.authority_key(authority.name),
            workspace.authority_certificate(authority.name),
        )
        where = Origin(workspace.shown(path))
        yield from modes(workspace.shown(key_path.parent), key_path.parent, 0o700, "")
        yield from modes(workspace.shown(key_path), key_path, 0o600, "")
        pem, key_pem = inputs.tree.read(path), inputs.tree.read(key_path)
        if pem is None:
            yield Diagnostic(
                "authority-missing",
                Severity.ERROR,
                f"the authority {authority.name!r} has no certificate",
                where,
                "run 'keymint install'",
            )
            continue
        if key_pem is None:
            yield Diagnostic(
                "authority-key-missing",
                Severity.NOTE,
                f"the private key of {authority.name!r} is not here",
                where,
                "restore it to sign anything anew",
            )
        yield from _authority(inputs, authority.name, pem, key_pem, issuers, within, loaded)


def _authority(
    inputs: Inputs,
    name: str,
    pem: bytes,
    key_pem: bytes | None,
    issuers: dict[str, x509.Certificate],
    within: timedelta,
    loaded: LoadedProfile,
) -> Iterator[Diagnostic]:
    spec = next(a.certificate for a in loaded.profile.authorities if a.name == name)
    where = Origin(inputs.workspace.shown(inputs.workspace.authority_certificate(name)))
    try:
        certificate = certificates.load(pem)
        key = certificates.public_key(certificate)
    except KeymintError as error:
        yield from (Diagnostic(d.code, d.severity, d.message, where, d.help) for d in error.diagnostics)
        return
    issuers[name] = certificate
    if key_pem is not None:
        try:
            key = keys.from_pem(key_pem, password(spec.key, inputs.environment, spec.origin)).public_key()
        except KeymintError as error:
            yield from map(partial(_about_key, where=where), error.diagnostics)
    end = certificate.not_valid_after_utc
    if not satisfies(pem, spec, key, issuers.get(spec.issuer)):
        yield Diagnostic(
            "authority-drift",
            Severity.ERROR,
            f"the certificate of {name!r} is not what the profile asks for",
            where,
            "run 'keymint install', and deploy all enclaves anew",
        )
    if end < inputs.now:
        yield Diagnostic(
            "authority-expired",
            Severity.ERROR,
            f"the certificate of {name!r} expired on {end:%Y-%m-%d %H:%M} UTC",
            where,
            f"extend its validity at {spec.origin}, and install anew",
        )
    elif end < inputs.now + within:
        yield Diagnostic(
            "authority-expires",
            Severity.WARNING,
            f"the certificate of {name!r} expires on {end:%Y-%m-%d %H:%M} UTC",
            where,
            f"extend its validity at {spec.origin}, and install anew",
        )


def _about_key(found: Diagnostic, where: Origin) -> Diagnostic:
    """Return what is wrong with an authority's key as a finding; that its password is not here is no defect of it."""
    severity = Severity.NOTE if found.code == "password-missing" else found.severity
    return Diagnostic(found.code, severity, found.message, where, found.help)
