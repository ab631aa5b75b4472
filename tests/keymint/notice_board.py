# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002 - the interface has the arguments
"""A build type whose rights hang in one place: a signed board with the rules of all subjects.

It stands beside the build type of DDS in the enclaves of the tests.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from comarmor.errors import Diagnostic, Origin, Reason, Severity
from keymint import api
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint.pki import smime
from tests.keymint.plain_build_type import PlainBuildType

BOARD, SIGNATURE, NOTE = "board/rights.json", "board/rights.json.p7s", "note.txt"
NAME = "notice_board"


def register(folder: Path) -> None:
    """Make a folder for ``sys.path`` that registers the build type."""
    info = folder / "notice_board-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: notice-board\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[keymint.build_types]\n{NAME} = {__name__}:build_type\n")


def lines(rules: SubjectRules) -> list[str]:
    return [
        f"{rule.effect} {rule.kind} {' '.join(rule.permissions)}: {' '.join(rule.expressions)}" for rule in rules.rules
    ]


class BoardProver(api.Prover):
    def assumptions(self) -> Mapping[str, Sequence[str]]:
        return {"board": ("everybody reads the board",)}

    def differences(self, enclave: api.EnclaveFiles) -> Sequence[Diagnostic]:
        return ()

    def terms(self, enclave: api.EnclaveFiles) -> Sequence[api.ValidityTerm]:
        return ()

    def prove(self, task: api.ProofTask) -> Sequence[api.Claim]:
        enclave = task.enclave
        where = f"{enclave.shared_folder}/{BOARD}"
        if not {BOARD, SIGNATURE} <= enclave.shared.keys():
            raise KeymintError("is missing", where=Origin(where), code="file-missing")
        authority = enclave.anchors.authorities["board"].chain
        smime.verify(enclave.shared[SIGNATURE], authority, at=None, where=Origin(SIGNATURE))
        rights = json.loads(enclave.shared[BOARD])
        return [_claim("be named", task.rules.subject, rights.get(task.rules.subject) == lines(task.rules), where)]


class NoticeBoard(PlainBuildType):
    TRANSPORT = "board"
    DOCUMENT = NOTE
    SHARES = True
    prover = BoardProver()
    LAYOUTS: Mapping[str, api.Layout] = {"sros2": api.Layout("enclaves", reserved=("board",))}

    def files(self, layout: str) -> frozenset[str]:
        return super().files(layout) | {"identity_ca.cert.pem"}

    def authorities(self, package: api.Package) -> Sequence[api.AuthorityRole]:
        return (
            *super().authorities(package),
            api.AuthorityRole("board", package.grant.issuer, package.grant.origin, signs=True),
        )

    def build(self, package: api.Package, options: api.BuildOptions) -> api.BuildResult:
        return api.BuildResult({NOTE: f"{package.subject} at {len(package.grant.rules.rules)} rules\n".encode()})

    def install(self, package, documents, credentials, layout, installed) -> Mapping[str, api.Artifact]:
        plain = super().install(package, documents, credentials, layout, installed)
        return {**plain, "identity_ca.cert.pem": api.Artifact(credentials.chains["identity"])}

    def check(self, inspection: api.Inspection) -> Sequence[Diagnostic]:
        assert inspection.files.keys() <= self.files("")
        return [
            Diagnostic("note-differs", Severity.ERROR, "is another note", Origin(f"{inspection.folder}/{name}"))
            for name, content in inspection.documents.items()
            if inspection.files.get(name) != content
        ]

    def build_shared(self, packages: Sequence[api.Package], options: api.BuildOptions) -> api.BuildResult:
        rights = {package.subject: lines(package.grant.rules) for package in packages}
        return api.BuildResult({BOARD: (json.dumps(rights, indent=1) + "\n").encode()})

    def install_shared(self, packages, documents, credentials, layout, installed) -> Mapping[str, api.Artifact]:
        signer, content, signed = (
            smime.load_signer(credentials.signers["board"]),
            documents[BOARD],
            installed.get(SIGNATURE),
        )
        if signed is None or not smime.is_current(signed, content, signer.certificate):
            signed = smime.sign(content, signer.certificate, signer.key)
        return {BOARD: api.Artifact(content), SIGNATURE: api.Artifact(signed)}

    def check_shared(self, inspection: api.Inspection) -> Iterator[Diagnostic]:
        where = Origin(f"{inspection.folder}/{SIGNATURE}")
        if SIGNATURE not in inspection.files:
            yield Diagnostic("file-missing", Severity.ERROR, "is missing", where)
            return
        try:
            content = smime.verify(
                inspection.files[SIGNATURE], inspection.chains["board"], at=inspection.now, where=where
            )
        except KeymintError as error:
            yield from error.diagnostics
            return
        if content != inspection.files.get(BOARD):
            yield Diagnostic("board-unsigned", Severity.ERROR, "signs another board", where)
        if content != inspection.documents[BOARD]:
            yield Diagnostic("board-stale", Severity.WARNING, "the sources build another board", where)

    def prove_shared(self, task: api.SharedProofTask) -> Sequence[api.Claim]:
        assert {f"/{package.name}" for package in task.packages} == task.rules.keys()
        assert not any(task.rules[each.subject].rules for each in task.packages if each.role is api.Role.INFRASTRUCTURE)
        known = {package.subject for package in task.packages}
        strangers = [subject for subject in json.loads(task.shared.get(BOARD, b"{}")) if subject not in known]
        where = f"{task.shared_folder}/{BOARD}"
        return [_claim("have a package", (strangers or [""])[0], not strangers, where)]


def _claim(action: str, subject: str, holds: bool, file: str) -> api.Claim:
    refuted = api.Counterexample(
        api.Endpoint(subject, action, "anything"),
        None,
        api.PolicyDecision(allowed=False, where=None, reason=Reason(("the policy says nothing",))),
        api.Verdict(allowed=True, reason="the board names it", where=Origin(file, 1)),
    )
    proof = api.Proof.PROVEN if holds else api.Proof.COUNTEREXAMPLE
    domains = (api.DomainRange(0, 0),)
    return api.Claim("board", action, domains, "all names", proof, counterexample=None if holds else refuted)


build_type = NoticeBoard()
