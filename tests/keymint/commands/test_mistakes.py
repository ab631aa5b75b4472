# SPDX-License-Identifier: Apache-2.0
"""Mistakes that users make, and what they are told: code, exit code, file, line, and remedy.

Each begins from the policy and the workspace of README's quick start. A row without a place, or without a remedy, says
why it has none. The numbers up to 50 are those of a list that was made with new users; the others were found by trying.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from keymint import cli
from tests.conftest import CHECKOUT, NOW
from tests.test_readme import README, saved_files

YEARS = str(NOW + 3 * 366 * 86_400)
USAGE = "the command line has no file"
WHOLE = "it is about the whole policy or workspace, or about what is not there"
DONE = "nothing is wrong: the answer is the remedy"

Change = Callable[[Path], object]


@dataclass(frozen=True)
class Mistake:
    """A mistake and its message.

    Attributes:
        number: its number in the table.
        what: the mistake in words.
        change: makes it, in a folder with ``robot.xml``, and with ``ws`` if the command names that.
        command: the command that meets it.
        code: code of the message; empty if there is none, and ``says`` is part of the results.
        status: exit code.
        says: part of the message.
        where: place of the message, ``file`` or ``file:line``, or why it has none.
        remedy: part of the remedy, or why there is none.
        env: environment variables.
    """

    number: int
    what: str
    change: Change
    command: str
    code: str
    status: int
    says: str
    where: str
    remedy: str
    env: Mapping[str, str] = field(default_factory=dict)


def same(_: Path) -> None:
    """Change nothing: the command is the mistake."""


def edit(*pairs: str, file: str = "robot.xml") -> Change:
    """Return what replaces the first occurrence of texts in a file."""

    def change(at: Path) -> None:
        text = (at / file).read_text()
        for old, new in zip(pairs[::2], pairs[1::2], strict=True):
            assert old in text, old
            text = text.replace(old, new, 1)
        (at / file).write_text(text)

    return change


def write(content: str | bytes, file: str = "robot.xml") -> Change:
    return lambda at: (at / file).write_bytes(content if isinstance(content, bytes) else content.encode())


def remove(file: str) -> Change:
    return lambda at: shutil.rmtree(at / file) if (at / file).is_dir() else (at / file).unlink()


def both(*changes: Change) -> Change:
    return lambda at: [change(at) for change in changes]


def typo(
    what: str, number: int, old: str, new: str, line: int, says: str, remedy: str, code: str = "schema", status: int = 1
) -> Mistake:
    """Return a mistake in the policy that ``lint`` finds, on a line of it."""
    return Mistake(number, what, edit(old, new), "lint robot.xml", code, status, says, f"robot.xml:{line}", remedy)


LEGAL = "e.g. /robot1/talker"
IMAGE, NODE = "<attachment>/image</attachment>", '    <xi:include href="common/node.xml" parse="xml"/>\n'
PARAMETER = (
    '<ros_parameter qualifier="ALLOW"><attachment>/detector/threshold</attachment>'
    "<permissions><ros_read/></permissions></ros_parameter>"
)
KEYS = "private/identities/camera/key.pem"
ENCLAVE = "install/enclaves/camera"

MISTAKES = [
    typo("a misspelt element", 1, "ros_topic", "ros_topc", 9, "expected the end of <ros_topc>", "</ros_topc>",
        "xml-syntax"),
    typo("a misspelt permission", 2, "<ros_publish/>", "<ros_publsh/>", 8, "<ros_publsh>",
        "did you mean 'ros_publish'?"),
    typo("a misspelt qualifier", 3, '"ALLOW"', '"ALOW"', 6, "expected ALLOW or DENY", "did you mean 'ALLOW'?"),
    typo("a misspelt attribute", 4, "qualifier", "qualifer", 6, "unknown attribute", "did you mean 'qualifier'?"),
    typo("an unclosed tag", 5, "  </profile>\n", "", 33, "begins on line 3", "add </profile>", "xml-syntax"),
    typo("xi: is not declared", 6, ' xmlns:xi="http://www.w3.org/2001/XInclude"', "", 5, "prefix", "add xmlns:xi=",
        "xml-syntax"),
    typo("an include that is not there", 7, "/node.xml", "/nodes.xml", 5, "does not exist",
        "did you mean 'node.xml'?", "include-missing"),
    Mistake(8, "no include of common/node.xml", edit(NODE, ""), "lint robot.xml", "node-cannot-start", 0,
        "/camera: a node of this subject cannot start", "robot.xml:3", "include common/node.xml"),
    Mistake(8, "the same, provisioned", edit(NODE, ""), "provision robot.xml -w new", "node-cannot-start", 0,
        "/camera: a node of this subject cannot start", "robot.xml:3", "include common/node.xml"),
    typo("an undefined tunable", 9, "/image", "@{CAM}/image", 7, "@{CAM} is unknown", "declare it", "tunable"),
    typo("a tunable used too early", 9, "    <ros_topic",
        '    <tunable name="A"><value>@{B}</value></tunable>\n    <ros_topic', 6, "@{B} is unknown", "above its use",
        "tunable"),
    *(typo(f"{name} as the name of a subject", 10, "/camera<", f"{name}<", 4, "not a legal name", LEGAL,
        "subject-name") for name in ("/name with blank", "/Robot-1", "/1camera", "/camera/")),
    typo("a regular expression", 11, "/image", "/img.*", 7, "'/img.*'", "write '/img*'", "object-never", 3),
    typo("a DDS name in a ROS rule", 12, "/image", "rt/image", 7, "'rt/image'", "write '/image'", "object-never", 3),
    typo("a typo in one of two profiles", 13, "/image", "/imgae", 7, "(robot.xml:16)", "'/imgae' or '/image'",
        "name-similar", 3),
    Mistake(13, "the typo at the other one", edit("/image", "/imgae", "/image", "/imgae", "/imgae", "/image"),
        "lint robot.xml", "name-similar", 3, "(robot.xml:16)", "robot.xml:7", "'/image' or '/imgae'"),
    typo("a look-alike letter", 14, "/image", "/im\u0430ge", 6, "is not printable ASCII", "write the names out",
        "portability-expression", 3),
    Mistake(15, "a policy of SROS2", write('<policy version="0.2.0"><enclaves/></policy>'),
        "provision robot.xml -w new", "policy-foreign", 1, "this is an SROS2 policy", "robot.xml",
        "keymint import robot.xml"),
    Mistake(16, "another root element", write("<package/>"), "lint robot.xml", "schema", 1,
        "<package> is not expected as the root", "robot.xml:1", "name a file with one of these root elements"),
    Mistake(17, "a picture", write(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"), "lint robot.xml", "xml-syntax", 1,
        "not XML: it looks like a picture", "robot.xml:1", "name an XML file"),
    Mistake(17, "YAML", write("camera:\n  publish: [image]\n"), "provision robot.xml -w new", "xml-syntax", 1,
        "not XML: it looks like YAML", "robot.xml:1", "name an XML file"),
    Mistake(17, "UTF-16 that says UTF-8",
        lambda at: (at / "robot.xml").write_bytes((at / "robot.xml").read_text().encode("utf-16")), "lint robot.xml",
        "xml-encoding", 1, "the file is in UTF-16", "robot.xml:1", "save the file as UTF-8"),
    typo("a parameter where a node is expected", 18, "  </profile>\n\n</profiles>",
        f"{PARAMETER}\n  </profile>\n\n</profiles>", 32, "like a parameter of the node /detector",
        "did you mean '/detector'?", "parameter-object", 3),
    typo("* as what may be published", 19, IMAGE, "<attachment>*</attachment>", 7, "ros_publish on every ros_topic",
        "name what the node uses", "object-any", 3),
    typo("two serve a service, and nobody calls it", 20, "<ros_call/>", "<ros_execute/>", 19, "(robot.xml:28)",
        "write ros_call", "served-twice", 3),
    Mistake(21, "build before create", same, "build -w made", "packages-none", 0, "no packages", WHOLE,
        "'keymint create --all'"),
    Mistake(21, "install before build", remove("ws/build"), "install -w ws", "not-built", 1, "camera is not built",
        "ws/build/camera", "'keymint build camera'"),
    Mistake(21, "a verb outside a workspace", same, "check", "workspace-missing", 1, "Not inside a Keymint workspace",
        WHOLE, "set the workspace with -w"),
    Mistake(22, "a misspelt verb", same, "provison robot.xml", "usage", 2, "no verb 'provison'", USAGE,
        "did you mean 'provision'?"),
    Mistake(22, "a misspelt option", same, "lint robot.xml --sarf x", "usage", 2, "No such option '--sarf'", USAGE,
        "'--sarif'"),
    Mistake(22, "a misspelt package", same, "check camra -w ws", "package-unknown", 1, "no package 'camra'", USAGE,
        "did you mean 'camera'?"),
    Mistake(22, "a misspelt distribution", same, "provision robot.xml -w new --distro jazy", "distro-unknown", 2,
        "'jazy'", USAGE, "'jazzy'"),
    Mistake(22, "a misspelt implementation", same, "verify -w ws -i cyclonedd", "plugin-unknown", 2, "'cyclonedd'",
        USAGE, "'cyclonedds'"),
    *(Mistake(23, f"{word}, as in another tool", same, word, "usage", 2, f"no verb '{word}'", USAGE, verb) for word,
        verb in {"plan": "provision --dry-run", "list": "status", "destroy": "remove", "doctor": "check"}.items()),
    Mistake(24, "ROS_DOMAIN_ID of another domain", same, "provision robot.xml -w ws", "domain-environment", 0,
        "ROS_DOMAIN_ID is '5', but the workspace is for domain 0", "ws/profile/package.defaults/permissions.xml",
        "set ROS_DOMAIN_ID to 0", {"ROS_DOMAIN_ID": "5"}),
    Mistake(25, "--domain of another domain", same, "provision robot.xml -w ws --domain 5", "workspace-exists", 1,
        "the workspace has domain '0'", "ws/profile/package.defaults/permissions.xml", "'keymint set domain 5'"),
    Mistake(26, "another policy for the workspace", edit("/camera<", "/a<", "/detector<", "/b<", "/planner<", "/c<"),
        "provision robot.xml -w ws", "subject-stripped", 3, "takes all rights from 3 subjects", WHOLE,
        "is it the right policy?"),
    Mistake(27, "a subject renamed, and --prune", edit("/camera<", "/a<"), "provision robot.xml -w ws --prune",
        "subject-stripped", 3, "takes all rights from /camera", WHOLE, "'keymint remove NAME'"),
    Mistake(28, "a right removed, and not provisioned", edit("<ros_call/>", "<ros_execute/>"), "check -w ws",
        "policy-changed", 3, "out of date with the policy, which changed: /planner", "robot.xml",
        "'keymint provision robot.xml'"),
    Mistake(29, "an installed file edited", edit("rt/", "rq/", file=f"ws/{ENCLAVE}/permissions.xml"), "check -w ws",
        "file-changed", 3, "was changed after it was installed", f"ws/{ENCLAVE}/permissions.xml",
        "'keymint install camera' restores it"),
    Mistake(29, "a signed file edited", edit("rt/", "rq/", file=f"ws/{ENCLAVE}/permissions.p7s"), "check -w ws",
        "file-changed", 3, "was changed after it was installed", f"ws/{ENCLAVE}/permissions.p7s",
        "'keymint install camera' restores it"),
    Mistake(30, "a built file edited", edit("rt/image", "rt/imbge", file="ws/build/camera/permissions.xml"),
        "install -w ws", "hand-edited", 3,
        "changes what /camera may do: the document does not permit it to publish 'rt/image'",
        "ws/build/camera/permissions.xml", "'keymint build -f camera' discards the edit"),
    Mistake(31, "an enclave deleted", remove(f"ws/{ENCLAVE}"), "check -w ws", "enclave-missing", 3,
        "/camera is not installed", f"ws/{ENCLAVE}", "'keymint install camera'"),
    Mistake(31, "its certificate is garbage", write("x", f"ws/{ENCLAVE}/cert.pem"), "check -w ws",
        "certificate-invalid", 3, "not a certificate in PEM", f"ws/{ENCLAVE}/cert.pem", "'keymint install'"),
    Mistake(32, "a subject's key deleted", remove(f"ws/{KEYS}"), "provision robot.xml -w ws", "key-missing", 1,
        "the private key of /camera is missing", f"ws/{KEYS}", "'keymint build -f camera'"),
    Mistake(32, "the same, checked", remove(f"ws/{KEYS}"), "check -w ws", "key-missing", 3,
        "the private key of /camera is missing", f"ws/{KEYS}", "else make a new one"),
    *(Mistake(33, f"an authority's key deleted, then {verb}", remove("ws/private/identity_ca.key.pem"),
        f"{verb} -w ws", "authority-key-missing", 0, "the private key of 'identity_ca' is not here",
        "ws/public/identity_ca.cert.pem",
        "no action needed if it is elsewhere; else restore it") for verb in ("check", "status",
        "provision robot.xml")),
    Mistake(35, "all certificates expired", same, "check -w ws", "certificate-expired", 3, "expired on",
        f"ws/{ENCLAVE}/cert.pem", "'keymint renew camera'", {"SOURCE_DATE_EPOCH": YEARS}),
    Mistake(36, "renew NAME on the day of issue", same, "renew camera -w ws", "", 0,
        "/camera: nothing to renew: a new certificate would have the same dates", WHOLE, DONE),
    Mistake(37, "provision --renew in place of renew", same, "provision robot.xml -w ws --renew", "usage", 2,
        "No such option '--renew'", USAGE, "--rekey for new private keys of packages that you name, or 'keymint renew"),
    Mistake(38, "the workspace moved", lambda at: (at / "ws").rename(at / "moved"), "check -w moved", "", 0,
        "no findings", WHOLE, DONE),
    Mistake(38, ".keymint/ deleted", remove("ws/.keymint"), "check -w ws", "", 0, "no findings", WHOLE, DONE),
    Mistake(39, "who can … of a misspelt object", same, "query robot.xml who can publish /imag", "query-object", 0,
        "no rule is about '/imag'", USAGE, "did you mean '/image'?"),
    Mistake(40, "why … without the slash", same, "why camera publish image -w ws", "query-object", 0,
        "'image' is read as a raw topic", USAGE, "did you mean '/image'?"),
    Mistake(41, "why … publish where ros_publish is allowed", same, "why /camera publish /image -w ws -i omg", "", 0,
        "/camera ros_publish /image: the policy allows it", WHOLE, DONE),
    Mistake(42, "a pattern that matches nothing", same, "check /r0/* -w ws", "package-unknown", 1,
        "no package matches '/r0/*'", USAGE, "'keymint status' lists the packages"),
    Mistake(42, "a pattern where a name was expected", same, "check cam* -w ws", "", 0, "checked 1 enclave", WHOLE,
        DONE),
    Mistake(48, "fmt --check of README's own policy", same, "fmt --check robot.xml", "", 0,
        "no files to reformat, 1 unchanged", WHOLE, DONE),
    # Found by trying.
    typo("a rule without a qualifier", 51, ' qualifier="ALLOW"', "", 6, "lacks its attribute 'qualifier'",
        'add qualifier="…"'),
    typo("text in place of an attachment", 52, IMAGE, "/image", 6, "cannot contain text", "e.g. <attachment>"),
    typo("text in place of a permission", 53, "<ros_publish/>", "publish", 8, "cannot contain text",
        "put the text into the element"),
    typo("an attribute that rules do not have", 54, "<ros_topic", '<ros_topic type="Image"', 6,
        "unknown attribute 'type'", "remove it"),
    typo("several names in one attachment", 55, "/image", "/image, /depth", 7, "no legal object name",
        "<attachment> for each", "object-never", 3),
    typo("a regular expression with ^ and $", 56, "/image", "^/image$", 7, "no legal object name",
        "leave out '^' and '$'", "object-never", 3),
    typo("a name with a bracket", 57, "/image", "/[image", 7, "no legal object name", "segments are", "object-never",
        3),
    typo("a name without the slash", 58, "/image", "image", 7, "no legal object name", "write '/image'",
        "object-never", 3),
    typo("a private name", 59, "/image", "~/image", 7, "no legal object name", "{namespace}{name}/image",
        "object-never", 3),
    typo("a conflict of git", 60, "    <ros_topic", "<<<<<<< HEAD\n    <ros_topic", 6, "not well-formed",
        "resolve the conflict", "xml-syntax"),
    typo("an & in a name", 61, "/image", "/im & age", 7, "not well-formed", "write & as &amp;", "xml-syntax"),
    typo("quotes of a word processor", 62, '"ALLOW"', "\u201cALLOW\u201d", 6, "not well-formed", "straight quotes",
        "xml-syntax"),
    typo("two root elements", 63, "</profiles>", '</profiles>\n<profile name="x"/>', 35, "junk after document",
        "one root", "xml-syntax"),
    typo("include in place of xi:include", 64, "<xi:include", "<include", 5, "<include>",
        "did you mean 'xi:include'?"),
    typo('parse="text"', 65, 'parse="xml"', 'parse="text"', 5, 'only have parse="xml"', "leave it out",
        "include-parse"),
    typo("two profiles of one name", 66, '"detector"', '"camera"', 12, "two profiles are named", "rename one",
        "profile-name-twice", 3),
    typo("the attachment of a copy", 67, "/detector<", "/camera<", 12, "both attached to /camera", "of the copy",
        "profile-copied", 3),
    typo("DENY where nothing is allowed", 68, "ALLOW", "DENY", 6, "denies nothing", "without an ALLOW",
        "deny-nothing", 3),
    typo("a permission of another kind", 69, "<ros_call/>", "<ros_publish/>", 30, "expected <ros_call>",
        "or <ros_execute>"),
    typo("an empty attachment", 70, "/image<", "<", 7, "the attachment is empty", "write *", "expression"),
    Mistake(71, "-w of a folder that is not there, within a workspace", same, "check -w ws/nowhere",
        "workspace-missing", 1, "Not inside a Keymint workspace", "ws/nowhere", "correct the path"),
    Mistake(72, "-w of a file", same, "provision robot.xml -w robot.xml", "write-failed", 1, "Not a directory",
        "robot.xml", "name another folder"),
    Mistake(73, "a policy in place of a graph", same, "learn robot.xml", "graph-invalid", 1, "not JSON",
        "robot.xml:1", "'keymint discover'"),
    Mistake(74, "sources deleted", remove("ws/src/camera"), "check -w ws", "enclave-orphaned", 3,
        "/camera is installed, but has no source", f"ws/{ENCLAVE}", "'keymint create camera' makes the package again"),
    Mistake(75, "a private key that all may read", lambda at: (at / f"ws/{ENCLAVE}/key.pem").chmod(0o644),
        "check -w ws", "file-mode", 3, "has mode 0644", f"ws/{ENCLAVE}/key.pem", "chmod 600"),
    Mistake(76, "documents of another enclave", lambda at: shutil.copy(at / f"ws/{ENCLAVE}/permissions.p7s",
        at / "ws/install/enclaves/planner"), "check -w ws", "grant-subject", 3, "grants to 'CN=/camera",
        "ws/install/enclaves/planner/permissions.p7s", "'keymint install planner'"),
    Mistake(77, "the policy moved", lambda at: (at / "robot.xml").rename(at / "new.xml"), "check -w ws",
        "policy-missing", 3, "does not exist", "ws/profile/policies.xml:7", "name a ComArmor file"),
    Mistake(78, "names that differ by case", edit("/detector<", "/CAMERA<"), "provision robot.xml -w new",
        "name-collision", 1, "differ only by case", WHOLE, "rename one"),
    Mistake(79, "a kind of object is mixed up", same, "query robot.xml who can publish /find_object", "query-object",
        0, "'/find_object' is the name of a ros_service", USAGE, "its permissions are ros_call and ros_execute"),
    Mistake(80, "a subject misspelt in a question", same, "query robot.xml what can /camra do", "", 0,
        "did you mean '/camera'?", WHOLE, DONE),
]  # fmt: skip

ELSEWHERE = {
    34: "tests/keymint/examine/test_not_examined.py",
    43: "tests/keymint/drawing/test_alike.py",
    44: "tests/packaging/test_hints.py",
    45: "tests/robustness/test_kill.py",
    46: "tests/keymint/host/test_streams_and_signals.py",
    47: "tests/robustness/test_same_command.py",
    49: "tests/robustness/test_two_at_once.py",
    50: "tests/keymint/workspace/test_stored_keys.py",
}
"""Mistakes that take another user, process, signal or machine, with the tests that make them."""
LINE = re.compile(r"(?:(?P<where>[^\s:]+(?::\d+)?): )?(?:error|warning|note|Error): .* \[(?P<code>[\w-]+)\]")


@pytest.fixture(scope="module")
def quick_start(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """README's policy and the workspace that it is provisioned to, and a workspace without packages."""
    folder = tmp_path_factory.mktemp("quick_start")
    for name, content in saved_files(README):
        (folder / name).write_text(content)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("SOURCE_DATE_EPOCH", str(NOW))
        for words in (["provision", "robot.xml", "-w", "ws", "-q"], ["init", "made", "--policy", "robot.xml", "-q"]):
            assert cli.main(words) == 0
    return folder


@pytest.fixture
def at(quick_start: Path, tmp_path: Path) -> Path:
    """A copy of the quick start."""
    shutil.copytree(quick_start, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda each: f"{each.number} {each.what}")
def test_a_mistake_is_told(keymint, at: Path, mistake: Mistake) -> None:
    mistake.change(at)
    outcome = keymint(*mistake.command.split(), env=mistake.env)
    assert outcome.code == mistake.status, outcome.err
    if not mistake.code:
        assert mistake.says in outcome.out
        return
    told = [match for match in map(LINE.match, outcome.err.splitlines()) if match and match["code"] == mistake.code]
    match = next((each for each in told if mistake.says in each[0]), None)
    assert match is not None, outcome.err
    assert (match["where"] or "") == ("" if mistake.where in {USAGE, WHOLE} else mistake.where)
    assert mistake.remedy in re.sub(r" -w \w+'", "'", match[0])  # as the command has it


@pytest.mark.parametrize(
    "mistake", [each for each in MISTAKES if each.where.startswith("robot.xml:")], ids=lambda each: each.what
)
def test_one_cause_is_one_message(keymint, at: Path, mistake: Mistake) -> None:
    """One message reports what is wrong at a place in the policy; a note may report a consequence."""
    mistake.change(at)
    told = keymint(*mistake.command.split()).err.splitlines()
    here = [line for line in told if line.startswith(f"{mistake.where}: ")]
    assert len(here) == 1 or sum(": note: " not in line for line in here) == 1, here


def test_all_of_the_list_are_here_or_elsewhere() -> None:
    assert all((CHECKOUT / path).is_file() for path in ELSEWHERE.values())
    assert set(range(1, 51)) <= {each.number for each in MISTAKES} | ELSEWHERE.keys()
    assert {each.number for each in MISTAKES} >= set(range(51, 71))
