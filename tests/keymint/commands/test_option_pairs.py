# SPDX-License-Identifier: Apache-2.0
"""Each option of the verbs that sign holds together with each other option as it holds alone, on every path.

Where two options exclude each other, they are refused together, with the names of both. Without ``KEYMINT_FULL=1``
every third pair of 'provision' and of 'install' is tried.
"""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from cryptography import x509

from keymint import cli
from keymint.client import Client
from tests.conftest import NOW, Outcome, snapshot
from tests.effort import tries

POLICY = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="talker">
    <attachment>/talker</attachment>
    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="listener">
    <attachment>/robot1/listener</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/chatter</attachment><permissions><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
  <profile name="spare"><attachment>/spare</attachment></profile>
</profiles>
"""
SPARE = '<profile name="spare"><attachment>/spare</attachment></profile>'
OPEN = """<topic_rule><topic_expression>rt/open</topic_expression>
<enable_discovery_protection>true</enable_discovery_protection>
<enable_liveliness_protection>true</enable_liveliness_protection>
<enable_read_access_control>true</enable_read_access_control>
<enable_write_access_control>false</enable_write_access_control>
<metadata_protection_kind>ENCRYPT</metadata_protection_kind>
<data_protection_kind>ENCRYPT</data_protection_kind></topic_rule>"""
PORTABILITY = (
    '<topic qualifier="ALLOW"><attachment>rt/a\\[</attachment><permissions><publish/></permissions></topic></profile>'
)
LATE = {"SOURCE_DATE_EPOCH": str(NOW + 300 * 86400)}


class Workspace:
    """A provisioned workspace, with its policy beside it, before an option has its effect."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.policy = root.parent / "policy.xml"
        self.before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}

    def edit(self, file: Path | str, old: str, new: str) -> None:
        """Replace the first occurrence of a text."""
        path = self.root / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    def is_new(self, file: str) -> bool:
        return (self.root / file).read_bytes() != self.before[self.root / file]

    def old_serial(self, name: str) -> int:
        pem = self.before[self.root / f"install/enclaves/{name}/cert.pem"]
        return x509.load_pem_x509_certificate(pem).serial_number

    def is_revoked(self, keymint: Callable[..., Outcome], name: str) -> bool:
        """Tell whether the old certificate of a package is revoked, and each installed list says so."""
        issued = keymint("issued", "--json", cwd=self.root)
        entries = {int(each["serial"], 16): each for each in issued.document["result"]["certificates"]}
        serial = self.old_serial(name)
        lists = [x509.load_pem_x509_crl(path.read_bytes()) for path in self.root.glob("install/**/crl.pem")]
        everywhere = all(any(each.serial_number == serial for each in found) for found in lists)
        return (
            entries[serial]["revoked"] is not None and everywhere and self.is_new(f"install/enclaves/{name}/cert.pem")
        )


Holds = Callable[[Workspace, Callable[..., Outcome], Outcome], bool]


@dataclass(frozen=True)
class Option:
    """An option: its words, what makes the difference in a workspace, and whether it had its effect."""

    words: tuple[str, ...]
    holds: Holds
    prepare: Callable[[Workspace], None] = lambda _workspace: None
    refuses: bool = False
    """It refuses, so that nothing is written."""

    @property
    def name(self) -> str:
        return self.words[0]


def narrow(ws: Workspace) -> None:
    ws.edit(ws.policy, "<attachment>/chatter<", "<attachment>/other<")


def without_spare(ws: Workspace) -> None:
    ws.edit(ws.policy, SPARE, "")
    shutil.rmtree(ws.root / "src/spare")


def open_topic(ws: Workspace) -> None:
    ws.edit("profile/package.defaults/governance.xml", "<topic_rule>", f"{OPEN}<topic_rule>")


def accepted_open_topic(ws: Workspace) -> None:
    open_topic(ws)
    ws.edit("profile/keymint_profile.xml", "</profile>", "<exceptions><open_governance/></exceptions></profile>")


def vendor_specific(ws: Workspace) -> None:
    ws.edit(ws.policy, "</profile>", PORTABILITY)


def with_hints(ws: Workspace) -> None:
    (ws.root.parent / "hints.csv").write_text("subject,permission,object,count\n/nobody,ros_publish,/chatter,3\n")


def edited(ws: Workspace) -> None:
    ws.edit("build/robot1/listener/permissions.xml", "<permissions>", "<!-- mine --><permissions>")


def wider(ws: Workspace) -> None:
    more = '<topic qualifier="ALLOW"><attachment>rt/more</attachment><permissions><publish/></permissions></topic>'
    for topic in ("talker", "robot1/listener"):
        ws.edit(ws.policy, f"<attachment>/{topic}</attachment>", f"<attachment>/{topic}</attachment>{more}")


def rules(content: bytes) -> int:
    return content.count(b"<allow_rule>")


def installed(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return outcome.code == 0


def pruned(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return not (ws.root / "install/enclaves/spare").exists()


def revoked(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return "rights-outlive" not in outcome.codes() and ws.is_revoked(keymint, "talker")


def new_keys(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return all(ws.is_new(f"install/enclaves/{name}/key.pem") for name in ("talker", "robot1/listener"))


def new_authority(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    files = ("public/identity_ca.cert.pem", "install/enclaves/talker/identity_ca.cert.pem")
    return all(ws.is_new(file) for file in files) and ws.is_new("install/enclaves/robot1/listener/cert.pem")


def plain(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    file = ws.root / "build/talker/permissions.xml"
    return rules(file.read_bytes()) > rules(ws.before[file])


def hinted(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return "hints-subject" in outcome.codes()


def refused(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return outcome.code == 3


def forced(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return outcome.code == 0 and b"mine" not in (ws.root / "build/robot1/listener/permissions.xml").read_bytes()


def only_talker(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    listener = ("permissions.xml", "cert.pem", "key.pem")
    own = any(ws.is_new(f"install/enclaves/talker/{file}") for file in listener)
    return own and not any(ws.is_new(f"install/enclaves/robot1/listener/{file}") for file in listener)


PRUNE = Option(("--prune",), pruned, without_spare)
SUPERSEDED = Option(("--revoke-superseded",), revoked, narrow)
NEW_AUTHORITY = Option(("--new-authority", "identity_ca"), new_authority)
NO_PROVE = Option(("--no-prove",), installed, open_topic)
STRICT = Option(("--strict",), refused, accepted_open_topic, refuses=True)
STRICT_MET = Option(("--strict",), installed)
VENDOR_SPECIFIC = Option(("--allow-vendor-specific",), installed, vendor_specific)
PROVISION = (
    PRUNE, SUPERSEDED, NEW_AUTHORITY, NO_PROVE, STRICT, VENDOR_SPECIFIC,
    Option(("--force",), forced, edited),
    Option(("--rekey=*", "--yes"), new_keys),
    Option(("--no-optimise",), plain),
    Option(("--hints", "hints.csv"), hinted, with_hints),
)  # fmt: skip
INSTALL = (PRUNE, SUPERSEDED, NEW_AUTHORITY, NO_PROVE, STRICT, VENDOR_SPECIFIC, Option(("talker",), only_talker, wider))
EXCLUSIVE = {
    frozenset(pair)
    for pair in (("--strict", "--no-prove"), ("--no-optimise", "--hints"), ("talker", "--new-authority"))
}


def pairs(options: tuple[Option, ...]) -> Iterator[tuple[Option, ...]]:
    """Yield each option alone, and each pair."""
    yield from ((each,) for each in options)
    yield from itertools.combinations(options, 2)
    if STRICT in options:
        yield from ((STRICT_MET, each) for each in options if each not in (STRICT, NO_PROVE))


def named(value: object) -> str:
    return "+".join(each.name.lstrip("-") for each in value) if isinstance(value, tuple) else str(value)


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("base")
    (folder / "policy.xml").write_text(POLICY)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", str(NOW))
        assert cli.main(["provision", str(folder / "policy.xml"), "-w", str(folder / "ws"), "-q"]) == 0
    return folder


@pytest.fixture
def workspace(base: Path, tmp_path: Path) -> Workspace:
    shutil.copytree(base, tmp_path, dirs_exist_ok=True)
    return Workspace(tmp_path / "ws")


def built(keymint: Callable[..., Outcome], ws: Workspace, options: tuple[Option, ...]) -> None:
    assert keymint("create", "--all", cwd=ws.root).code == 0
    accepting = VENDOR_SPECIFIC.words if VENDOR_SPECIFIC in options else ()
    outcome = keymint("build", *accepting, cwd=ws.root)
    assert outcome.code == 0, outcome.err


def run(keymint: Callable[..., Outcome], ws: Workspace, verb: str, options: tuple[Option, ...]) -> Outcome:
    words = [word for each in options for word in each.words]
    if verb == "provision":
        return keymint("provision", ws.policy, "-w", ws.root, *words, "--json")
    return keymint("install", "-w", ws.root, *words, "--json")


SIGNING = (("provision", PROVISION), ("install", INSTALL))
TOGETHER = [(verb, each) for verb, options in SIGNING for each in pairs(options)]


@pytest.mark.parametrize(("verb", "options"), TOGETHER[:: tries(3, 1)], ids=named)
def test_options_together(keymint, workspace: Workspace, verb: str, options: tuple[Option, ...]) -> None:
    for each in options:
        each.prepare(workspace)
    if verb == "install":
        built(keymint, workspace, options)
    before = snapshot(workspace.root)
    outcome = run(keymint, workspace, verb, options)
    names = frozenset(each.name for each in options)
    if names in EXCLUSIVE:
        said = (
            " ".join(each["message"] + each["help"] for each in outcome.document["diagnostics"]) if outcome.out else ""
        )
        said += outcome.err
        assert (outcome.code, all(name in said for name in names - {"talker"})) == (2, True)
        assert snapshot(workspace.root) == before
        return
    if any(each.refuses for each in options):
        assert outcome.code == 3, outcome.out
        assert snapshot(workspace.root) == before
        return
    assert outcome.code == 0, outcome.out
    assert [each.name for each in options if not each.holds(workspace, keymint, outcome)] == []
    dry = keymint(verb, *((workspace.policy,) if verb == "provision" else ()), "-w", workspace.root, "--dry-run")
    assert dry.code == 0 or names & {"--no-prove", "--allow-vendor-specific"}, dry.err


@pytest.mark.parametrize(
    ("verb", "option"), [("provision", each) for each in PROVISION] + [("install", each) for each in INSTALL],
    ids=lambda value: value if isinstance(value, str) else value.name,
)  # fmt: skip
def test_the_effect_of_an_option_is_its_own(keymint, workspace: Workspace, verb: str, option: Option) -> None:
    """Without the option its effect is not there, so the other tests can fail."""
    option.prepare(workspace)
    if verb == "install":
        built(keymint, workspace, (option,))
    outcome = run(keymint, workspace, verb, ())
    assert not (outcome.code == 0 or option.refuses) or not option.holds(workspace, keymint, outcome)


@pytest.mark.parametrize("verb", ["provision", "install"])
@pytest.mark.parametrize("others", [(), (PRUNE,), (STRICT,), (PRUNE, STRICT_MET)], ids=named)
def test_a_dry_run_of_them_writes_nothing(keymint, workspace: Workspace, verb: str, others: tuple[Option, ...]) -> None:
    options = (SUPERSEDED, *others)
    for each in options:
        each.prepare(workspace)
    if verb == "install":
        built(keymint, workspace, options)
    before = snapshot(workspace.root)
    outcome = run(keymint, workspace, verb, (*options, Option(("--dry-run",), installed)))
    assert outcome.code == (3 if STRICT in others else 0)
    assert snapshot(workspace.root) == before
    steps = outcome.document["steps"]
    assert not steps or "revoke" in {each["stage"] for each in steps}


@pytest.mark.parametrize("verb", ["provision", "install"])
def test_warnings_are_the_same_when_rights_are_revoked(keymint, workspace: Workspace, verb: str) -> None:
    """Slips in the policy, packages out of date with it, and hints for nobody."""
    narrow(workspace)
    if verb == "install":
        built(keymint, workspace, ())
    copy = '<profile name="talker"><attachment>/robot1/listener</attachment></profile>'
    workspace.edit(
        workspace.policy, SPARE, SPARE + copy + '<profile name="new"><attachment>/new</attachment></profile>'
    )
    alone = run(keymint, workspace, verb, (Option(("--dry-run",), installed),))
    both = run(keymint, workspace, verb, (SUPERSEDED,))
    expected = "profile-name-twice" if verb == "provision" else "policy-changed"
    assert expected in alone.codes()
    assert {*alone.codes()} - {*both.codes()} == {"rights-outlive"}
    if verb == "install":
        assert alone.code == both.code


@pytest.mark.parametrize("verb", ["provision", "install"])
def test_processes_make_the_second_plan_as_well(keymint, tmp_path: Path, verb: str, monkeypatch) -> None:
    """With as many subjects as several processes take, nothing is planned by one process instead."""
    profile = (
        '<profile name="n{0}"><attachment>/n{0}</attachment><ros_topic qualifier="ALLOW"><attachment>/t</attachment>'
        "<permissions><ros_publish/></permissions></ros_topic></profile>"
    )
    policy, ws = tmp_path / "policy.xml", tmp_path / "ws"
    policy.write_text(f"<profiles>{''.join(profile.format(number) for number in range(66))}</profiles>")
    assert keymint("provision", policy, "-w", ws, "-j2").code == 0
    shutil.rmtree(ws / "src/n65")
    text = policy.read_text().replace(profile.format(65), "")
    policy.write_text(text.replace("/t<", "/u<", 1))
    if verb == "install":
        built(keymint, Workspace(ws), ())
    given_up: list[object] = []
    monkeypatch.setattr("keymint.run.execution.Workers.give_up", given_up.append)
    words = ("provision", policy) if verb == "provision" else ("install",)
    outcome = keymint(*words, "-w", ws, "-j2", "--revoke-superseded", "--prune", "--json")
    assert (outcome.code, given_up) == (0, []), outcome.out
    (crl,) = {path.read_bytes() for path in (ws / "install").rglob("crl.pem")}
    assert len(x509.load_pem_x509_crl(crl)) == 1
    assert not (ws / "install/enclaves/n65").exists()
    assert keymint("check", "-w", ws).code == 0


# -- what the profile asks for -----------------------------------------------------------------------------------------


def ask(ws: Workspace) -> None:
    ws.edit("profile/keymint_profile.xml", "</profile>", "<revoke_superseded/></profile>")


@pytest.mark.parametrize("others", [(), (PRUNE,), (STRICT,), (NEW_AUTHORITY,), (NO_PROVE,)], ids=named)
@pytest.mark.parametrize("verb", ["provision", "install"])
def test_the_profile_asks_as_the_option_does(
    keymint, workspace: Workspace, verb: str, others: tuple[Option, ...]
) -> None:
    ask(workspace)
    for each in (SUPERSEDED, *others):
        each.prepare(workspace)
    if verb == "install":
        built(keymint, workspace, others)
    before = snapshot(workspace.root)
    outcome = run(keymint, workspace, verb, others)
    if STRICT in others:
        assert (outcome.code, snapshot(workspace.root) == before) == (3, True)
        return
    assert outcome.code == 0, outcome.out
    assert all(each.holds(workspace, keymint, outcome) for each in (SUPERSEDED, *others))


@pytest.mark.parametrize("asked", [True, False])
def test_the_profile_asks_the_client_too(keymint, workspace: Workspace, asked: bool) -> None:
    if asked:
        ask(workspace)
    narrow(workspace)
    enclave = Client(workspace.root).provision("/talker")
    assert workspace.is_revoked(keymint, "talker") == asked
    assert ("rights-outlive" in {each.code for each in enclave.diagnostics}) != asked
    assert keymint("check", cwd=workspace.root).code == 0


# -- renew and revoke --------------------------------------------------------------------------------------------------


def renewed(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return ws.is_new("install/enclaves/talker/cert.pem")


def others_stay(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return not ws.is_new("install/enclaves/robot1/listener/cert.pem")


def new_key(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return ws.is_new("install/enclaves/talker/key.pem")


def removed(ws: Workspace, keymint: Callable[..., Outcome], outcome: Outcome) -> bool:
    return not (ws.root / "install/enclaves/talker").exists()


NAME = Option(("talker",), only_talker)
RENEW = (NAME, Option(("--threshold", "90%"), others_stay), Option(("--rekey",), new_key), NO_PROVE)
REVOKE = (
    Option(("--reason", "superseded"), renewed),
    Option(("--reason", "key-compromise"), removed),
    Option(("--reason", "retired"), removed),
)


def installed_so(keymint: Callable[..., Outcome], ws: Workspace) -> None:
    """Install what the sources are now, without proof."""
    assert keymint("build", cwd=ws.root).code == 0
    assert keymint("install", "--no-prove", cwd=ws.root).code == 0
    ws.before = {path: path.read_bytes() for path in ws.root.rglob("*") if path.is_file()}


@pytest.mark.parametrize("dry", [(), ("--dry-run",)], ids=["", "dry"])
@pytest.mark.parametrize("options", [*pairs(RENEW)], ids=named)
def test_options_of_renew_together(
    keymint, workspace: Workspace, options: tuple[Option, ...], dry: tuple[str, ...]
) -> None:
    for each in options:
        each.prepare(workspace)
    if NO_PROVE in options:
        installed_so(keymint, workspace)
    before = snapshot(workspace.root)
    words = [word for each in options for word in each.words]
    outcome = keymint("renew", *words, *dry, "--json", cwd=workspace.root, env=LATE)
    if dry:
        assert snapshot(workspace.root) == before
        return
    assert outcome.code == 0, outcome.out
    # With a threshold that nothing has reached, only a named package is renewed.
    nothing = {each.name for each in options} & {"--threshold"} and NAME not in options
    expected = [each for each in options if not (nothing and each.name == "--rekey")]
    assert [each.name for each in expected if not each.holds(workspace, keymint, outcome)] == []
    assert workspace.is_new("install/enclaves/talker/cert.pem") == (not nothing)


def test_a_renewal_proves_unless_it_is_told_otherwise(keymint, workspace: Workspace) -> None:
    NO_PROVE.prepare(workspace)
    installed_so(keymint, workspace)
    assert keymint("renew", cwd=workspace.root, env=LATE).code == 1
    assert keymint("renew", "talker", cwd=workspace.root, env=LATE).code == 1
    assert not workspace.is_new("install/enclaves/talker/cert.pem")


@pytest.mark.parametrize("prove", [(), (NO_PROVE,)], ids=["", "no-prove"])
@pytest.mark.parametrize("dry", [(), ("--dry-run",)], ids=["", "dry"])
@pytest.mark.parametrize("reason", REVOKE, ids=lambda each: each.words[1])
def test_options_of_revoke_together(
    keymint, workspace: Workspace, reason: Option, dry: tuple[str, ...], prove: tuple[Option, ...]
) -> None:
    for each in prove:
        each.prepare(workspace)
        installed_so(keymint, workspace)
    before = snapshot(workspace.root)
    words = [*reason.words, *(word for each in prove for word in each.words)]
    outcome = keymint("revoke", "talker", *words, *dry, "--json", cwd=workspace.root)
    assert outcome.code == 0, outcome.out
    if dry:
        assert snapshot(workspace.root) == before
        return
    assert reason.holds(workspace, keymint, outcome)
    crl = x509.load_pem_x509_crl((workspace.root / "install/enclaves/robot1/listener/crl.pem").read_bytes())
    assert [each.serial_number for each in crl] == [workspace.old_serial("talker")]
    assert others_stay(workspace, keymint, outcome)


def test_a_second_keystore_is_built_as_the_first_one(keymint, workspace: Workspace) -> None:
    VENDOR_SPECIFIC.prepare(workspace)
    assert run(keymint, workspace, "provision", (VENDOR_SPECIFIC,)).code == 0
    staged = keymint("authority", "replace", "identity_ca", "--phase", "stage", "-w", workspace.root)
    assert staged.code == 0, staged.err
    folders = (workspace.root / "install", workspace.root / "install.next")
    first, second = ((folder / "enclaves/talker/permissions.xml").read_bytes() for folder in folders)
    assert first == second


def test_the_router_names_the_new_generation_only(keymint, tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text(POLICY)
    made = keymint("provision", "policy.xml", "-w", "ws", "--transport", "dds", "--transport", "zenoh")
    assert made.code == 0, made.err
    workspace = Workspace(tmp_path / "ws")
    for each in (PRUNE, SUPERSEDED):
        each.prepare(workspace)
    outcome = run(keymint, workspace, "provision", (PRUNE, SUPERSEDED))
    assert outcome.code == 0, outcome.out
    assert all(each.holds(workspace, keymint, outcome) for each in (PRUNE, SUPERSEDED))
    router = (tmp_path / "ws/install/zenoh/router.json5").read_text()
    assert "/other" in router
    assert "/spare" not in router
    for verb in ("check", "prove"):
        assert keymint(verb, "-w", "ws").code == 0
