"""The authorities of a workspace: a key and a certificate for each, minted once and kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from cryptography import x509

from keymint.api import Authority, CertificateSpec, Signer
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.pki import certificates, keys
from keymint.plan.inputs import Inputs, LoadedProfile, changed
from keymint.plan.model import Action, File, FolderChange, Plan, Step
from keymint.plan.secrets import load_key, password

STAGE = "authorities"


@dataclass(frozen=True, slots=True)
class MintedAuthority:
    """An authority with its certificate; where its private key is here as well, able to issue and to sign.

    Attributes:
        certificate: its certificate.
        chain: PEM of its certificate, followed by those of the authorities above it up to the root.
    """

    certificate: x509.Certificate
    chain: bytes
    _keyed: tuple[certificates.Issuer, Signer] | KeymintError = field(repr=False)

    @property
    def issuer(self) -> certificates.Issuer:
        """What issues certificates.

        Raises:
            KeymintError: its private key is kept elsewhere, or its password is not set.
        """
        return self._with_key()[0]

    @property
    def signer(self) -> Signer:
        """What signs documents.

        Raises:
            KeymintError: its private key is kept elsewhere, or its password is not set.
        """
        return self._with_key()[1]

    def _with_key(self) -> tuple[certificates.Issuer, Signer]:
        if isinstance(self._keyed, KeymintError):
            raise KeymintError.of(self._keyed.diagnostics)
        return self._keyed


def plan_authorities(inputs: Inputs, loaded: LoadedProfile) -> tuple[Plan, Mapping[str, MintedAuthority]]:
    """Plan the keys and certificates of all authorities that the profile names.

    A key that is there is kept, and one whose certificate is there without it is kept elsewhere: it is not replaced. A
    certificate is issued anew when the profile asks for another one than is there.

    Returns:
        the plan, and the authorities by name as they are when it is carried out.

    Raises:
        KeymintError: a key cannot be read, is not of the kind that the profile asks for, or is needed and elsewhere.
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


def satisfies(pem: bytes, spec: CertificateSpec, key: keys.PublicKey, issuer: x509.Certificate | None) -> bool:
    """Tell whether an authority's certificate is what the profile asks for."""
    return certificates.certificate_satisfies(pem, spec, key, issuer, authority=True)


def _plan_authority(
    inputs: Inputs, authority: Authority, minted: Mapping[str, MintedAuthority]
) -> tuple[MintedAuthority, tuple[FolderChange, ...], Sequence[Diagnostic]]:
    spec = authority.certificate
    key_path = inputs.workspace.authority_key(authority.name)
    certificate_path = inputs.workspace.authority_certificate(authority.name)
    changes: list[FolderChange] = []
    above = minted[spec.issuer] if spec.issuer else None
    certificate, pem = inputs.tree.read(certificate_path), inputs.tree.read(key_path)
    lacking = _lacking(inputs, authority, pem)
    if certificate is not None and lacking is not None:
        return _without_key(inputs, authority, certificate, above, lacking), (), ()
    secret = password(spec.key, inputs.environment, spec.origin)
    if pem is None:
        key = keys.generate(spec.key, spec.origin)
        pem = keys.to_pem(key, secret)
        changes.append(FolderChange(key_path.parent, {key_path.name: File(pem, secret=True)}, private=True))
    else:
        shown = Origin(inputs.workspace.shown(key_path))
        key = load_key(pem, spec.key, inputs.environment, shown, spec.origin)
    said: Sequence[Diagnostic] = ()
    if certificate is None or not satisfies(certificate, spec, key.public_key(), above.certificate if above else None):
        issued = certificates.issue_authority(spec, key, above.issuer if above else None)
        certificate, said = issued.pem, issued.diagnostics
        changes += changed(inputs.tree, certificate_path.parent, {certificate_path.name: File(certificate)})
    loaded = certificates.load(certificate)
    keyed = certificates.Issuer(loaded, key), Signer(authority.name, certificate, pem, secret)
    return MintedAuthority(loaded, certificate + (above.chain if above else b""), keyed), tuple(changes), said


def _lacking(inputs: Inputs, authority: Authority, pem: bytes | None) -> KeymintError | None:
    """Return what keeps an authority's private key from being used here, or None: an offline root is no defect."""
    spec = authority.certificate
    if pem is None:
        certificate = inputs.workspace.shown(inputs.workspace.authority_certificate(authority.name))
        return KeymintError(
            f"the private key of the authority {authority.name!r} is not here, and is needed to sign anew",
            where=Origin(inputs.workspace.shown(inputs.workspace.authority_key(authority.name))),
            help=f"restore it; for a new authority, whose enclaves trust no older ones, remove {certificate} as well",
            code="authority-key-missing",
        )
    try:
        password(spec.key, inputs.environment, spec.origin)
    except KeymintError as error:
        return error
    return None


def _without_key(
    inputs: Inputs, authority: Authority, pem: bytes, above: MintedAuthority | None, lacking: KeymintError
) -> MintedAuthority:
    """Return an authority whose private key cannot be used here.

    Raises:
        KeymintError: the profile asks for another certificate than is here, which takes the key.
    """
    spec = authority.certificate
    shown = inputs.workspace.shown(inputs.workspace.authority_certificate(authority.name))
    certificate = certificates.load(pem, Origin(shown))
    public_key = certificates.public_key(certificate)
    if not keys.fits(public_key, spec.key) or not satisfies(
        pem, spec, public_key, above.certificate if above else None
    ):
        raise lacking
    return MintedAuthority(certificate, pem + (above.chain if above else b""), lacking)
