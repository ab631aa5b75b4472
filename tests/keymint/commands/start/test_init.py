# SPDX-License-Identifier: Apache-2.0
"""``keymint init``."""

from __future__ import annotations

from pathlib import Path

import pytest
from cryptography import x509

from tests.conftest import snapshot


def test_makes_a_workspace_with_two_self_signed_authorities(keymint, tmp_path: Path) -> None:
    outcome = keymint("init", "ws")
    assert outcome.code == 0, outcome.err
    ws = tmp_path / "ws"
    for path in (
        "profile/keymint_profile.xml",
        "profile/authorities.xml",
        "profile/policies.xml",
        "profile/comarmor.d/common/node.xml",
        "profile/package.defaults/identities.xml",
        "private/identity_ca.key.pem",
        "private/permissions_ca.key.pem",
    ):
        assert (ws / path).is_file(), path
    certificates = [
        x509.load_pem_x509_certificate((ws / f"public/{name}.cert.pem").read_bytes())
        for name in ("identity_ca", "permissions_ca")
    ]
    for certificate in certificates:
        certificate.verify_directly_issued_by(certificate)
        assert certificate.public_key().curve.name == "secp256r1"
    assert certificates[0].public_key() != certificates[1].public_key()
    assert (ws / "private").stat().st_mode & 0o777 == 0o700
    assert (ws / "private/identity_ca.key.pem").stat().st_mode & 0o777 == 0o600


def test_init_alone_is_enough_to_go_on(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    ws = tmp_path / "ws"
    for arguments in (("create", "--all"), ("build",), ("install",), ("check",)):
        outcome = keymint(*arguments, cwd=ws)
        assert outcome.code == 0, outcome.err
    assert (ws / "install/enclaves/talker/permissions.p7s").is_file()


def test_the_current_folder_is_the_default(keymint, tmp_path: Path) -> None:
    assert keymint("init").code == 0
    assert (tmp_path / "profile/keymint_profile.xml").is_file()


def test_again_changes_nothing_and_says_so(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    outcome = keymint("init", "ws")
    assert outcome.code == 0
    assert "nothing to do" in outcome.out
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize(
    ("option", "same", "other"),
    [
        ("--layout", "sros2", "flat"),
        ("--distro", "jazzy", "humble"),
        ("--domain", "3", "4"),
        ("--subject-format", "sros2", "unique"),
        ("--profile-type", "keymint_ros", "another"),
    ],
)
@pytest.mark.parametrize("verb", [("init", "ws"), ("provision", "p.xml", "-w", "ws")], ids=lambda verb: verb[0])
def test_options_of_a_workspace_that_exists_are_refused_where_they_differ(
    keymint, tmp_path: Path, monkeypatch, verb: tuple[str, ...], option: str, same: str, other: str
) -> None:
    info = tmp_path / "installed" / "another-1.dist-info"
    info.mkdir(parents=True)
    (info / "entry_points.txt").write_text("[keymint.profile_types]\nanother = keymint_ros:profile_type\n")
    monkeypatch.syspath_prepend(str(info.parent))
    policy = "<profiles><profile name='a'><attachment>/a</attachment></profile></profiles>"
    (tmp_path / "p.xml").write_text(policy)
    shape = ("--distro", "jazzy", "--domain", "3", "--subject-format", "sros2")
    assert keymint("provision", "p.xml", "-w", "ws", *shape).code == 0
    assert keymint(*verb, option, same).code == 0
    before = snapshot(tmp_path)
    outcome = keymint(*verb, option, other)
    assert outcome.code == 1
    assert f"so {option} {other} cannot take effect" in outcome.err
    assert snapshot(tmp_path) == before


def test_a_domain_that_was_edited_by_hand_counts(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    defaults = tmp_path / "ws/profile/package.defaults/permissions.xml"
    defaults.write_text(
        defaults.read_text().replace("<id>0</id>", "<id>0</id><id_range><min>5</min><max>7</max></id_range>")
    )
    outcome = keymint("init", "ws", "--domain", "5")
    assert outcome.code == 1
    assert "has domain '0, 5-7', so --domain 5 cannot take effect" in outcome.err
    assert outcome.err.startswith("ws/profile/package.defaults/permissions.xml: error: ")
    places = "ws/profile/package.defaults/permissions.xml and ws/profile/package.defaults/governance.xml"
    assert f"('keymint set domain 5' changes it in {places}, or name another workspace)" in outcome.err


def test_the_policy_of_a_workspace_that_exists_stays(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    (tmp_path / "p.xml").write_text("<profiles/>")
    outcome = keymint("init", "ws", "--policy", "p.xml")
    assert outcome.code == 1
    assert "keeps its policy" in outcome.err


def test_files_of_the_user_are_kept(keymint, tmp_path: Path) -> None:
    mine = tmp_path / "ws/profile/comarmor.d/talker_listener.xml"
    mine.parent.mkdir(parents=True)
    mine.write_text("<profiles/>")
    assert keymint("init", "ws").code == 0
    assert mine.read_text() == "<profiles/>"


def test_dry_run_writes_nothing(keymint, tmp_path: Path) -> None:
    outcome = keymint("init", "ws", "--dry-run")
    assert outcome.code == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (("--policy", "nowhere.xml"), 1, "nowhere.xml: error: no such file or folder"),
        (("--distro", "humbel"), 2, "humble"),
        (("--profile-type", "keymint_rso"), 2, "did you mean 'keymint_ros'?"),
    ],
)
def test_bad_options_leave_nothing_behind(keymint, tmp_path: Path, arguments, code: int, expected: str) -> None:
    outcome = keymint("init", "ws", *arguments)
    assert outcome.code == code
    assert expected in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_the_clock_honours_source_date_epoch(keymint, tmp_path: Path) -> None:
    keymint("init", "ws", env={"SOURCE_DATE_EPOCH": "1900000000"})  # 2030-03-17
    assert "2030-03-1" in (tmp_path / "ws/profile/package.defaults/permissions.xml").read_text()


def test_a_bad_source_date_epoch_is_a_usage_error(keymint) -> None:
    outcome = keymint("init", "ws", env={"SOURCE_DATE_EPOCH": "yesterday"})
    assert outcome.code == 2
    assert "SOURCE_DATE_EPOCH" in outcome.err


def test_spaces_can_lie_elsewhere(keymint, tmp_path: Path) -> None:
    options = ("--private-space", tmp_path / "vault", "--install-space", "keystore")
    keymint("init", "ws", *options)
    ws = tmp_path / "ws"
    assert (tmp_path / "vault/identity_ca.key.pem").is_file()
    for arguments in (("create", "--all"), ("build",), ("install",), ("check",)):
        assert keymint(*arguments, *options, cwd=ws).code == 0
    assert (ws / "keystore/enclaves/talker/key.pem").is_file()
    assert not (ws / "private").exists()


def test_spaces_must_not_lie_in_each_other(keymint) -> None:
    outcome = keymint("init", "ws", "--build-space", "src/out")
    assert outcome.code == 2
    assert "is inside the src space" in outcome.err
