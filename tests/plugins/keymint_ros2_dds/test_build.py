"""The build stage: what the documents hold, what is refused, and what is only said."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
import xmlschema
from keymint_ros2_dds import build_type
from lxml import etree

from comarmor.data import locate
from comarmor.errors import Severity
from keymint.api import BuildOptions, DomainRange, KeySpec, Validity
from keymint.errors import KeymintError
from tests.effort import tries

from .packages import VALIDITY, domain_rule, package, rule

STRICT, LENIENT = BuildOptions(), BuildOptions(allow_vendor_specific=True)
CHATTER = rule("ALLOW", "ros_topic", "ros_publish", "/chatter")


def build(*rules, options=STRICT, **fields):
    return build_type.build(package(*rules, **fields), options)


def permissions(*rules, options=STRICT, **fields):
    return etree.fromstring(build(*rules, options=options, **fields).documents["permissions.xml"])


def shape(*rules, **fields):
    """Return the rules of a document as (tag, {action: topics})."""
    return [
        (
            item.tag,
            {str(each.tag): [topic.text for topic in each.find("topics")] for each in item if each.tag != "domains"},
        )
        for item in permissions(*rules, **fields).find("permissions/grant")
        if item.tag in {"allow_rule", "deny_rule"}
    ]


def refusal(*rules, **fields):
    with pytest.raises(KeymintError) as caught:
        build(*rules, **fields)
    return caught.value.diagnostics


def codes(found):
    return [item.code for item in found]


def test_the_grant():
    grant = permissions(CHATTER).find("permissions/grant")
    assert grant.get("name") == "/talker"
    assert grant.findtext("subject_name") == "CN=/talker,OU=x1"
    assert grant.findtext("validity/not_before") == "2026-11-20T00:00:00"
    assert grant.findtext("validity/not_after") == "2027-11-20T00:00:00"
    assert [child.tag for child in grant] == ["subject_name", "validity", "allow_rule", "default"]
    assert grant.findtext("default") == "DENY"
    assert grant.findtext("allow_rule/publish/topics/topic") == "rt/chatter"


def test_all_kinds_are_mapped():
    (only,) = shape(
        CHATTER,
        rule("ALLOW", "ros_service", "ros_execute", "/add"),
        rule("ALLOW", "ros_action", "ros_request", "/fib"),
        rule("ALLOW", "ros_parameter", "ros_write", "/node"),
        rule("ALLOW", "topic", "subscribe", "raw"),
    )
    assert only == (
        "allow_rule",
        {
            "publish": [
                "rq/fib/_action/cancel_goalRequest",
                "rq/fib/_action/get_resultRequest",
                "rq/fib/_action/send_goalRequest",
                "rq/node/set_parametersRequest",
                "rq/node/set_parameters_atomicallyRequest",
                "rr/addReply",
                "rt/chatter",
            ],
            "subscribe": [
                "raw",
                "rq/addRequest",
                "rr/fib/_action/cancel_goalReply",
                "rr/fib/_action/get_resultReply",
                "rr/fib/_action/send_goalReply",
                "rr/node/set_parametersReply",
                "rr/node/set_parameters_atomicallyReply",
                "rt/fib/_action/feedback",
                "rt/fib/_action/status",
            ],
        },
    )


def test_a_denial_comes_before_what_it_punctures_and_an_allow_rule_stands_at_both_ends():
    found = shape(
        rule("ALLOW", "ros_topic", "ros_publish", "/a*", "/chatter"), rule("DENY", "ros_topic", "ros_publish", "/ab")
    )
    assert found == [
        ("allow_rule", {"publish": ["rt/chatter"]}),
        ("deny_rule", {"publish": ["rt/ab"]}),
        ("allow_rule", {"publish": ["rt/a*"]}),
    ]
    found = shape(rule("ALLOW", "topic", "publish", "*"), rule("DENY", "topic", "publish", "x"))
    assert found == [("allow_rule", {}), ("deny_rule", {"publish": ["x"]}), ("allow_rule", {"publish": ["*"]})]


def test_a_name_that_only_one_direction_denies_is_allowed_before_it_is_denied():
    found = shape(
        rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", "/*"),
        rule("DENY", "ros_topic", "ros_publish", "/estop"),
    )
    assert found[0] == ("allow_rule", {"subscribe": ["rt/*"]})
    assert found[1] == ("deny_rule", {"publish": ["rt/estop"]})


def test_what_has_no_effect_is_left_out():
    found = shape(
        rule("ALLOW", "ros_topic", "ros_publish", "/a", "/a*", "/secret", "/a"),
        rule("DENY", "ros_topic", "ros_publish", "/secret", "/nothing*"),
        rule("DENY", "ros_topic", "ros_subscribe", "/a"),
    )
    assert found == [("allow_rule", {"publish": ["rt/a*"]})]


def test_relay_stands_by_itself_at_the_end():
    built = build(
        CHATTER, rule("ALLOW", "ros_topic", "ros_relay", "/r*"), rule("DENY", "ros_topic", "ros_relay", "/rx")
    )
    found = shape(
        CHATTER, rule("ALLOW", "ros_topic", "ros_relay", "/r*"), rule("DENY", "ros_topic", "ros_relay", "/rx")
    )
    assert found[1:] == [("deny_rule", {"relay": ["rt/rx"]}), ("allow_rule", {"relay": ["rt/r*"]})]
    assert "vendor-relay" in codes(built.diagnostics)


def test_a_subject_without_permissions_gets_no_rules_and_a_note():
    assert shape() == []
    assert shape(rule("ALLOW", "ros_topic", "ros_publish", "/a"), rule("DENY", "ros_topic", "ros_publish", "*")) == []
    assert codes(build().diagnostics) == ["no-permissions"]


def test_partitions():
    document = permissions(
        rule("ALLOW", "topic", "publish", "a", "b*", partitions=["p", ""]),
        rule("ALLOW", "topic", "publish", "b1", partitions=["q"]),
        rule("DENY", "topic", "publish", "a", partitions=["p"]),
    )
    found = [
        ([t.text for t in each.find("topics")], [p.text or "" for p in each.iterfind("partitions/partition")])
        for each in document.iter("publish")
    ]
    assert found == [(["a"], []), (["b1"], ["", "p", "q"]), (["b*"], ["", "p"])]


def test_a_denial_under_a_wildcard_with_partitions_is_about_every_partition():
    document = permissions(
        rule("ALLOW", "topic", "publish", "*", partitions=["*"]), rule("DENY", "topic", "publish", "secret")
    )
    assert [p.text for p in document.find("permissions/grant/deny_rule/publish/partitions")] == ["*"]


@pytest.mark.parametrize("listed", [["p?"], ["[pq]"], ["caf\xe9"], [r"p\*"]])
def test_partitions_that_vendors_read_differently_are_refused(listed):
    bad = rule("ALLOW", "topic", "publish", "x", partitions=listed, line=12)
    (found,) = refusal(CHATTER, bad)
    assert (found.code, str(found.where)) == ("portability-partition", "policy.xml:12")
    assert codes(build(bad, options=LENIENT).diagnostics) == ["portability-partition"]


def test_every_rule_that_cannot_be_said_is_reported_with_its_place():
    bad = [
        rule("ALLOW", "ros_topic", "ros_publish", r"/a\*", line=3),
        rule("ALLOW", "ros_topic", "ros_publish", "/Caf\xe9", line=4),
        CHATTER,
        rule("ALLOW", "ros_topic", "ros_publish", "/[a-z][a-z]*", line=5),
    ]
    found = refusal(*bad)
    assert [(item.code, item.where.line) for item in sorted(found, key=lambda item: item.where.line)] == [
        ("portability-expression", 3),
        ("portability-expression", 4),
        ("portability-expression", 5),
    ]
    assert all(item.severity is Severity.ERROR and item.help and item.subject == "/talker" for item in found)
    lenient = build(*bad, options=LENIENT)
    assert {item.severity for item in lenient.diagnostics if item.code == "portability-expression"} == {
        Severity.WARNING
    }
    assert all("Cyclone DDS and Fast DDS" in i.message for i in lenient.diagnostics if i.code.startswith("portability"))
    assert r"rt/a\*" in lenient.documents["permissions.xml"].decode()


def test_a_rule_that_matches_no_name_is_a_warning():
    (found,) = build(CHATTER, rule("ALLOW", "ros_topic", "ros_publish", "chatter", line=9)).diagnostics
    assert (found.code, found.severity, str(found.where)) == ("never-matches", Severity.WARNING, "policy.xml:9")
    assert found.help == "write '/chatter': every ROS name begins with '/'"


def test_a_permission_that_dds_does_not_know_is_refused():
    (found,) = refusal(rule("ALLOW", "topic", "publsh", "x", line=5))
    assert (found.code, found.where.line, found.help) == ("permission-unknown", 5, "did you mean 'publish'?")


@pytest.mark.parametrize("expression", ["a\\", "[[:nope:]]"])
def test_an_expression_that_cannot_be_read_is_refused(expression):
    assert codes(refusal(rule("ALLOW", "topic", "publish", expression))) == ["expression"]
    assert codes(refusal(rule("ALLOW", "topic", "publish", "x", partitions=[expression]))) == ["expression"]


def test_wildcards_before_the_end_are_one_note():
    built = build(rule("ALLOW", "ros_service", "ros_call", "/a*", "/b*"))
    (found,) = built.diagnostics
    assert (found.code, found.severity) == ("vendor-wildcard", Severity.NOTE)


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"domains": ()}, "domains"),
        ({"domains": (DomainRange(3, 1),)}, "domains"),
        ({"domains": (DomainRange(0, 231),)}, "portability-domain"),
        ({"domains": (DomainRange(1, 1),)}, "domain-uncovered"),
        ({"subject_name": "CN=/other"}, "subject-mismatch"),
        ({"issuer": "another"}, "issuer-mismatch"),
        ({"validity": Validity(VALIDITY.not_after, VALIDITY.not_before)}, "validity-empty"),
        ({"validity": Validity(VALIDITY.not_before, datetime(2262, 1, 1, tzinfo=UTC))}, "portability-date"),
    ],
)
def test_what_does_not_fit_together_is_refused(fields, code):
    assert code in codes(refusal(CHATTER, **fields))


def test_domains_are_written_with_both_ends():
    ranges = (DomainRange(5, 7), DomainRange(0, 0), DomainRange(8, 9))
    loaded = package(CHATTER, domains=ranges)
    wide = replace(loaded.governance, domain_rules=(domain_rule(domains=(DomainRange(0, 10),)),))
    built = build_type.build(replace(loaded, governance=wide), STRICT)
    domains = etree.fromstring(built.documents["permissions.xml"]).find(".//domains")
    assert [(item.tag, [each.text for each in item] or item.text) for item in domains] == [
        ("id", "0"),
        ("id_range", ["5", "9"]),
    ]


@pytest.mark.parametrize(
    "key", [KeySpec("ec", "SECP384R1"), KeySpec("rsa", size=3072), KeySpec("rsa", size=4096)], ids=str
)
def test_keys_that_a_vendor_refuses(key):
    loaded = package(CHATTER)
    odd = replace(loaded, identity=replace(loaded.identity, key=key))
    with pytest.raises(KeymintError) as caught:
        build_type.build(odd, STRICT)
    assert codes(caught.value.diagnostics) == ["portability-key"]
    assert codes(build_type.build(odd, LENIENT).diagnostics) == ["portability-key"]


def test_rsa_with_2048_bits_is_fine():
    loaded = package(CHATTER)
    rsa = replace(loaded, identity=replace(loaded.identity, key=KeySpec("rsa", size=2048)))
    assert build_type.build(rsa, STRICT).diagnostics == ()


def test_a_large_document_is_a_warning_that_says_why():
    many = rule(
        "ALLOW", "ros_topic", "ros_publish", *(f"/robot/topic_number_{n * n * 7919}" for n in range(1300)), line=21
    )
    (found,) = build(CHATTER, many).diagnostics
    assert (found.code, found.severity, found.where.line) == ("size-permissions", Severity.WARNING, 21)
    assert "ALLOW ros_topic" in found.message


def test_the_documents_do_not_depend_on_the_order_of_the_rules():
    rules = [
        CHATTER,
        rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", "/a*", "*b"),
        rule("DENY", "ros_topic", "ros_publish", "/ab*", "/a/x"),
        rule("DENY", "ros_topic", "ros_subscribe", "/*x"),
        rule("ALLOW", "topic", "publish", "p*", "q*", partitions=["q", "p"]),
        rule("ALLOW", "topic", "publish", "*pq", "*qq"),
    ]
    orders = list(itertools.permutations(rules))
    some = random.Random("order").sample(orders, tries(60, len(orders)))
    documents = {build(*order).documents["permissions.xml"] for order in some}
    assert len(documents) == 1


def test_partitions_elsewhere_do_not_change_what_is_said_of_other_topics():
    both = rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", "/*")
    deny = (rule("DENY", "ros_topic", "ros_publish", "/a*"), rule("DENY", "ros_topic", "ros_subscribe", "/*b"))
    elsewhere = rule("ALLOW", "topic", "publish", "p*", partitions=["q"])
    assert shape(both, *deny, elsewhere) == [("allow_rule", {"publish": ["p*"]}), *shape(both, *deny)[1:]]


def test_the_documents_do_not_depend_on_the_hash_seed():
    program = (
        "import sys; sys.path[:0] = sys.argv[1:]\n"
        "from packages import package, rule\n"
        "from keymint.api import BuildOptions\n"
        "from keymint_ros2_dds import build_type\n"
        "both = 'ros_publish ros_subscribe'\n"
        "p = package(rule('ALLOW', 'ros_topic', both, '/a*', '*b', '/[xyz]'),"
        " rule('DENY', 'ros_topic', 'ros_publish', '/ab*'),"
        " rule('ALLOW', 'topic', 'publish', 'a*', 'b', partitions=['q', 'p', 'r']))\n"
        "print(build_type.build(p, BuildOptions()).documents)\n"
    )
    here = str(Path(__file__).parent)
    paths = [here, *sys.path]
    outputs = {
        subprocess.run(
            [sys.executable, "-c", program, *paths],
            env={"PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(outputs) == 1
    assert b"allow_rule" in outputs.pop()


def test_names_are_escaped_as_xml():
    assert shape(rule("ALLOW", "topic", "publish", "a<b&c>'\"")) == [("allow_rule", {"publish": ["a<b&c>'\""]})]


def test_the_documents_hold_nothing_that_a_vendor_refuses():
    built = build(CHATTER, rule("ALLOW", "topic", "publish", "x", partitions=["", "p"]))
    for content in built.documents.values():
        text = content.decode()
        assert "<!--" not in text
        assert "\r" not in text
        assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>\n<dds ')
        root = etree.fromstring(content)
        assert {name for item in root.iter() for name in item.attrib} <= {
            "name",
            "{http://www.w3.org/2001/XMLSchema-instance}noNamespaceSchemaLocation",
        }
        leaves = [item.text or "" for item in root.iter() if not len(item)]
        assert all(text == text.strip() for text in leaves)


@pytest.mark.parametrize("kind", ["permissions", "governance"])
def test_the_schemas_are_accepted_by_both_validators(kind):
    path = locate("keymint_ros2_dds", "schemas") / f"{kind}.xsd"
    independent = xmlschema.XMLSchema(str(path))
    content = build(CHATTER).documents[f"{kind}.xml"]
    root = etree.fromstring(content)
    assert etree.XMLSchema(file=str(path)).validate(root)
    independent.validate(content.decode())
    root[0].append(etree.Element("surprise"))
    assert not etree.XMLSchema(file=str(path)).validate(root)
    assert not independent.is_valid(etree.tostring(root).decode())
