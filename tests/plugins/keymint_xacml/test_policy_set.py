# SPDX-License-Identifier: Apache-2.0
"""Exports are valid, and an evaluator that shares no code with them decides as the policy does."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random

import pytest
from keymint_xacml import policy_format
from lxml import etree

import comarmor
from comarmor.data import locate
from comarmor.errors import Origin, Severity
from comarmor.rules import KIND_OF, PARTS, PERMISSIONS, Effect, Rule, parts
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from tests import generated
from tests.conftest import CHECKOUT
from tests.effort import tries

from .evaluator import DENY, PERMIT, Request, Result, evaluator

LIBRARY = locate("keymint_ros", "templates") / "comarmor.d" / "foxy"
FURTHER = ("/r1/talker", "/robot/ui", "/cell/line/camera", "/r2/drivers")
OASIS = "xacml-core-v3-schema-wd-17.xsd"
EXAMPLES = ("action", "fleet", "ppac_2018/policy.xml", "talker_listener")


def request(subject: str, kind: str, permission: str, name: str, partition: str = "") -> Request:
    resource, own = "urn:oasis:names:tc:xacml:3.0:attribute-category:resource", "urn:keymint:xacml:1.0:resource:"
    return {
        (
            "urn:oasis:names:tc:xacml:1.0:subject-category:access-subject",
            "urn:oasis:names:tc:xacml:1.0:subject:subject-id",
        ): [subject],
        (
            "urn:oasis:names:tc:xacml:3.0:attribute-category:action",
            "urn:oasis:names:tc:xacml:1.0:action:action-id",
        ): [permission],
        (resource, "urn:oasis:names:tc:xacml:1.0:resource:resource-id"): [name],
        (resource, f"{own}kind"): [kind],
        (resource, f"{own}partition"): [partition],
    }


def written(path: Path) -> tuple[comarmor.Policy, tuple[str, ...], bytes]:
    """Return a policy, the subjects of its export, and the export."""
    policy = comarmor.load(path, library=LIBRARY)
    subjects = tuple(dict.fromkeys([*policy.subjects(), *(each for each in FURTHER if policy.applicable(each))]))
    made = policy_format.exported([SubjectRules(each, policy.rules(each)) for each in subjects])
    assert not made.diagnostics
    return policy, subjects, made.document


class _Asker:
    """Draws requests that rules of a policy are about, or nearly."""

    def __init__(self, rng: Random, rules: Sequence[Rule]) -> None:
        self._rng = rng
        self._rules = rules

    def ask(self) -> tuple[str, str, str]:
        """Return a permission, a name and a partition."""
        rng = self._rng
        rule = rng.choice(self._rules)
        granted = rng.choice(rule.permissions)
        name = self._text(rng.choice(rule.expressions))
        partition = self._text(rng.choice(rule.partitions)) if rule.partitions and rng.random() < 0.8 else ""
        if rng.random() < 0.1:
            partition = rng.choice(("p", "q", "lab/a", "x"))
        if (rule.kind, granted) in PARTS and rng.random() < 0.6:
            _, granted, suffix = rng.choice(PARTS[rule.kind, granted])
            name += suffix
        if rng.random() < 0.1:
            granted = rng.choice([each for kind in PERMISSIONS.values() for each in kind])
        if rng.random() < 0.1:
            name = rng.choice((name[:-1], f"{name}x", f"/x{name}", f"{name}\n"))
        return granted, name, partition

    def _text(self, expression: str) -> str:
        """Return a text that an expression matches, often."""
        rng, text, at = self._rng, "", 0
        while at < len(expression):
            char = expression[at]
            at += 1
            if char == "*":
                text += rng.choice(("", "a", "1", "/b/c", "*", "\n"))
            elif char == "?":
                text += rng.choice("ax/-?\n")
            elif char == "[" and (end := expression.find("]", at + 1)) > 0:
                text += rng.choice(expression[at:end] + "b-")
                at = end + 1
            elif char == "\\":
                text, at = text + expression[at], at + 1
            else:
                text += char
        return text


def requests(seed: int, folder: Path, count: int) -> Iterator[tuple[str, str, str, str, Result, comarmor.Decision]]:
    """Yield requests of a random policy, with what the export and the policy decide."""
    rng = Random(seed)
    path = folder / f"{seed}.xml"
    path.write_text(generated.pretty(generated.tokens(seed)))
    policy, subjects, document = written(path)
    decide = evaluator(document)
    rules = {each: policy.rules(each) for each in subjects}
    askers = {each: _Asker(rng, found) for each, found in rules.items() if found}
    for _ in range(count if askers else 0):
        subject = rng.choice(list(askers))
        permission, name, partition = askers[subject].ask()
        if rng.random() < 0.05:
            subject = rng.choice((*subjects, "/nobody"))
        kind = KIND_OF[permission]
        asked = [decide(request(subject, *part[:2], name + part[2], partition)) for part in parts(kind, permission)]
        denied = [each for each in asked if each.decision == DENY]
        found = denied[0] if denied else Result(PERMIT, frozenset().union(*(each.advice for each in asked)))
        ours = policy.decide(subject, kind, permission, name, [partition])
        assert subject in subjects or found == Result(DENY)
        yield from [(subject, permission, name, partition, found, ours)] if subject in subjects else []


def test_it_decides_as_the_policy_does(tmp_path: Path) -> None:
    seen: Counter[object] = Counter()
    for seed in range(tries(38, 400)):
        for subject, permission, name, partition, found, ours in requests(seed, tmp_path, 300):
            asked = f"seed {seed}: {subject} {permission} {name!r} in {partition!r}"
            assert (found.decision == PERMIT) is ours.allowed, asked
            if (KIND_OF[permission], permission) not in PARTS:
                audited = {f"{Path(each.origin.file).name}:{each.origin.line}" for each in ours.rules if each.audit}
                assert found.advice == audited, asked
                seen["audited"] += bool(audited)
            seen[permission] += 1
            seen[found.decision] += 1
            seen["denied by a rule"] += found.decision == DENY and bool(ours.rules)
            seen["in a partition"] += bool(partition)
    assert seen[PERMIT] + seen[DENY] >= 10_000
    assert min(seen.values()) >= 150, seen
    assert {each for kind in PERMISSIONS.values() for each in kind} <= seen.keys()


def test_an_outer_set_alone_would_lose_denials(tmp_path: Path) -> None:
    path = tmp_path / "policy.xml"
    path.write_text(
        '<profile name="t"><attachment>/t</attachment>'
        '<ros_topic qualifier="ALLOW"><attachment>/a*</attachment><permissions><ros_publish/></permissions></ros_topic>'
        '<ros_topic qualifier="DENY"><attachment>/ab</attachment><permissions><ros_publish/></permissions></ros_topic>'
        "</profile>"
    )
    _, _, document = written(path)
    asked = request("/t", "ros_topic", "ros_publish", "/ab")
    assert evaluator(document)(asked).decision == DENY
    assert evaluator(document)({**asked, **request("/t", "ros_topic", "ros_publish", "/abc")}).decision == PERMIT
    assert evaluator(document.replace(b"deny-overrides", b"deny-unless-permit"))(asked).decision == PERMIT


@pytest.mark.parametrize("values", [[], ["", "p"], ["/a", "/b"]])
def test_a_request_without_exactly_one_value_of_each_attribute_is_denied(tmp_path: Path, values: Sequence[str]) -> None:
    path = tmp_path / "policy.xml"
    path.write_text(
        '<profile name="t"><attachment>/t</attachment><topic qualifier="ALLOW"><attachment>*</attachment>'
        "<partitions><partition>*</partition></partitions><permissions><publish/></permissions></topic></profile>"
    )
    _, _, document = written(path)
    asked = request("/t", "topic", "publish", "/a")
    assert evaluator(document)(asked).decision == PERMIT
    for attribute in asked:
        assert (
            evaluator(document)({**asked, attribute: [*values, *asked[attribute]] if values else []}).decision == DENY
        )


def _oasis() -> etree.XMLSchema:
    given = os.environ.get("KEYMINT_XACML_SCHEMA")
    path = Path(given) if given else CHECKOUT.parent / "shared" / "reference" / "xacml" / OASIS
    if not path.is_file():
        pytest.skip(f"no {OASIS}: KEYMINT_XACML_SCHEMA names it")
    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(_XmlNamespace())
    return etree.XMLSchema(etree.parse(path, parser))


class _XmlNamespace(etree.Resolver):
    """The schema of ``xml:id``, which that of OASIS imports from the network."""

    def resolve(self, url: str, _id: object, context: object) -> object:
        schema = """<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema"
            targetNamespace="http://www.w3.org/XML/1998/namespace"><xs:attribute name="id" type="xs:ID"/></xs:schema>"""
        return self.resolve_string(schema, context) if url.endswith("/xml.xsd") else None


def _documents(folder: Path) -> Iterator[bytes]:
    for example in EXAMPLES:
        yield written(CHECKOUT / "examples" / example)[2]
    for seed in range(tries(30, 300)):
        path = folder / f"{seed}.xml"
        path.write_text(generated.pretty(generated.tokens(seed)))
        yield written(path)[2]


def test_it_is_valid(tmp_path: Path) -> None:
    schema = etree.XMLSchema(file=str(Path(__file__).with_name("exported.xsd")))
    for document in _documents(tmp_path):
        schema.assertValid(etree.fromstring(document))


def test_it_is_valid_against_the_schema_of_oasis(tmp_path: Path) -> None:
    schema = _oasis()
    for document in _documents(tmp_path):
        schema.assertValid(etree.fromstring(document))
    wrong = etree.fromstring(document)
    del wrong.attrib["PolicyCombiningAlgId"]
    assert not schema.validate(wrong)


def _of(effect: Effect, *expressions: str) -> list[SubjectRules]:
    rule = Rule(effect, "topic", ("publish",), expressions, (), audit=False, origin=Origin("p.xml", 7))
    good = Rule(Effect.ALLOW, "topic", ("publish",), ("b",), (), audit=False, origin=Origin("p.xml", 9))
    return [SubjectRules("/t", (rule, good))]


@pytest.mark.parametrize("expression", ["a\x01", "[\x01-\x08]x", "*\x0b"])
@pytest.mark.parametrize("effect", Effect)
def test_what_xml_cannot_contain_is_refused(effect: Effect, expression: str) -> None:
    with pytest.raises(KeymintError) as error:
        policy_format.exported(_of(effect, expression))
    (diagnostic,) = error.value.diagnostics
    assert (diagnostic.code, str(diagnostic.where)) == ("xacml-unsayable", "p.xml:7")
    assert ("--lossy" in diagnostic.help) is (effect is Effect.ALLOW)


def test_lossy_leaves_out_what_only_allows_something() -> None:
    made = policy_format.exported(_of(Effect.ALLOW, "a\x01"), lossy=True)
    (diagnostic,) = made.diagnostics
    assert (diagnostic.severity, diagnostic.help) == (Severity.WARNING, "left out (--lossy)")
    assert evaluator(made.document)(request("/t", "topic", "publish", "b")).decision == PERMIT
    with pytest.raises(KeymintError):
        policy_format.exported(_of(Effect.DENY, "a\x01"), lossy=True)


def test_a_subject_without_rules_is_denied_everything() -> None:
    made = policy_format.exported([SubjectRules("/é t", ()), *_of(Effect.ALLOW, "a")])
    assert b"/%C3%A9" not in made.document
    assert evaluator(made.document)(request("/é t", "topic", "publish", "a")).decision == DENY
