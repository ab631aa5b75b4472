# SPDX-License-Identifier: Apache-2.0
"""``keymint report``: ten questions of a security officer about the example of a fleet, and who signs the answers."""

from __future__ import annotations

import html.parser
import json
import re
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from keymint.errors import KeymintError
from keymint.pki import certificates, keys, smime
from tests.conftest import CHECKOUT, NOW, Outcome
from tests.keymint.examine.test_not_examined import document as asked_by_auditor, give
from tests.real.signed_readers import Libcrypto

DAY = 24 * 3600
AUDIT_CA = '<authority name="audit_ca"><cert><issuer_name></issuer_name></cert></authority>'
GAINED = """<xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>/robot1/cmd_vel</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
"""


def with_audit_ca(root: Path, authority: str = AUDIT_CA) -> None:
    file = root / "profile/authorities.xml"
    file.write_text(file.read_text().replace("</authorities>", f"{authority}</authorities>"))


def git(folder: Path, *words: str, at: int = NOW) -> None:
    names = {"GIT_AUTHOR_NAME": "n", "GIT_AUTHOR_EMAIL": "e@x", "GIT_COMMITTER_NAME": "n", "GIT_COMMITTER_EMAIL": "e@x"}
    dates = {"GIT_COMMITTER_DATE": f"@{at} +0000", "PATH": "/usr/bin:/bin", "HOME": str(folder)}
    subprocess.run(["git", *words], cwd=folder, env=names | dates, check=True, capture_output=True)


@pytest.fixture
def fleet(keymint: Callable[..., Outcome], tmp_path: Path) -> Path:
    """The workspace of the fleet a week and a day later: a right more, certificates for two weeks, a stolen key."""
    shutil.copytree(CHECKOUT / "examples/fleet", tmp_path / "fleet")
    before = {"SOURCE_DATE_EPOCH": str(NOW - 8 * DAY)}
    assert keymint("provision", "fleet", "-w", "ws", env=before).code == 0
    with_audit_ca(tmp_path / "ws")
    assert keymint("install", "-w", "ws", env=before).code == 0
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "first", at=NOW - 8 * DAY)
    policy = tmp_path / "fleet/fleet.xml"
    head, dashboard = policy.read_text().split('<profile name="dashboard">')
    include = '<xi:include href="common/node.xml" parse="xml"/>\n'
    policy.write_text(f'{head}<profile name="dashboard">{dashboard.replace(include, GAINED, 1)}')
    assert keymint("set", "valid-for", "2w", "-w", "ws").code == 0
    assert keymint("provision", "fleet", "-w", "ws").code == 0
    assert keymint("revoke", "robot2/lidar", "--reason", "key-compromise", "-w", "ws").code == 0
    return tmp_path / "ws"


ASKED = ("--safety", "/*/cmd_vel", "--safety", "/*/navigate", "--since", "7d")


def evidence(run: Callable[..., Outcome], *words: str) -> dict[str, Any]:
    """Return the report that is written as JSON; ``--json`` has the same one."""
    outcome = run("report", "-w", "ws", "-o", "audit.json", *words, "--json")
    found = outcome.document["result"]
    written = json.loads(Path(found["file"]).read_text()) if Path(found["file"]).is_absolute() else None
    assert written is None or written == found["report"]
    assert (outcome.code, outcome.err) == (0, "")
    return found["report"]


class Page(html.parser.HTMLParser):
    """The text of a page by the identifier of its sections, and what it could load or run."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.sections: dict[str, str] = {}
        self.active: list[str] = []
        self._at = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self._at = given["id"] if tag == "section" and given.get("id") else self._at
        outside = {name for name in given if name in {"src", "action", "style"} or name.startswith("on")}
        if (
            tag in {"script", "img", "iframe", "link", "object"}
            or outside
            or not (given.get("href") or "#").startswith("#")
        ):
            self.active.append(f"{tag} {given}")

    def handle_data(self, data: str) -> None:
        self.sections[self._at] = self.sections.get(self._at, "") + data

    def handle_endtag(self, tag: str) -> None:
        self.sections[self._at] = self.sections.get(self._at, "") + (" " if tag in {"td", "dt", "dd", "li"} else "")

    def text(self, section: str) -> str:
        return " ".join(self.sections[section].split())


def test_ten_questions_of_a_security_officer(keymint: Callable[..., Outcome], fleet: Path) -> None:
    """Neither the JSON nor the page leaves one to another command."""
    found = evidence(keymint, *ASKED)
    assert keymint("report", "-w", "ws", "-o", "audit.html", *ASKED).code == 0
    page = Page((fleet.parent / "audit.html").read_text())
    assert json.loads((fleet.parent / "audit.json").read_text()) == found
    assert (page.active, found["unknown"], found["format"]) == ([], {}, "keymint-audit")

    # Who can move robot1?
    who = {
        (each["expression"], each["permission"]): [one["subject"] for one in each["holders"]]
        for each in found["reach"]
        if each["safety"]
    }
    assert who["/robot1/cmd_vel", "ros_publish"] == ["/fleet/dashboard", "/robot1/navigator"]
    assert who["/robot1/navigate", "ros_request"] == ["/fleet/dispatcher"]
    assert "/robot1/cmd_vel ros_publish /fleet/dashboard, /robot1/navigator" in page.text("reach")
    # What changed since last week?
    (changed,) = found["changes"]["subjects"]
    gains = [(each["change"], each["permission"], each["pattern"]) for each in changed["changes"]]
    assert (changed["subject"], gains) == ("/fleet/dashboard", [("gains", "ros_publish", "/robot1/cmd_vel")])
    assert "gains" in page.text("changes")
    # Which certificates end this month?
    soon = {(each["what"], each["whose"]) for each in found["ends"] if each["soon"]}
    assert ("certificate", "/robot1/base") in soon
    assert ("permissions", "/robot1/base") in soon
    assert not {whose for _, whose in soon} & {"identity_ca", "permissions_ca", "audit_ca"}
    assert ("certificate", "/robot2/lidar") not in {(each["what"], each["whose"]) for each in found["ends"]}  # revoked
    assert "2027-01-28" in page.text("ends")
    # What is assumed, and for which versions of vendors?
    assert found["proofs"]["models"]["fastdds-2.9"] == "measured"
    assert "ROS names are mapped as the distribution documents it" in found["proofs"]["assumptions"]["omg"]
    for words in (
        "ROS names are mapped as the distribution documents it",
        "fastdds-2.9",
        "cyclonedds-0.10",
        "Fast DDS 2.9.1",
    ):
        assert words in page.text("assumptions")
    # Who was revoked, and why? Which keys were exposed?
    assert {(each["subject"], each["reason"]) for each in found["revoked"]} == {("/robot2/lidar", "key-compromise")}
    assert {each["whose"] for each in found["exposed"]} == {"/robot2/lidar"}
    assert "key-compromise" in page.text("revoked")
    assert "key-compromise" in page.text("exposed")
    # What was not examined?
    assert any("copies on robots" in each for each in found["not_examined"])
    assert "copies on robots" in page.text("not-examined")
    # Which rights are wildcards?
    wild = {(each["subject"], each["expression"]) for each in found["rights"] if "wildcard" in each["risks"]}
    assert wild == {("/fleet/dashboard", f"/robot{number}/*") for number in (1, 2, 3)}
    assert "3 of 181 rights, of /fleet/dashboard" in page.text("answers")
    # Who ran what?
    assert [each["verb"] for each in found["runs"]] == ["provision", "install", "set", "provision", "revoke"]
    assert all(each["user"] and each["host"] and each["version"] for each in found["runs"])
    assert "keymint revoke robot2/lidar --reason key-compromise -w ws" in page.text("runs")
    # What is proven, of which files, by which version, and when?
    assert {each["proof"] for each in found["proofs"]["enclaves"]} == {"proven"}
    assert found["at"].startswith("2027-01-15")
    assert all(re.fullmatch("[0-9a-f]{64}", each) for each in found["sha256"].values())


def test_the_riskiest_rights_come_first(keymint: Callable[..., Outcome], provisioned: Path) -> None:
    risks = [each["risks"] for each in evidence(keymint, "--safety", "/chatter")["rights"]]
    assert risks[:2] == [["safety"], ["safety"]]
    assert not any(risks[2:])


def test_a_raw_topic_is_reached_by_the_ros_name_too(
    keymint: Callable[..., Outcome], provisioned: Path, tmp_path: Path
) -> None:
    raw = (
        """<topic qualifier="ALLOW"><attachment>rt/chatter</attachment><permissions><publish/></permissions></topic>"""
    )
    policy = tmp_path / "policy.xml"
    head, listener = policy.read_text().split('<profile name="listener">')
    policy.write_text(f'{head}<profile name="listener">{listener.replace("<ros_topic", f"{raw}<ros_topic", 1)}')
    (found,) = [each for each in evidence(keymint)["reach"] if each["expression"] == "rt/chatter"]
    assert {each["subject"] for each in found["holders"]} == {"/talker", "/robot1/listener"}


def test_a_report_judges_as_the_verbs_do(keymint: Callable[..., Outcome], provisioned: Path) -> None:
    document = provisioned / "install/enclaves/talker/permissions.p7s"
    document.write_bytes(document.read_bytes().replace(b"rt/chatter", b"rt/chatte?"))
    found = evidence(keymint)
    codes = {each["code"] for each in found["findings"]}
    assert codes >= {*keymint("check", "--no-prove", "-w", "ws", "--json").codes()} - {"assumption"}
    assert codes >= {"smime-altered"}
    assert {each["subject"]: each["proof"] for each in found["proofs"]["enclaves"]}["/talker"] == "unknown"


def test_what_cannot_be_read_is_unknown(keymint: Callable[..., Outcome], provisioned: Path, tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text("<profiles>")
    outcome = keymint("report", "-w", "ws", "-o", "audit.html", "--since", "HEAD")
    assert outcome.code == 3
    assert "the part 'policy' is unknown" in outcome.err
    page = Page((tmp_path / "audit.html").read_text())
    for part in ("reach", "rights", "changes", "proofs", "assumptions"):
        assert "Unknown" in page.text(part)
    assert "No findings" not in page.text("findings")


def test_without_a_repository_changes_are_unknown(keymint: Callable[..., Outcome], provisioned: Path) -> None:
    outcome = keymint("report", "-w", "ws", "-o", "audit.json", "--since", "HEAD", "--json")
    found = outcome.document["result"]["report"]
    assert (outcome.code, [*found["unknown"]], found["changes"]) == (3, ["changes"], None)
    assert found["proofs"]["enclaves"]


def test_an_auditor_without_private_files(provisioned: Path) -> None:
    give(provisioned, "")
    give(provisioned, "private")
    found = asked_by_auditor(provisioned, "report", "-o", "/dev/shm/none/audit.json", "--dry-run")["result"]["report"]
    assert {*found["unknown"]} == {"issued", "runs"}
    assert [found[part] for part in ("revoked", "exposed", "certificates", "runs", "ends")] == [None] * 5
    assert any("private" in each for each in found["not_examined"])


def test_a_critical_object_that_no_right_is_about_may_be_a_slip(
    keymint: Callable[..., Outcome], provisioned: Path
) -> None:
    outcome = keymint("report", "-w", "ws", "-o", "audit.html", "--safety", "/chater", "--safety", "/chatter")
    assert (outcome.code, outcome.err.count("[safety-unmatched]")) == (0, 1)
    assert "no right is about '/chater'" in outcome.err


def test_a_register_that_is_older_than_a_list_knows_not_who_was_revoked(
    keymint: Callable[..., Outcome], provisioned: Path
) -> None:
    register = provisioned / "private/register.sqlite3"
    before = register.read_bytes()
    assert keymint("revoke", "talker", "--reason", "key-compromise", "-w", "ws").code == 0
    register.write_bytes(before)
    outcome = keymint("report", "-w", "ws", "-o", "audit.json", "--json")
    found = json.loads(outcome.out)["result"]["report"]
    assert (outcome.code, found["revoked"], found["exposed"], [*found["unknown"]]) == (3, None, None, ["issued"])


def test_names_are_text_and_nothing_else(keymint: Callable[..., Outcome], provisioned: Path, tmp_path: Path) -> None:
    policy = tmp_path / "policy.xml"
    hostile = "/a&lt;script&gt;alert(1)&lt;/script&gt;&quot;onload=&#x202E;*"
    policy.write_text(policy.read_text().replace("/chatter", hostile))
    assert keymint("report", "-w", "ws", "-o", "audit.html", "--safety", "/<b>*").code == 0
    text = (tmp_path / "audit.html").read_text()
    assert Page(text).active == []
    assert "<script" not in text
    assert "\u202e" not in text
    assert "default-src &#39;none&#39;" in text


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("-o", "audit.pdf"), "neither .html nor .json"),
        (("-o", "audit.html", "--safety", "/a\\"), "/a"),
        (("-o", "audit.html", "--vendors", "nobody=1"), "unknown vendor"),
    ],
)
def test_wrong_usage(keymint: Callable[..., Outcome], provisioned: Path, words: tuple[str, ...], reason: str) -> None:
    outcome = keymint("report", "-w", "ws", *words)
    assert reason in outcome.err
    assert outcome.code == 2


# -- who may sign it -------------------------------------------------------------------------------------------------


@pytest.fixture
def signing(keymint: Callable[..., Outcome], provisioned: Path) -> Path:
    with_audit_ca(provisioned)
    assert keymint("install", "-w", "ws").code == 0
    return provisioned


def verified(ws: Path, report: Path) -> int:
    words = f"cms -verify -attime {NOW} -binary -inform DER -in {report}.p7s -content {report} -out /dev/null"
    command = ["openssl", *words.split(), "-CAfile", ws / "public/audit_ca.cert.pem"]
    return subprocess.run(command, capture_output=True, check=False).returncode


@pytest.mark.parametrize("name", ["audit.html", "audit.json"])
def test_openssl_verifies_a_signed_report(
    keymint: Callable[..., Outcome], signing: Path, tmp_path: Path, name: str
) -> None:
    outcome = keymint("report", "-w", "ws", "-o", name, "--sign", "audit_ca")
    assert (outcome.code, outcome.out) == (0, f"{name}.p7s written\n{name} written\n")
    report = tmp_path / name
    assert verified(signing, report) == 0
    report.write_bytes(report.read_bytes().replace(b"/talker", b"/walker"))
    assert verified(signing, report) != 0


@pytest.mark.parametrize("name", ["identity_ca", "permissions_ca"])
def test_an_authority_that_robots_obey_signs_no_report(
    keymint: Callable[..., Outcome], signing: Path, name: str
) -> None:
    outcome = keymint("report", "-w", "ws", "-o", "audit.html", "--sign", name, "--json")
    assert (outcome.code, outcome.codes()) == (1, ["report-signer"])
    assert "robots obey it" in outcome.document["diagnostics"][0]["message"]
    assert not (signing.parent / "audit.html").exists()


def test_an_authority_below_another_signs_no_report(keymint: Callable[..., Outcome], provisioned: Path) -> None:
    with_audit_ca(provisioned, AUDIT_CA.replace("<issuer_name>", "<issuer_name>permissions_ca"))
    assert keymint("install", "-w", "ws").code == 0
    outcome = keymint("report", "-w", "ws", "-o", "audit.html", "--sign", "audit_ca")
    assert "another authority stands above it" in outcome.err


def test_an_authority_whose_key_a_robot_trusts_signs_no_report(keymint: Callable[..., Outcome], signing: Path) -> None:
    """Somebody added it to an anchor by hand: that is a finding, and until it is gone the key signs no report."""
    anchor = signing / "install/enclaves/talker/permissions_ca.cert.pem"
    content = anchor.read_bytes() + (signing / "public/audit_ca.cert.pem").read_bytes()
    anchor.unlink()
    anchor.write_bytes(content)
    outcome = keymint("report", "-w", "ws", "-o", "audit.html", "--sign", "audit_ca")
    assert "has its key, and robots may trust that file" in outcome.err


def test_an_authority_that_is_not_made_yet_signs_no_report(keymint: Callable[..., Outcome], provisioned: Path) -> None:
    with_audit_ca(provisioned)
    outcome = keymint("report", "-w", "ws", "-o", "audit.html", "--sign", "audit_ca", "--json")
    assert outcome.codes() == ["report-signer-missing"]


def test_nobody_obeys_the_signer_of_reports(
    keymint: Callable[..., Outcome], policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not our reader, and not OpenSSL as the vendors call it; ``tests/real`` asks the vendors."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(int(time.time())))  # OpenSSL has the clock of the machine
    assert keymint("provision", policy, "-w", "ws").code == 0
    signing = tmp_path / "ws"
    with_audit_ca(signing)
    assert keymint("install", "-w", "ws").code == 0
    own = certificates.load((signing / "public/audit_ca.cert.pem").read_bytes())
    key = keys.from_pem((signing / "private/audit_ca.key.pem").read_bytes(), None, None)
    document = signing / "install/enclaves/talker/permissions.p7s"
    authority = (signing / "public/permissions_ca.cert.pem").read_bytes()
    signed = document.read_bytes()
    forged = smime.sign(smime.signed_content(signed), own, key)
    with pytest.raises(KeymintError, match="signed by another certificate than the authority's"):
        smime.read(forged, authority)
    for intern in (True, False):
        openssl = Libcrypto(authority, intern=intern)
        assert (openssl.read(signed) is None, openssl.read(forged)) == (False, None)
    document.unlink()
    document.write_bytes(forged)
    assert "smime-signer" in keymint("check", "-w", "ws", "--json").codes()
