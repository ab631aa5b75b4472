# SPDX-License-Identifier: Apache-2.0
"""``keymint verify``: decisions of transports are compared with the policy; mismatches are reported with a reason."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from keymint.pki import smime
from tests.conftest import Outcome
from tests.opened_governance import open_governance

SIMULATED = ("omg", "cyclonedds-0.10", "fastdds-2.9")
ASKED = [argument for name in SIMULATED for argument in ("-i", name)]
POLICY = """<profiles>
  <profile name="arm">
    <attachment>/cell/arm</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/cell/state</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
    <ros_topic qualifier="ALLOW">
      <attachment>/cell/log/*</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
    <ros_topic qualifier="DENY">
      <attachment>/cell/log/private*</attachment>
      <permissions><ros_subscribe/></permissions>
    </ros_topic>
    <ros_service qualifier="ALLOW">
      <attachment>/cell/home</attachment>
      <permissions><ros_execute/></permissions>
    </ros_service>
  </profile>
  <profile name="bridge">
    <attachment>/cell/bridge</attachment>
    <topic qualifier="ALLOW">
      <attachment>telemetry</attachment>
      <partitions><partition>ops</partition></partitions>
      <permissions><publish/></permissions>
    </topic>
    <ros_action qualifier="ALLOW">
      <attachment>/cell/move</attachment>
      <permissions><ros_request/></permissions>
    </ros_action>
  </profile>
</profiles>
"""


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for what all tests start from."""
    return tmp_path_factory.mktemp("cell")


@pytest.fixture
def cell(keymint: Callable[..., Outcome], once: Path, tmp_path: Path) -> Path:
    """A provisioned workspace with rules of many kinds."""
    if not (once / "ws").exists():
        (once / "policy.xml").write_text(POLICY)
        outcome = keymint("provision", "policy.xml", "-w", "ws", cwd=once)
        assert outcome.code == 0, outcome.err
    shutil.copytree(once, tmp_path, dirs_exist_ok=True)
    return tmp_path / "ws"


@pytest.fixture
def edited(keymint: Callable[..., Outcome], cell: Path) -> Callable[..., Outcome]:
    """Edit a built document by hand, sign and install it, and verify."""

    def run(package: str, change: Callable[[str], str], *arguments: str) -> Outcome:
        path = cell / "build" / package / "permissions.xml"
        before = path.read_text()
        path.write_text(change(before))
        assert path.read_text() != before
        outcome = keymint("install", "--no-prove", "--yes", cwd=cell)
        assert outcome.code == 0, outcome.err
        return keymint("verify", "--json", *(arguments or ASKED), cwd=cell)

    return run


def findings(outcome: Outcome, transport: str = "omg") -> list[dict]:
    (found,) = [each for each in outcome.document["result"]["transports"] if each["name"] == transport]
    return found["findings"]


def requests(outcome: Outcome, transport: str = "omg") -> dict[str, set[str]]:
    said: dict[str, set[str]] = {"false-positive": set(), "false-negative": set()}
    for finding in findings(outcome, transport):
        said[finding["error"]].add(finding["request"])
    return said


def line_of(path: Path, text: str) -> int:
    return next(number for number, line in enumerate(path.read_text().splitlines(), 1) if text in line)


class TestWhatIsInstalledFromThePolicy:
    def test_has_no_error_on_any_transport(self, keymint, cell: Path) -> None:
        outcome = keymint("verify", "--json", *ASKED, cwd=cell)
        assert outcome.code == 0, outcome.out
        result = outcome.document["result"]
        assert [each["name"] for each in result["transports"]] == list(SIMULATED)
        for each in result["transports"]:
            counts = each["confusion"]
            assert counts["false_positive"] == counts["false_negative"] == 0
            assert sum(counts.values()) == result["edges"]
            assert counts["true_positive"] > 10
            assert counts["true_negative"] > 50
        assert result["subjects"] == ["/cell/arm", "/cell/bridge"]

    def test_is_shown_as_a_table(self, keymint, cell: Path) -> None:
        outcome = keymint("verify", *ASKED, cwd=cell)
        assert outcome.err == ""
        assert re.search(r"^omg +1\.1 +\d+ +0 +0 +\d+$", outcome.out, re.MULTILINE)
        assert "no mismatches between policy and transports" in outcome.out

    def test_one_package_alone(self, keymint, cell: Path) -> None:
        outcome = keymint("verify", "--json", "/cell/bridge", *ASKED, cwd=cell)
        assert outcome.code == 0
        assert outcome.document["result"]["subjects"] == ["/cell/bridge"]

    def test_each_document_is_parsed_once_whatever_the_number_of_transports(
        self, keymint, cell: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        counts: Counter[tuple[str, bytes]] = Counter()

        def counted(name: str) -> Callable[..., object]:
            original = getattr(smime, name)

            def call(signed: bytes, *arguments: object, **options: object) -> object:
                counts[name, signed] += 1
                return original(signed, *arguments, **options)

            return call

        monkeypatch.setattr(smime, "verify", counted("verify"))
        monkeypatch.setattr(smime, "signed_content", counted("signed_content"))
        assert keymint("verify", *ASKED, cwd=cell).code == 0
        permissions = {path.read_bytes() for path in cell.glob("install/enclaves/**/permissions.p7s")}
        assert len(permissions) == 2
        for name in ("verify", "signed_content"):
            assert {signed: counts[name, signed] for signed in permissions} == dict.fromkeys(permissions, 1)

    def test_writes_nothing(self, keymint, cell: Path) -> None:
        before = {path: path.stat().st_mtime_ns for path in cell.rglob("*")}
        keymint("verify", *ASKED, cwd=cell)
        assert {path: path.stat().st_mtime_ns for path in cell.rglob("*")} == before


class TestEditsByHand:
    """Each is signed properly, so that only its meaning gives it away."""

    def test_a_deny_moved_behind_an_allow(self, edited, cell: Path, tmp_path: Path) -> None:
        def move(text: str) -> str:
            deny = re.search(r" *<deny_rule>.*?</deny_rule>\n", text, re.DOTALL)
            assert deny
            return text.replace(deny[0], "").replace("      <default>", f"{deny[0]}      <default>")

        outcome = edited("cell/arm", move)
        assert outcome.code == 3
        for transport in SIMULATED:
            said = requests(outcome, transport)
            assert "/cell/arm ros_subscribe /cell/log/privatex" in said["false-positive"]
            assert said["false-negative"] == set()
            assert all(
                request.startswith("/cell/arm ros_subscribe /cell/log/private") for request in said["false-positive"]
            )
        finding = findings(outcome)[0]
        assert finding["policy"]["rule"]["file"].endswith("policy.xml")
        assert finding["policy"]["rule"]["line"] == line_of(tmp_path / "policy.xml", "DENY")
        document = cell / "install/enclaves/cell/arm/permissions.xml"
        assert finding["transport"]["rule"]["file"] == "install/enclaves/cell/arm/permissions.xml"
        assert "rt/cell/log/*" in "".join(
            document.read_text().splitlines()[finding["transport"]["rule"]["line"] - 1 :][:6]
        )

    def test_a_widened_glob(self, edited, cell: Path) -> None:
        outcome = edited("cell/arm", lambda text: text.replace("<topic>rt/cell/state<", "<topic>rt/cell/state*<"))
        said = requests(outcome)
        assert "/cell/arm ros_publish /cell/statex" in said["false-positive"]
        assert said["false-negative"] == set()
        finding = next(each for each in findings(outcome) if each["request"].endswith("statex"))
        assert finding["policy"] == {"allowed": False, "reason": "no ALLOW rule matches", "rule": None, "audit": False}
        assert finding["transport"]["rule"]["line"] <= line_of(
            cell / "install/enclaves/cell/arm/permissions.xml", "rt/cell/state*"
        )

    def test_a_narrowed_glob(self, edited) -> None:
        outcome = edited("cell/arm", lambda text: text.replace("<topic>rt/cell/log/*<", "<topic>rt/cell/log/?*<"))
        assert "/cell/arm ros_publish /cell/log/" in requests(outcome)["false-negative"]
        assert requests(outcome)["false-positive"] == set()

    def test_a_missing_partition(self, edited, tmp_path: Path) -> None:
        outcome = edited(
            "cell/bridge", lambda text: re.sub(r" *<partitions>.*?</partitions>\n", "", text, count=1, flags=re.DOTALL)
        )
        for transport in SIMULATED:
            said = requests(outcome, transport)
            assert "/cell/bridge publish telemetry in partition 'ops'" in said["false-negative"]
            assert "/cell/bridge publish telemetry" in said["false-positive"]
        lost = next(each for each in findings(outcome) if each["error"] == "false-negative")
        assert lost["policy"]["rule"]["line"] == line_of(tmp_path / "policy.xml", "<topic ")
        assert lost["edge"]["partitions"] == ["ops"]

    def test_a_wrong_subject(self, edited) -> None:
        outcome = edited(
            "cell/arm", lambda text: re.sub("<subject_name>CN=[^<]*", "<subject_name>CN=/cell/leg,OU=1", text)
        )
        for transport in SIMULATED:
            found = findings(outcome, transport)
            assert {each["edge"]["subject"] for each in found} == {"/cell/arm"}
            assert all("no grant" in each["transport"]["reason"] for each in found)
            assert requests(outcome, transport)["false-positive"] == set()
            assert "/cell/arm ros_publish /cell/state" in requests(outcome, transport)["false-negative"]

    def test_an_expired_grant(self, edited) -> None:
        def expire(text: str) -> str:
            text = re.sub("<not_before>[^<]*", "<not_before>2020-01-01T00:00:00", text)
            return re.sub("<not_after>[^<]*", "<not_after>2020-02-01T00:00:00", text)

        outcome = edited("cell/bridge", expire)
        for transport in SIMULATED:
            found = findings(outcome, transport)
            assert "/cell/bridge ros_request /cell/move" in requests(outcome, transport)["false-negative"]
            assert requests(outcome, transport)["false-positive"] == set()
            assert all("expired" in each["transport"]["reason"] for each in found)
        assert {each["subject"] for each in outcome.document["diagnostics"]} == {"/cell/bridge"}
        assert len(outcome.document["diagnostics"]) == 1, "one cause is told once"

    def test_a_default_of_allow_is_a_matter_of_vendors(self, edited) -> None:
        outcome = edited("cell/arm", lambda text: text.replace("<default>DENY<", "<default>ALLOW<"))
        assert requests(outcome, "omg")["false-positive"]
        assert requests(outcome, "cyclonedds-0.10")["false-positive"]
        assert requests(outcome, "fastdds-2.9")["false-positive"] == set()

    def test_what_one_vendor_reads_differently(self, edited) -> None:
        """Cyclone's check of a topic ignores the direction: "deny subscribe" of a topic also stops publishing it."""

        def deny_first(text: str) -> str:
            deny = (
                "      <deny_rule><domains><id>0</id></domains><subscribe><topics>"
                "<topic>rt/cell/state</topic></topics></subscribe></deny_rule>\n"
            )
            return text.replace("      <allow_rule>", f"{deny}      <allow_rule>", 1)

        outcome = edited("cell/arm", deny_first)
        assert findings(outcome, "omg") == findings(outcome, "fastdds-2.9") == []
        lost = requests(outcome, "cyclonedds-0.10")
        assert "/cell/arm ros_publish /cell/state" in lost["false-negative"]
        finding = findings(outcome, "cyclonedds-0.10")[0]
        assert "9" in finding["transport"]["deviation"]
        assert "deviates from the standard" in outcome.document["diagnostics"][0]["message"]

    def test_a_rule_for_a_name_that_no_policy_mentions(self, edited) -> None:
        outcome = edited(
            "cell/arm", lambda text: text.replace("<topic>rt/cell/state<", "<topic>rt/spy</topic><topic>rt/cell/state<")
        )
        assert "/cell/arm publish rt/spy" in requests(outcome)["false-positive"]

    def test_the_wrong_domain(self, edited) -> None:
        outcome = edited("cell/bridge", lambda text: text.replace("<id>0</id>", "<id>7</id>"))
        assert "/cell/bridge ros_request /cell/move" in requests(outcome)["false-negative"]

    def test_all_of_them_are_counted_whatever_the_limit(self, edited) -> None:
        outcome = edited(
            "cell/arm", lambda text: text.replace("<topic>rt/cell/state<", "<topic>rt/cell/*<"), *ASKED, "--limit", "2"
        )
        (omg,) = [each for each in outcome.document["result"]["transports"] if each["name"] == "omg"]
        assert len(omg["findings"]) == 2
        assert omg["confusion"]["false_positive"] == 2 + omg["findings_omitted"] > 2
        assert "findings-omitted" in outcome.codes()

    def test_words(self, edited, keymint, cell: Path) -> None:
        edited("cell/arm", lambda text: text.replace("<topic>rt/cell/state<", "<topic>rt/cell/state*<"))
        outcome = keymint("verify", *ASKED, cwd=cell)
        assert outcome.code == 3
        (line,) = outcome.err.splitlines()
        assert line.startswith("install/enclaves/cell/arm/permissions.xml:")
        assert "error: false-positive: /cell/arm ros_publish /cell/state/x: the policy denies it" in line
        assert "omg, cyclonedds-0.10 and fastdds-2.9 allow it" in line
        assert "; also " in line


class TestReports:
    @pytest.fixture
    def wrong(self, edited, tmp_path: Path) -> Path:
        edited("cell/arm", lambda text: text.replace("<topic>rt/cell/state<", "<topic>rt/cell/state*<"))
        return tmp_path / "ws"

    def test_sarif(self, keymint, wrong: Path) -> None:
        assert keymint("verify", "-i", "omg", "--sarif", "out.sarif", cwd=wrong).code == 3
        log = json.loads((wrong / "out.sarif").read_text())
        (run,) = log["runs"]
        assert log["version"] == "2.1.0"
        rules = [rule["id"] for rule in run["tool"]["driver"]["rules"]]
        for result in run["results"]:
            assert rules[result["ruleIndex"]] == result["ruleId"] == "false-positive"
            place = result["locations"][0]["physicalLocation"]
            assert (wrong / place["artifactLocation"]["uri"]).is_file()
            assert place["region"]["startLine"] > 1
        fingerprints = {result["partialFingerprints"]["keymintEdge/v1"] for result in run["results"]}
        assert len(fingerprints) == len(run["results"])

    def test_junit(self, keymint, wrong: Path) -> None:
        assert keymint("verify", *ASKED, "--junit", "out.xml", cwd=wrong).code == 3
        suites = ET.parse(wrong / "out.xml").getroot()
        assert [suite.get("name") for suite in suites] == [f"{name} (decision)" for name in SIMULATED]
        for suite in suites:
            assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
            failed = {case.get("name") for case in suite if case.find("failure") is not None}
            assert failed == {"/cell/arm"}

    def test_of_an_enclave_without_findings(self, keymint, cell: Path) -> None:
        assert keymint("verify", "-i", "omg", "--sarif", "a", "--junit", "b", cwd=cell).code == 0
        assert json.loads((cell / "a").read_text())["runs"][0]["results"] == []
        assert ET.parse(cell / "b").getroot()[0].get("failures") == "0"


class TestGraph:
    def graph(self, tmp_path: Path, edges: list[tuple[str, str, str]]) -> Path:
        path = tmp_path / "graph.json"
        listed = [{"subject": s, "permission": p, "object": o} for s, p, o in edges]
        path.write_text(json.dumps({"format": "keymint-graph", "version": 1, "edges": listed}))
        return path

    def test_is_completed(self, keymint, cell: Path, tmp_path: Path) -> None:
        path = self.graph(
            tmp_path,
            [("/cell/arm", "ros_publish", "/cell/state"), ("/cell/bridge", "ros_call", "/cell/home")],
        )
        outcome = keymint("verify", "--json", "--graph", path, *ASKED, cwd=cell)
        assert outcome.code == 0, outcome.out
        result = outcome.document["result"]
        assert result["edges"] == 2 * 2 * 2
        for each in result["transports"]:
            assert each["confusion"] == {
                "true_positive": 2,
                "false_negative": 0,
                "false_positive": 0,
                "true_negative": 6,
            }

    def test_a_subject_without_an_enclave(self, keymint, cell: Path, tmp_path: Path) -> None:
        path = self.graph(tmp_path, [("/cell/am", "ros_publish", "/cell/state")])
        outcome = keymint("verify", "--graph", path, *ASKED, cwd=cell)
        assert outcome.code == 1
        assert "did you mean '/cell/arm'?" in outcome.err

    def test_without_an_edge(self, keymint, cell: Path, tmp_path: Path) -> None:
        outcome = keymint("verify", "--graph", self.graph(tmp_path, []), *ASKED, cwd=cell)
        assert outcome.code == 1
        assert "nothing to verify" in outcome.err

    def test_only_the_packages_that_are_named(self, keymint, cell: Path, tmp_path: Path) -> None:
        path = self.graph(tmp_path, [("/cell/arm", "ros_publish", "/x"), ("/elsewhere", "ros_publish", "/y")])
        result = keymint("verify", "--json", "--graph", path, "cell/arm", *ASKED, cwd=cell).document["result"]
        assert (result["subjects"], result["edges"]) == (["/cell/arm"], 4)

    def test_that_is_missing(self, keymint, cell: Path) -> None:
        assert keymint("verify", "--graph", "nowhere.json", cwd=cell).code == 1


class TestUsage:
    def test_an_unknown_transport(self, keymint, cell: Path) -> None:
        outcome = keymint("verify", "-i", "omgg", cwd=cell)
        assert outcome.code == 2
        assert "did you mean 'omg'?" in outcome.err

    def test_a_tier_that_a_transport_has_not(self, keymint, cell: Path) -> None:
        outcome = keymint("verify", "-i", "omg", "--tier", "exchange", cwd=cell)
        assert outcome.code == 2
        assert "decision" in outcome.err

    def test_a_package_that_is_not_installed(self, keymint, cell: Path) -> None:
        keymint("create", "/cell/bridge", cwd=cell)
        for file in (cell / "install/enclaves/cell/bridge").iterdir():
            file.unlink()
        (cell / "install/enclaves/cell/bridge").rmdir()
        outcome = keymint("verify", *ASKED, cwd=cell)
        assert outcome.code == 1
        assert "no enclave of /cell/bridge is installed" in outcome.err

    def test_a_workspace_without_packages(self, keymint) -> None:
        assert keymint("init", "empty").code == 0
        outcome = keymint("verify", *ASKED, "-w", "empty")
        assert outcome.code == 1
        assert "there is no package to verify" in outcome.err

    def test_nothing_to_ask_is_no_success(self, keymint, cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("keymint.api.plugin_loader.Plugins.transports_of", lambda *_: ())
        outcome = keymint("verify", cwd=cell)
        assert outcome.code == 1
        assert "no transport supports" in outcome.err


@pytest.mark.parametrize("package", ["cell/arm", "cell/bridge"])
def test_a_governance_rule_that_opens_names_that_no_policy_mentions(keymint, cell: Path, package: str) -> None:
    open_governance(cell, package, "rt/zz*")
    outcome = keymint("verify", "--json", *ASKED, cwd=cell)
    assert outcome.code == 3
    for model in SIMULATED:
        assert any("zzx" in each for each in requests(outcome, model)["false-positive"]), model
