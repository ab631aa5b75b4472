# SPDX-License-Identifier: Apache-2.0
"""Compare what every certificate in force may present with the policy of its subject.

A holder chooses the documents that it presents. So the claim is about every certificate that is neither expired
nor revoked, and every document that an authority signed, wherever the two lie; the register remembers those that are
no longer here.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from functools import partial

from cryptography import x509

from keymint import __version__, api
from keymint.authority import authority_files
from keymint.authority.authority_files import chains_digest
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.examine.weaknesses import signing_issuers
from keymint.ir import Rule, SubjectRules
from keymint.life.examine import excess_of, outliving_rights
from keymint.life.register import register_error
from keymint.life.workspace_register import has_register, issuer_of, register_of
from keymint.names import ROOT, package_name, subject_of
from keymint.pki import certificates, distinguished_names, smime
from keymint.pki.distinguished_names import to_text
from keymint.pki.smime import SignedDocument
from keymint.robots import bundle
from keymint.stages.proof_results import EnclaveProof, ProofEffort, ProofResults, dump_claims, load_claims
from keymint.stages.prove import STAGE, policy_digest
from keymint.view.stamps import Stamp, State, digest
from keymint.workspace.installed_enclaves import installed_certificate
from keymint.workspace.package_build_types import SHARED, inputs_digest, is_build_current
from keymint.workspace.session import Session, once

_MOST = 1 << 20
"""Largest file in bytes in which a certificate or a signed document is looked for."""
_SIGNED = b"pkcs7-"
_ACTION = "use of any signed document"


_Outliving = tuple[str, str, str, datetime]
"""An earlier document that permits more than the policy: its package, whom, what, in words, and until when."""
_Answer = tuple[tuple[api.Claim, ...], tuple[_Outliving, ...]]


def presented_rights(session: Session, state: State, policy: api.LoadedPolicy, effort: ProofEffort) -> ProofResults:
    """Return the claims about all certificates in force and all signed documents of a workspace.

    Args:
        session: the workspace and its profile.
        state: the record to go on with.
        policy: its policy.
        effort: what to claim, and limits of the search.

    Raises:
        KeymintError: the register or a package has defects.
    """
    proofs: list[EnclaveProof] = []
    outliving: dict[str, Diagnostic] = {}
    for name in session.plugins.names("keymint.build_types"):
        presentation = session.plugins.build_type(name).presentation
        if presentation is None or not (packages := _packages(session, name)):
            continue
        # The answer on record holds if it depends on the same bytes.
        key = f"{SHARED}/presented/{name}"
        inputs, context, stamp = _inputs(session, packages), policy_digest(policy), state.stamp(STAGE, key)
        known = _load(stamp) if stamp and (stamp.inputs, stamp.context) == (inputs, context) else None
        # Earlier, documents may have been in force that are over by then.
        if known and known[0] <= session.now and not effort.standard_only:
            claims, found = known[1]
        else:
            claims, found = _answer(session, policy, effort, presentation, packages)
            if not effort.standard_only and all(claim.proof is api.Proof.PROVEN for claim in claims):
                rows = [(package, subject, excess, until.isoformat()) for package, subject, excess, until in found]
                outputs = {"claims": dump_claims(claims), "outliving": json.dumps([session.now.isoformat(), rows])}
                state = state.updated(STAGE, {key: Stamp(inputs, outputs, context=context)})
        for package, subject, excess, until in found:
            if until >= session.now:
                note = outliving_rights(session, package, subject, excess, until)
                outliving.setdefault(package, note)
        proofs.append(EnclaveProof("", "", claims, build_types=(name,)))
    is_whole = not proofs or (has_register(session) and register_of(session).is_whole)
    return ProofResults((), tuple(proofs), state, {}, frozenset(), {}, session.now, tuple(outliving.values()), is_whole)


def has_earlier(session: Session) -> bool:
    """Tell whether the register has a document that another one replaced, or one of a package that is gone.

    Raises:
        KeymintError: the register is damaged.
    """
    names = [each.name for each in register_of(session).rights if each.not_after >= session.now]
    return len(names) > len({*names} & {*session.packages()})


def _inputs(session: Session, packages: Iterable[str]) -> str:
    """Return the digest of all that the answer depends on, but the policy."""
    files = (part for path in _files(session) for part in (path, session.tree.digest(path.partition(":")[0]) or ""))
    sources = (inputs_digest(session, name) for name in packages)
    register = session.tree.digest(session.workspace.register) or ""
    return digest(__version__, session.vendors_of, chains_digest(session), register, *sources, *files)


def _answer(
    session: Session,
    policy: api.LoadedPolicy,
    effort: ProofEffort,
    presentation: api.Presentation,
    packages: Mapping[str, api.Package],
) -> _Answer:
    """Return the claims about the documents of the build type of some packages, and those that outlive the policy."""
    register = session.workspace.register
    holders = tuple(_holders(session, policy, packages))
    try:
        earlier = {each.content: each for each in register_of(session).rights if each.not_after >= session.now}
    except ValueError:
        raise register_error(session.workspace.origin(register)) from None
    present = tuple(_documents(session, presentation.FILE, packages))
    places = {
        content: f"{session.workspace.shown(register)} ({subject_of(each.name)})" for content, each in earlier.items()
    }
    remembered = (api.PresentableDocument(content, Origin(place)) for content, place in places.items())
    documents = (*(each for each in present if each.proven_for), *remembered, *present)
    task = api.PresentationTask(holders, documents, session.now, effort.states, effort.deadline(), session.vendors_of)
    models = presentation.choosers()[:1] if effort.standard_only else presentation.choosers()
    claims: list[api.Claim] = []
    outliving: list[_Outliving] = []
    for each in presentation.excess(task):
        failing = [claim for claim in each.claims if claim.model in models]
        known = None if each.document.proven_for else earlier.get(each.document.content)
        if known is None:
            claims += failing
        elif failing and known.accepted is None:
            subject, found = each.holder.subject, failing[0]
            excess = excess_of(subject, found.counterexample, found.reason)
            outliving.append((known.name, subject, excess, each.until))
    failed = {claim.model for claim in claims}
    excepted = dict.fromkeys(presentation.trusting_any_signer(), tuple(_signers(session, packages.values())))
    universe = f"{len(holders)} certificates and {len({each.content for each in documents})} signed documents"
    claims += (
        api.Claim(each, _ACTION, (), universe, api.Proof.PROVEN, excepted=excepted.get(each, ()))
        for each in models
        if each not in failed
    )
    return tuple(claims), tuple(outliving)


def _load(stamp: Stamp) -> tuple[datetime, _Answer] | None:
    """Return the recorded answer and its time, or None if it is not legible."""
    try:
        at, rows = json.loads(stamp.outputs["outliving"])
        found = tuple(
            (str(name), str(subject), str(excess), datetime.fromisoformat(end)) for name, subject, excess, end in rows
        )
        return datetime.fromisoformat(at), (load_claims(stamp.outputs["claims"]), found)
    except (ValueError, TypeError, KeyError, IndexError):
        return None


def _packages(session: Session, build_type: str) -> Mapping[str, api.Package]:
    """Return the packages of subjects that a build type builds, by name."""
    names = (name for name in session.packages() if session.role(name) is api.Role.SUBJECT)
    found = (session.package(name, built=is_build_current(session, name)) for name in names)
    return {each.name: each for each in found if build_type in each.build_types}


# -- what lies in the spaces ---------------------------------------------------------------------------------------


@once
def _files(session: Session) -> Mapping[str, bytes]:
    """Return the files of the workspace that may have certificates or signed documents, by path; and of bundles."""
    workspace, tree = session.workspace, session.tree
    spaces = [space for space in workspace.spaces() if space != workspace.private]
    paths = [path for space in spaces for path, is_folder in tree.walk(space) if not is_folder]
    paths += [f"{workspace.root}/{name}" for name, is_folder in tree.names(workspace.root) if not is_folder]
    found: dict[str, bytes] = {}
    for path in paths:
        if path.endswith(".xml"):
            continue
        status = tree.status(path)
        if status is None or status.st_size > bundle.MAX_BYTES:
            continue
        content = tree.try_read(path) or b""
        if content[257:262] == b"ustar":
            with suppress(KeymintError):
                found |= {f"{path}:{name}": each for name, each in bundle.unpack(content, Origin(path)).items()}
        elif len(content) <= _MOST and (_SIGNED in content or certificates.BEGIN in content):
            found[path] = content
    return found


def _documents(
    session: Session, presented: str, packages: Mapping[str, api.Package]
) -> Iterator[api.PresentableDocument]:
    """Yield the signed documents in the spaces.

    That in the enclave of a package, beside a certificate for the package's name, is verified and proven with it.
    """
    signers = [certificates.to_pem(each) for each in authority_files.trusted_authorities(session)]
    workspace, in_place = session.workspace, session.enclaves.relative_to(session.workspace.install)
    places = (workspace.install / in_place, workspace.next_install / in_place)
    owners = {
        str(place if name == ROOT else place / name): to_text(distinguished_names.parse(each.identity.subject_name))
        for name, each in packages.items()
        for place in places
    }
    verified: dict[bytes, SignedDocument | None] = {}
    found = _files(session)
    for path, content in found.items():
        folder, _, name = path.rpartition("/")
        owner = owners.get(folder, "") if name == presented else ""
        beside = _certificates([found.get(f"{folder}/cert.pem", b"")]) if owner else ()
        if [to_text(each.subject) for each in beside] != [owner]:
            owner = ""
        if content not in verified:
            verified[content] = _signed(content, signers, verify=not owner)
        if signed := verified[content]:
            yield api.PresentableDocument(signed.content, Origin(workspace.shown(path)), signed.lines_before, owner)


def _signed(content: bytes, signers: Iterable[bytes], *, verify: bool) -> SignedDocument | None:
    """Return a signed document, or None if it has not exactly one reading, or none of the signers signed it."""
    for signer in signers:
        with suppress(KeymintError):
            return smime.read(content, signer) if verify else smime.unwrap(content)
    return None


# -- whose certificates are in force ---------------------------------------------------------------------------------


def _holders(session: Session, policy: api.LoadedPolicy, packages: Mapping[str, api.Package]) -> Iterator[api.Holder]:
    """Yield the certificates in force: those in the spaces, and those of the register that are not here."""
    register, now = register_of(session), session.now
    ends: dict[str, datetime] = {}
    issuers = [(issuer_of(each), each) for each in authority_files.trusted_authorities(session)]
    seen: set[tuple[str, int]] = set()
    for certificate in _certificates(_files(session).values()):
        of_others = ((key, each) for key, each in issuers if each != certificate)
        issuer = next((key for key, each in of_others if certificates.is_issued_by(certificate, each)), None)
        if issuer is None:
            continue
        seen.add((issuer, certificate.serial_number))
        if certificate.not_valid_after_utc >= now and not register.is_revoked(issuer, certificate.serial_number):
            name = to_text(certificate.subject)
            ends[name] = max(ends.get(name, now), certificate.not_valid_after_utc)
    names = {(each.name, each.generation): each.subject for each in register.rights}
    for key, each in register.certificates.items():
        if key not in seen and each.revoked is None and each.not_after >= now:
            name = names.get((each.name, each.generation), "")
            package = packages.get(each.name)
            if not name and package and package.issuance.generation == each.generation:
                name = to_text(distinguished_names.parse(package.identity.subject_name))
            if name:
                ends[name] = max(ends.get(name, now), each.not_after)
    by_name = {to_text(distinguished_names.parse(each.identity.subject_name)): each for each in packages.values()}
    by_name |= {subject: packages[name] for (name, _), subject in names.items() if name in packages}
    everywhere = tuple(dict.fromkeys(domain for each in packages.values() for domain in each.grant.domains))
    for name, end in sorted(ends.items()):
        package = by_name.get(name)
        subject = package.subject if package else _common_name(name)
        distro = package.distro if package else session.profile.distro
        rules = SubjectRules(subject, partial(_rules, policy, subject))
        # A subject whose package is gone has the rights that the policy gives it wherever others have theirs.
        yield api.Holder(subject, name, end, rules, distro, package.grant.domains if package else everywhere)


def _rules(policy: api.LoadedPolicy, subject: str) -> tuple[Rule, ...]:
    return (policy.rules(subject) or SubjectRules(subject, ())).rules


def _common_name(name: str) -> str:
    """Return the subject that the common name of a certificate stands for, or the name as it is."""
    parts = dict(distinguished_names.attributes(distinguished_names.parse(name)))
    try:
        return subject_of(package_name(parts.get("CN", "")))
    except KeymintError:
        return name


def _certificates(contents: Iterable[bytes]) -> Iterator[x509.Certificate]:
    """Yield the certificates of identities in some files, each once."""
    for content in dict.fromkeys(each for each in contents if certificates.BEGIN in each):
        with suppress(KeymintError):
            yield from certificates.load_bundle(content)


def _signers(session: Session, packages: Iterable[api.Package]) -> Iterator[str]:
    """Yield an exception if there are identities that can sign documents as older releases verify them."""
    both = signing_issuers(session)
    for package in packages if both else ():
        own, name = installed_certificate(session, package.name), package.identity.issuer
        if name in both and own and certificates.can_sign_documents(own) is None:
            yield (
                f"holders sign their own permissions: the authority {name!r} issues identities and signs documents, "
                "and releases before CVE-2023-24010 was mended accept what an identity signs; 'keymint harden' has "
                "the step"
            )
            return
