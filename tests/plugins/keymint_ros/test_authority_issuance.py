# SPDX-License-Identifier: Apache-2.0
"""``authority_issuance.xml``: dates, imported certificates and replacements of authorities, which Keymint writes."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
import xmlschema
from keymint_ros import profile_type
from keymint_ros.decisions import AUTHORITY_ISSUANCE as FILE

from comarmor.data import locate
from keymint.api import Authority, AuthorityIssuance, Phase, Rollover
from tests.keymint.commands.life.test_authority import outside

from .workspaces import ROOT, Workspace, diagnostic_of

DATE = datetime(2027, 3, 1, tzinfo=UTC)
PEM, OTHER = outside("One")[0], outside("Two")[0]
DECIDED = (
    AuthorityIssuance(),
    AuthorityIssuance(renewed=DATE),
    AuthorityIssuance(adopted=PEM),
    *(AuthorityIssuance(DATE, PEM, Rollover(phase, OTHER)) for phase in (Phase.DISTRIBUTE, Phase.REISSUE, Phase.STAGE)),
)


def authority(workspace: Workspace, content: bytes | None = None, name: str = "identity_ca") -> Authority:
    """Load the profile with a document, and return an authority of it."""
    files = {**workspace.profile, **({} if content is None else {FILE: content})}
    profile = profile_type.load(ROOT, files)
    return next(each for each in profile.authorities if each.name == name)


def written(**issuance: AuthorityIssuance) -> bytes:
    [(file, content)] = profile_type.with_authority_issuance(issuance).items()
    assert file == FILE
    return content


@pytest.mark.parametrize("issuance", DECIDED)
def test_what_is_written_is_valid_and_read_back(workspace: Workspace, issuance: AuthorityIssuance) -> None:
    content = written(identity_ca=issuance, permissions_ca=AuthorityIssuance(renewed=DATE))
    xmlschema.XMLSchema10(str(locate("keymint_ros", "schemas") / "authority_issuance.xsd")).validate(content.decode())
    assert authority(workspace, content).issuance == issuance
    assert authority(workspace, content, "permissions_ca").issuance == AuthorityIssuance(renewed=DATE)


def test_without_the_document_nothing_was_decided(workspace: Workspace) -> None:
    plain = authority(workspace)
    assert plain.issuance == AuthorityIssuance()
    assert authority(workspace, written()) == plain
    assert authority(workspace, written(identity_ca=AuthorityIssuance())) == plain


def test_a_renewal_moves_the_end_alone(workspace: Workspace) -> None:
    before = authority(workspace).certificate
    length = before.validity.not_after - before.validity.not_before
    after = authority(workspace, written(identity_ca=AuthorityIssuance(renewed=DATE))).certificate
    assert after == replace(before, validity=replace(before.validity, not_after=DATE + length))
    early = AuthorityIssuance(renewed=before.validity.not_before - timedelta(days=1))
    assert authority(workspace, written(identity_ca=early)).certificate == before


def test_an_imported_certificate_says_everything(workspace: Workspace) -> None:
    spec = authority(workspace, written(identity_ca=AuthorityIssuance(adopted=PEM))).certificate
    assert (spec.adopted, spec.subject_name) == (PEM, "CN=One")
    assert spec.validity.not_after == datetime(2031, 1, 1, tzinfo=UTC)
    assert (spec.key.algorithm, spec.key.curve) == ("ec", "SECP256R1")


@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        (b'name="identity_ca"', b'name="identity-ca"', "authority-unknown", 5),
        (b'name="permissions_ca"', b'name="identity_ca"', "authority-doubled", 8),
        (b"2027-03-01", b"2027-02-30", "schema", 6),
        (b"<renewed>2027", b"<renewed>0027", "date-invalid", 6),
        (b"</renewed>", b"</renewed><other/>", "schema", 6),
        (b"<authority_issuance", b"<!DOCTYPE x><authority_issuance", "", 4),
    ],
)
def test_a_defect_has_its_line(workspace: Workspace, old: bytes, new: bytes, code: str, line: int) -> None:
    decided = AuthorityIssuance(renewed=DATE)
    content = written(identity_ca=decided, permissions_ca=decided)
    assert old in content
    found = diagnostic_of(lambda: authority(workspace, content.replace(old, new, 1)), f"{ROOT}/{FILE}")
    assert found.where is not None
    assert found.where.line == line
    assert found.code == code or not code


@pytest.mark.parametrize("pem", [b"no certificate", PEM + OTHER, PEM.replace(b"MII", b"MIJ", 1)])
def test_what_is_no_certificate_is_an_error(workspace: Workspace, pem: bytes) -> None:
    content = written(identity_ca=AuthorityIssuance(adopted=pem))
    found = diagnostic_of(lambda: authority(workspace, content), f"{ROOT}/{FILE}")
    assert (found.code, found.where and found.where.line) == ("certificate-invalid", 6)
