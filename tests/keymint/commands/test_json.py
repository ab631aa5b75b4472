# SPDX-License-Identifier: Apache-2.0
"""``--json``: one documented shape on every verb."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import pytest

from keymint.api.graph import Edge, Graph, Object
from keymint.api.graph_json import dump
from keymint.cli import VERBS
from tests import sros2_keystore
from tests.conftest import CHECKOUT, Outcome

SCHEMA = json.loads((CHECKOUT / "schemas/keymint/report.schema.json").read_text())


def held(outcome: Outcome) -> dict:
    """Return the document, after checking it against the schema, the exit code and an otherwise silent run."""
    document = outcome.document
    jsonschema.validate(document, SCHEMA)
    assert document["exit_code"] == outcome.code
    assert outcome.err == ""
    return document


CALLS = {
    "init": ["init", "other"],
    "create": ["create", "--all", "-w", "ws"],
    "build": ["build", "-f", "-w", "ws"],
    "install": ["install", "-w", "ws"],
    "check": ["check", "-w", "ws"],
    "authority": ["authority", "show", "-w", "ws"],
    "env": ["env", "talker", "-w", "ws"],
    "prove": ["prove", "-w", "ws"],
    "revoke": ["revoke", "talker", "--reason", "superseded", "-w", "ws"],
    "remove": ["remove", "--state", "revoked", "-w", "ws"],
    "set": ["set", "domain", "0", "-w", "ws"],
    "issued": ["issued", "-w", "ws"],
    "crl": ["crl", "-w", "ws"],
    "renew": ["renew", "talker", "-w", "ws"],
    "status": ["status", "-w", "ws"],
    "report": ["report", "-o", "audit.html", "-w", "ws"],
    "provision": ["provision", "policy.xml", "-w", "third"],
    "discover": ["discover", "--from", "graph.json"],
    "learn": ["learn", "graph.json"],
    "export": ["export", "policy.xml", "--format", "sros2"],
    "import": ["import", "foreign.xml", "-o", "imported"],
    "verify": ["verify", "-w", "ws", "-i", "omg"],
    "why": ["why", "/talker", "ros_publish", "/chatter", "-w", "ws", "-i", "omg"],
    "lint": ["lint", "policy.xml"],
    "diff": ["diff", "policy.xml", "policy.xml"],
    "query": ["query", "policy.xml", "who", "can", "publish", "/chatter"],
    "test": ["test", "policy.xml"],
    "fmt": ["fmt", "policy.xml"],
    "graph": ["graph", "policy.xml"],
    "explain": ["explain", "usage"],
    "plugins": ["plugins"],
    "transports": ["transports"],
    "completion": ["completion", "bash"],
    "adopt": ["adopt", "keystore"],
    "harden": ["harden", "-w", "ws"],
    "request": ["request", "talker", "--folder", "ws/install"],
    "sign": ["sign", "talker.request.pem", "-w", "ws"],
    "accept": ["accept", "talker.bundle", "--folder", "ws/install"],
    "bundle": ["bundle", "talker", "-w", "ws"],
}
FOREIGN = (
    '<policy version="0.2.0"><enclaves><enclave path="/a"><profiles><profile ns="/" node="a">'
    '<topics publish="ALLOW"><topic>b</topic></topics></profile></profiles></enclave></enclaves></policy>'
)
"""A policy of another tool."""
BEFORE = {"sign": "request", "accept": "bundle"}
"""The verb that makes the file that another one takes."""


@pytest.fixture(scope="module")
def of_sros2(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A keystore of another tool, whose private keys only its owner can read."""
    folder = tmp_path_factory.mktemp("sros2") / "keystore"
    sros2_keystore.make(folder, FOREIGN)
    for path in folder.rglob("*key.pem"):
        path.chmod(0o600)
    return folder


@pytest.fixture(autouse=True)
def graph(tmp_path: Path, of_sros2: Path) -> None:
    """A graph and a keystore for the verbs that take one."""
    (tmp_path / "keystore").symlink_to(of_sros2)
    edge = Edge("/talker", "ros_publish", Object("ros_topic", "/chatter"))
    (tmp_path / "graph.json").write_bytes(dump(Graph.of([edge])))
    (tmp_path / "foreign.xml").write_text(FOREIGN)
    (tmp_path / "policy.test.xml").write_text(
        '<tests><test name="t"><allow subject="/talker" permission="publish" object="/chatter"/></test></tests>'
    )


DOCUMENTED = "\n".join((CHECKOUT / "docs" / name).read_text() for name in ("json.md", "graph.md"))
BY_NAME = {"assumptions", "variables", "models", "files", "modes", "signatures"}
"""Members whose own members have the names of variables, models or files."""


def members(value: object) -> Iterator[str]:
    """Yield the name of each member of a result, and of what is in it."""
    for each in value if isinstance(value, list) else ():
        yield from members(each)
    for name, each in value.items() if isinstance(value, dict) else ():
        yield name
        yield from members([*each.values()] if name in BY_NAME and isinstance(each, dict) else each)


def test_every_verb_has_it() -> None:
    assert set(CALLS) == set(VERBS)


@pytest.mark.parametrize("verb", CALLS)
def test_of_a_verb_that_succeeds(keymint, provisioned: Path, verb: str) -> None:
    if verb in BEFORE:
        assert keymint(*CALLS[BEFORE[verb]]).code == 0
    document = held(keymint(*CALLS[verb], "--json"))
    assert document["verb"].split()[0] == verb
    assert document["exit_code"] == 0
    undocumented = {each for each in members(document["result"]) if f"`{each}`" not in DOCUMENTED}
    assert undocumented == set()
    assert not document["result"] or re.search(rf"^\* [^:]*`{verb}[` ]", DOCUMENTED, re.MULTILINE)


@pytest.fixture
def both(keymint, policy: Path, tmp_path: Path) -> Path:
    """A workspace with two transports, each with its own documents."""
    made = keymint("provision", policy, "-w", "ws", "--transport", "dds", "--transport", "zenoh")
    assert made.code == 0, made.err
    return tmp_path / "ws"


MODELS = ("-i", "omg", "-i", "zenoh-1")


def test_of_every_verb_in_a_workspace_with_two_transports(keymint, both: Path) -> None:
    with_models = {verb: [*CALLS[verb][:-1], MODELS[1], *MODELS[2:]] for verb in ("verify", "why")}
    for verb, words in {**CALLS, **with_models, "provision": ["provision", "policy.xml", "-w", "ws"]}.items():
        assert held(keymint(*words, "--json"))["exit_code"] == 0, verb


def test_shared_documents_in_every_stage(keymint, both: Path) -> None:
    """What differs with a second transport: the router's file, its claims, and what both transports need."""
    router = both / "install/zenoh/router.json5"
    status = held(keymint("status", "-w", "ws", "--json"))["result"]
    assert [each["documents"] for each in status["shared"]] == [["zenoh/router.json5"]]
    why = held(keymint("why", "/talker", "ros_publish", "/chatter", "-w", "ws", *MODELS, "--json"))["result"]
    assert {each["action"] for each in why["endpoints"]} > {"publish", "put in"}
    assert {each["name"] for each in why["transports"]} == {"omg", "zenoh-1"}
    assert "claims" in held(keymint("prove", "-w", "ws", "--json"))["result"]["shared"][0]
    router.write_text(router.read_text().replace("0/chatter/", "0/other/"))
    codes = {}
    for verb in ("check", "prove", "verify", "status"):
        document = held(keymint(verb, "-w", "ws", *(MODELS if verb == "verify" else ()), "--json"))
        codes[verb] = document["exit_code"]
    assert codes == {"check": 3, "prove": 3, "verify": 3, "status": 0}
    router.unlink()
    for verb in codes:
        held(keymint(verb, "-w", "ws", *(MODELS if verb == "verify" else ()), "--json"))
    defaults = both / "profile/package.defaults/zenoh.xml"
    defaults.write_text(defaults.read_text().replace("<name>zenoh_router", "<name>other"))
    for verb in (*codes, "build", "install"):
        held(keymint(verb, "-w", "ws", *(MODELS if verb == "verify" else ()), "--json"))


@pytest.mark.parametrize("verb", CALLS)
def test_of_a_usage_error(keymint, verb: str) -> None:
    document = held(keymint(verb, "--no-such-option", "--json"))
    assert (document["exit_code"], document["diagnostics"][0]["code"]) == (2, "usage")


@pytest.mark.parametrize("verb", ["create", "build", "install", "check", "status", "bundle"])
def test_of_a_missing_workspace(keymint, verb: str) -> None:
    named = {"create": ["--all"], "bundle": ["talker"]}.get(verb, [])
    document = held(keymint(verb, *named, "-w", "nowhere", "--json"))
    assert (document["exit_code"], document["diagnostics"][0]["code"]) == (1, "workspace-missing")


def test_steps_say_what_was_written(keymint, policy: Path) -> None:
    document = held(keymint("provision", policy, "-w", "ws", "--json"))
    written = {path for step in document["steps"] for path in step["written"]}
    assert "ws/install/enclaves/robot1/listener/cert.pem" in written
    assert "ws/private/identities/talker/key.pem" in written
    assert document["summary"]["created"] == len(document["steps"])
    again = held(keymint("provision", policy, "-w", "ws", "--json"))
    assert not any(step["written"] for step in again["steps"])


def test_a_place_has_the_chain_of_includes(keymint, tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/bad.xml").write_text("<ros_topic>\n<oops/></ros_topic>")
    (tmp_path / "p.xml").write_text(
        '<profiles xmlns:xi="http://www.w3.org/2001/XInclude"><profile name="a"><attachment>/a</attachment>\n'
        '<xi:include href="parts/bad.xml" parse="xml"/></profile></profiles>'
    )
    document = held(keymint("provision", "p.xml", "-w", "ws", "--json"))
    assert document["exit_code"] == 1
    found = document["diagnostics"][0]
    assert found["file"] == "parts/bad.xml"
    assert found["included_from"] == [{"file": "p.xml", "line": 2}]


def test_secrets_are_no_part_of_it(keymint, policy: Path, tmp_path: Path) -> None:
    out = keymint("provision", policy, "-w", "ws", "--json", "-v").out
    for key in (tmp_path / "ws").rglob("*key.pem"):
        assert key.read_text().splitlines()[1] not in out
