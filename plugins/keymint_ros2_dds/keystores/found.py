# SPDX-License-Identifier: Apache-2.0
"""What a keystore of another tool has: the answer to ``keymint adopt``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from comarmor.errors import Diagnostic, Severity
from keymint.api import FoundAuthority, FoundEnclave, FoundKeystore, KeystoreFiles
from keymint.pki import keys
from keymint_ros2_dds.authority_roles import PERMISSIONS as SIGNS
from keymint_ros2_dds.enclave_layout import GOVERNANCE, GOVERNANCE_P7S, GOVERNANCE_XML
from keymint_ros2_dds.keystores import governance
from keymint_ros2_dds.keystores.authorities import authorities
from keymint_ros2_dds.keystores.contents import Contents, contents
from keymint_ros2_dds.keystores.enclaves import examined
from keymint_ros2_dds.keystores.places import FORMS, places


def found(keystore: KeystoreFiles) -> FoundKeystore:
    """Return what a keystore has: see :meth:`keymint.api.KeystoreReader.found`.

    Raises:
        KeymintError: it has no enclave.
    """
    content = contents(keystore)
    where = places(keystore, content)
    trusted, diagnostics = authorities(keystore, content, where.enclaves)
    enclaves: list[FoundEnclave] = []
    for place in where.enclaves:
        enclave, own = examined(keystore, content, place)
        enclaves.append(enclave)
        diagnostics += own
    defaults: dict[str, bytes] = {}
    diagnostics += _defaults(content, enclaves, trusted, defaults)
    diagnostics += _doubled(content, enclaves)
    secrets = {each.key_file for each in trusted}
    return FoundKeystore(
        form=FORMS[where.layout],
        layout=where.layout,
        subject_format="sros2" if all(each.subject_name == f"CN={each.subject}" for each in enclaves) else "",
        authorities=trusted,
        enclaves=tuple(enclaves),
        kept=tuple(path for path in where.kept if path not in secrets),
        defaults=defaults,
        diagnostics=tuple(diagnostics),
    )


def _defaults(
    content: Contents,
    enclaves: Sequence[FoundEnclave],
    trusted: Sequence[FoundAuthority],
    defaults: dict[str, bytes],
) -> Iterator[Diagnostic]:
    """Yield why the governance cannot become the source of all packages, or add that source to the defaults."""
    documents = {each.subject: each.documents[GOVERNANCE_XML] for each in enclaves if GOVERNANCE_XML in each.documents}
    signer = next((each.name for each in trusted if SIGNS in each.roles), "")
    if not documents or not signer:
        return
    subject, first = next(iter(documents.items()))
    file = _governance_file(enclaves, subject)
    for other, document in documents.items():
        if not governance.is_same(first, document):
            message = f"protects other topics or domains than the governance of {subject}, {content.place(file)}"
            help_ = "all participants of a domain need the same: adopt these enclaves as a keystore of their own"
            where = content.place(_governance_file(enclaves, other))
            yield Diagnostic("adopt-governance", Severity.ERROR, message, where, help_, other)
    made = governance.source(first, signer)
    if made is None:
        message = "has several domain rules, and a profile's defaults have one"
        help_ = "sign a governance with one domain rule, which may have several domains"
        yield Diagnostic("adopt-governance", Severity.ERROR, message, content.place(file), help_)
    else:
        defaults[GOVERNANCE] = made


def _governance_file(enclaves: Sequence[FoundEnclave], subject: str) -> str:
    files: Mapping[str, str] = next(each.files for each in enclaves if each.subject == subject)
    return files[GOVERNANCE_P7S]


def _doubled(content: Contents, enclaves: Sequence[FoundEnclave]) -> Iterator[Diagnostic]:
    """Yield an error for a subject or a key that two enclaves have."""
    seen: dict[str, FoundEnclave] = {}
    for each in enclaves:
        key = keys.fingerprint(keys.public_of(each.key)) if each.key else ""
        for what, name in ((f"the subject {each.subject}", each.subject), ("one private key", key)):
            other = seen.setdefault(name, each) if name else each
            if other is not each:
                message = f"has {what}, like {other.subject} ({other.facts['place']})"
                where = content.place(str(each.facts["place"]))
                help_ = "each enclave needs a name and a key of its own: remove one, or make a new key for it"
                yield Diagnostic("adopt-doubled", Severity.ERROR, message, where, help_, each.subject)
