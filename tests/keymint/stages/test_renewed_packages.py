# SPDX-License-Identifier: Apache-2.0
"""Which packages a renewal takes up."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from keymint_ros import package_type

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import Issuance
from keymint.errors import KeymintError
from keymint.pki import keys
from keymint.stages.package_status import packages_of, refuse_new_authorities, renewable_packages
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from tests.keymint.stages.sessions import session_of

NAMES = ("talker", "robot1/listener")


def codes(ws: Path, *, rekey: bool = False) -> tuple[tuple[str, ...], list[str], list[str]]:
    names, _, requests, errors = renewable_packages(session_of(ws), NAMES, rekey=rekey)
    return tuple(names), [each.code for each in requests], [each.code for each in errors]


def test_all_that_is_installed(ws: Path) -> None:
    assert codes(ws) == (NAMES, [], [])


def test_what_is_not_installed(ws: Path) -> None:
    shutil.rmtree(ws / "install/enclaves/talker")
    assert codes(ws) == (("robot1/listener",), [], ["enclave-missing"])


def test_a_barred_key_needs_a_new_one(keymint: Callable, ws: Path) -> None:
    assert keymint("revoke", "talker", "--reason", "retired", cwd=ws).code == 0
    assert codes(ws) == (("robot1/listener",), [], ["key-barred"])
    assert codes(ws, rekey=True) == (NAMES, [], [])


def test_a_new_key_elsewhere_needs_a_request(ws: Path) -> None:
    key = keys.public_to_pem(ec.derive_private_key(11, ec.SECP256R1()).public_key())
    for file, content in package_type.with_issuance(Issuance(public_key=key)).items():
        (ws / "src/talker" / file).write_bytes(content)
    assert codes(ws, rekey=True) == (("robot1/listener",), ["request-needed"], [])
    assert codes(ws) == (NAMES, [], [])


def test_sources_that_build_other_documents(ws: Path) -> None:
    path = ws / "src/talker/permissions.xml"
    path.write_text(path.read_text().replace("/chatter", "/chatter2"))
    assert codes(ws) == (("robot1/listener",), [], ["sources-changed"])


def test_sources_that_changed_and_build_the_same(ws: Path) -> None:
    path = ws / "src/talker/identities.xml"
    path.write_text(path.read_text().replace("?>", "?>\n<!-- mine -->", 1))
    assert codes(ws) == (NAMES, [], [])


def test_a_plan_that_changes_an_authority_is_refused(ws: Path) -> None:
    session = session_of(ws)
    same = Step("authorities", "identity_ca", Action.UNCHANGED)
    other = Step("authorities", "identity_ca", Action.CREATED, (FolderChange(ws / "public", {"x": File(b"")}),))
    refuse_new_authorities(session, Plan((same,), session.state))
    with pytest.raises(KeymintError, match="changes no authority") as error:
        refuse_new_authorities(session, Plan((same, other), session.state))
    assert error.value.diagnostics[0].help == "run 'keymint authority renew identity_ca' first"


def test_the_packages_that_findings_are_about(ws: Path) -> None:
    def found(subject: str = "", file: str = "") -> frozenset[str]:
        where = Origin(file) if file else None
        return packages_of(session_of(ws), [Diagnostic("x", Severity.ERROR, "x", where, "", subject)], NAMES)

    assert found("/talker") == {"talker"}
    assert found(file="ws/src/robot1/listener/permissions.xml") == {"robot1/listener"}
    assert found(file="ws/build/talker/permissions.xml") == {"talker"}
    assert found(file="ws/profile/authorities.xml") == found("/other") == found() == frozenset()
