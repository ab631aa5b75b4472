"""The authorities of a workspace: a key and a certificate for each, minted once and kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from keymint.api import Authority, CertificateSpec, Signer
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.pki import certificates, keys
from keymint.plan.inputs import Inputs, LoadedProfile, changed
from keymint.plan.model import Action, File, FolderChange, Plan, Step
from keymint.plan.secrets import load_key, password

STAGE = "authorities"


@dataclass(frozen=True, slots=True)
class MintedAuthority:
    """An authority with its certificate and key, able to issue.

    Attributes:
        issuer: what issues certificates.
        chain: PEM of its certificate, followed by those of the authorities above it up to the root.
        signer: what signs documents.
    """

    issuer: certificates.Issuer
    chain: bytes
    signer: Signer = field(repr=False)


def plan_authorities(inputs: Inputs, loaded: LoadedProfile) -> tuple[Plan, Mapping[str, MintedAuthority]]:
    """Plan the keys and certificates of all authorities that the profile names.

    A key that is there is kept. A certificate is issued anew when the profile asks for another one than is there.

    Returns:
        the plan, and the authorities by name as they are when it is carried out.

    Raises:
        KeymintError: a key cannot be read, or is not of the kind that the profile asks for.
    """
    minted: dict[str, MintedAuthority] = {}
    steps: list[Step] = []
    said: list[Diagnostic] = []
    for authority in in_order(loaded.profile.authorities):
        result, changes, diagnostics = _plan_authority(inputs, authority, minted)
        minted[authority.name] = result
        said += diagnostics
        action = Action.CREATED if changes else Action.UNCHANGED
        steps.append(Step(STAGE, authority.name, action, changes, "certificate authority"))
    return Plan(tuple(steps), inputs.state, tuple(said)), minted


def in_order(authorities: Sequence[Authority]) -> tuple[Authority, ...]:
    """Return authorities so that each stands behind its issuer; names and cycles were checked on loading."""
    ordered: dict[str, Authority] = {}
    waiting = list(authorities)
    while waiting:
        ready = [a for a in waiting if not a.certificate.issuer or a.certificate.issuer in ordered]
        if not ready:
            cycle = ", ".join(a.name for a in waiting)
            raise KeymintError(
                f"the authorities {cycle} wait for each other's certificate",
                where=waiting[0].certificate.origin,
                help="leave one issuer_name empty",
                code="authority-cycle",
            )
        ordered |= {a.name: a for a in ready}
        waiting = [a for a in waiting if a.name not in ordered]
    return tuple(ordered.values())


def trusted_chains(inputs: Inputs, loaded: LoadedProfile) -> Mapping[str, bytes]:
    """Return the certificate of each authority as it is on the disk, with the chain above it (PEM)."""
    chains: dict[str, bytes] = {}
    for authority in in_order(loaded.profile.authorities):
        own = inputs.tree.read(inputs.workspace.authority_certificate(authority.name)) or b""
        chains[authority.name] = own + chains.get(authority.certificate.issuer, b"")
    return chains


def satisfies(pem: bytes, spec: CertificateSpec, key: keys.PrivateKey, issuer: certificates.Issuer | None) -> bool:
    """Tell whether an authority's certificate is what the profile asks for."""
    above = issuer.certificate if issuer else None
    return certificates.certificate_satisfies(pem, spec, key.public_key(), above, authority=True)


def _plan_authority(
    inputs: Inputs, authority: Authority, minted: Mapping[str, MintedAuthority]
) -> tuple[MintedAuthority, tuple[FolderChange, ...], Sequence[Diagnostic]]:
    spec = authority.certificate
    key_path = inputs.workspace.authority_key(authority.name)
    certificate_path = inputs.workspace.authority_certificate(authority.name)
    secret = password(spec.key, inputs.environment, spec.origin)
    changes: list[FolderChange] = []
    pem = inputs.tree.read(key_path)
    if pem is None:
        key = keys.generate(spec.key, spec.origin)
        pem = keys.to_pem(key, secret)
        changes.append(FolderChange(key_path.parent, {key_path.name: File(pem, secret=True)}, private=True))
    else:
        shown = Origin(inputs.workspace.shown(key_path))
        key = load_key(pem, spec.key, inputs.environment, shown, spec.origin)
    above = minted[spec.issuer] if spec.issuer else None
    issuer = above.issuer if above else None
    certificate = inputs.tree.read(certificate_path)
    said: Sequence[Diagnostic] = ()
    if certificate is None or not satisfies(certificate, spec, key, issuer):
        issued = certificates.issue_authority(spec, key, issuer)
        certificate, said = issued.pem, issued.diagnostics
        changes += changed(inputs.tree, certificate_path.parent, {certificate_path.name: File(certificate)})
    chain = certificate + (above.chain if above else b"")
    return (
        MintedAuthority(
            issuer=certificates.Issuer(certificates.load(certificate), key),
            chain=chain,
            signer=Signer(authority.name, certificate, pem, secret),
        ),
        tuple(changes),
        said,
    )
