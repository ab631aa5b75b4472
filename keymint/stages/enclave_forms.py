# SPDX-License-Identifier: Apache-2.0
"""What the new enclaves of a kind have in common, and the enclaves that are filled in from it.

Two members of a kind are signed and proven in full. A file is the same in both, or one of the parts of which each
member has its own: certificate, key, unsigned document, signed document. Another member gets these parts, and is then
read again: see ADR 0040.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from enum import StrEnum

from comarmor.values import Data, replace
from keymint.authority.authorities import Authorities
from keymint.errors import KeymintError
from keymint.life.register import IssuedCertificate, SignedRights
from keymint.pki import certificates, cms, distinguished_names, keys, smime
from keymint.pki.certificate_forms import CommonParts
from keymint.stages.work import NewPackage, PackagePlan
from keymint.store.changes import File
from keymint.view.stamps import digest_files
from keymint.workspace.installed_enclaves import CERTIFICATE


class Part(StrEnum):
    """What a file is, of which each member has its own."""

    CERTIFICATE = "certificate"
    KEY = "key"
    DOCUMENT = "document"
    SIGNED = "signed document"


class OwnFile(Data):
    """A file of which each member has its own.

    Attributes:
        part: what it is.
        document: name of the unsigned document.
        signer: name of the authority that signs it.
    """

    part: Part
    document: str = ""
    signer: str = ""


class EnclaveForm(Data):
    """What the new enclaves of a kind have in common.

    Attributes:
        files: the files that all have, and what the others are, in the order in which they are written.
        issued: the entry of a member in the register, without what is its own.
        rights: the signed documents that are entered there: the name of each, and its end.
        parts: what the certificates have in common.
        documents: the unsigned documents that all have.
    """

    files: Mapping[str, File | OwnFile]
    issued: IssuedCertificate
    rights: tuple[tuple[str, datetime], ...]
    parts: CommonParts
    documents: Mapping[str, File]

    def fill(
        self, new: NewPackage, authorities: Authorities, now: datetime
    ) -> tuple[dict[str, File], IssuedCertificate, tuple[SignedRights, ...]]:
        """Return the files of another member, the entry of its certificate, and its rights for the register.

        Args:
            new: the member.
            authorities: the authorities that sign, by name.
            now: the clock, UTC.

        Raises:
            KeymintError: an authority cannot sign.
        """
        identity, entry, files = new.package.identity, self.issued, dict[str, File]()
        (key,) = new.key.files.values()
        written = distinguished_names.written_name(identity.subject_name)
        signing_key = authorities[identity.issuer].issuer.key
        certificate, serial = self.parts.fill(written.encoded, keys.public_der_of_file(key.content), signing_key)
        documents = {name: each.content for name, each in new.documents.items()}
        contents = {Part.KEY: key.content, Part.CERTIFICATE: certificates.pem_of(certificate)}
        for name, file in self.files.items():
            if isinstance(file, File):
                files[name] = file
            elif file.part is Part.DOCUMENT:
                files[name] = new.documents[file.document]
            elif file.part is Part.SIGNED:
                signer = smime.load_signer(authorities[file.signer].signer)
                signed = smime.sign(documents[file.document], signer.certificate, signer.key)
                files[name] = File(signed, replaces_link=True)
            else:
                files[name] = File(contents[file.part], secret=file.part is Part.KEY, replaces_link=True)
        rights = (
            SignedRights.of(new.name, entry.generation, written.text, end, documents[name]) for name, end in self.rights
        )
        made = IssuedCertificate(
            entry.issuer, serial, entry.authority, new.name, entry.generation, entry.not_before, entry.not_after,
            new.built.fingerprint, digest_files(documents), issued=now,
        )  # fmt: skip
        return files, made, tuple(rights)

    def holds(self, new: NewPackage, chains: Mapping[str, bytes]) -> bool:
        """Read the files of a member again, and return whether each has what the form and the member say.

        Args:
            new: the member.
            chains: the certificate of each authority, and those above it, PEM.
        """
        identity, (key,) = new.package.identity, (name for name, file in new.files.items() if file.secret)
        subject = distinguished_names.written_name(identity.subject_name).encoded
        public = keys.public_der_of_file(new.files[key].content)
        issuer = certificates.load_bundle(chains[identity.issuer])[0]
        own = new.documents
        if any(own.get(name) is not each and own.get(name) != each for name, each in self.documents.items()):
            return False
        for name, file in self.files.items():
            content = new.files[name].content
            document = new.documents[file.document].content if isinstance(file, OwnFile) and file.document else b""
            if isinstance(file, File):
                is_right = content == file.content
            elif file.part is Part.CERTIFICATE:
                is_right = certificates.is_like(content, self.parts, subject, public, issuer)
            elif file.part is Part.KEY:
                is_right = keys.fingerprint_of_file(content) == new.built.fingerprint
            elif file.part is Part.DOCUMENT:
                is_right = content == document
            else:
                is_right = smime.verify(content, chains[file.signer]) == document
            if not is_right:
                return False
        return new.files.keys() == self.files.keys()


_Enclave = tuple[NewPackage, PackagePlan]
"""A package with the files of its enclave, and the plan for this."""


def common_form(one: _Enclave, other: _Enclave, authorities: Authorities) -> EnclaveForm | None:
    """Return what two enclaves have in common; None if others cannot be filled in from it.

    Args:
        one: an enclave.
        other: another one.
        authorities: the authorities that sign, by name.
    """
    entry, second = (_of_all(plan.issued) for _, plan in (one, other))
    identity = one[0].package.identity
    if entry is None or entry != second or one[0].files.keys() != other[0].files.keys():
        return None
    if identity.serial is not None or not keys.is_in_memory(authorities[identity.issuer].issuer.key):
        return None
    files: dict[str, File | OwnFile] = {}
    for name, file in one[0].files.items():
        if file == other[0].files[name]:
            files[name] = file
        elif (own := _own(name, one[0], authorities)) and own == _own(name, other[0], authorities):
            files[name] = own
        else:
            return None
    parts, rights = _parts(one[0]), _rights(one)
    if parts is None or not parts.is_same(_parts(other[0])) or rights is None or rights != _rights(other):
        return None
    documents = {name: file for name, file in one[0].documents.items() if file == other[0].documents.get(name)}
    return EnclaveForm(files, entry, rights, parts, documents)


def _of_all(issued: IssuedCertificate | None) -> IssuedCertificate | None:
    """Return the entry of a certificate without what each member has of its own."""
    return issued and replace(issued, serial=0, name="", key="", rights="")


def _parts(new: NewPackage) -> CommonParts | None:
    return CommonParts.of(certificates.load(new.files[CERTIFICATE].content))


def _rights(enclave: _Enclave) -> tuple[tuple[str, datetime], ...] | None:
    """Return the rights of an enclave as :attr:`EnclaveForm.rights`; None if they have something else."""
    new, plan = enclave
    subject = distinguished_names.written_name(new.package.identity.subject_name).text
    names = {each.content: name for name, each in new.documents.items()}
    found = [(names.get(each.content, ""), each.not_after) for each in plan.signed]
    usual = (new.name, new.package.issuance.generation, subject, None)
    is_usual = all((each.name, each.generation, each.subject, each.accepted) == usual for each in plan.signed)
    return tuple(found) if is_usual and all(name for name, _ in found) else None


def _own(name: str, new: NewPackage, authorities: Authorities) -> OwnFile | None:
    """Return what a file of an enclave is, of which each member has its own; None if that is not known."""
    file = new.files[name]
    if file.secret:
        return OwnFile(Part.KEY) if (file.content,) == tuple(each.content for each in new.key.files.values()) else None
    if name == CERTIFICATE:
        return OwnFile(Part.CERTIFICATE)
    names = {each.content: document for document, each in new.documents.items()}
    if document := names.get(file.content):
        return OwnFile(Part.DOCUMENT, document) if file == new.documents[document] else None
    try:
        signed = smime.unwrap(file.content)
        certificate = cms.parse(signed.signature).certificate
    except (KeymintError, ValueError):
        return None
    document = names.get(signed.content, "")
    signer = next((each for each, of in authorities.items() if cms.identity_of(of.certificate)[0] == certificate), "")
    is_written_so = smime.wrap(signed.content, signed.signature) == file.content
    return OwnFile(Part.SIGNED, document, signer) if document and signer and is_written_so else None
