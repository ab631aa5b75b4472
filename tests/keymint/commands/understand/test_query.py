# SPDX-License-Identifier: Apache-2.0
"""``keymint query``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import CHECKOUT

FLEET = CHECKOUT / "examples/fleet"
SHARED = ["--except", "/parameter_events", "--except", "ros_discovery_info"]


@pytest.mark.parametrize(
    ("question", "code", "said"),
    [
        ("who can publish /fleet/emergency_stop", 0, "/fleet/dispatcher ros_publish /fleet/emergency_stop"),
        ("who can ros_subscribe /robot1/private/*", 0, "nobody: no subject can ros_subscribe /robot1/private/*"),
        ("what can /robot1/base do", 0, "ros_subscribe  /robot1/cmd_vel"),
        ("what can /fleet/dashboard do", 0, "/robot1/* but /robot1/private/*"),
        ("what can /nobody do", 0, "no profile of the policy applies to it"),
        ("can /robot*/navigator ever publish /robot2/*", 0, "yes: /robot2/navigator ros_publish /robot2/cmd_vel"),
        ("can /robot1/* ever publish /robot2/*", 0, "no: /robot1/* can never ros_publish /robot2/*"),
        ("can /fleet/dispatcher request /robot1/navigate", 0, "yes: /fleet/dispatcher ros_request /robot1/navigate"),
        ("flows /robot1/lidar /robot1/navigator", 0, "yes: in 1 step"),
        ("flows /robot1/* /robot1/*", 0, "yes: in 1 step"),
        ("flows * /robot1/navigator", 0, "yes: in 1 step"),
        (
            "isolated /robot1/* /robot2/*",
            0,
            "except what the library allows every node (ros_discovery_info, /param",
        ),
        (
            "isolated /robot1/base /fleet/dispatcher",
            3,
            "also, by infrastructure: ros_discovery_info, /parameter_eve",
        ),
        (
            "flows /fleet/dashboard /robot1/lidar",
            0,
            "except what the library allows every node (ros_discovery_info",
        ),
    ],
)
def test_answers_on_the_fleet(keymint, question: str, code: int, said: str) -> None:
    outcome = keymint("query", FLEET, *question.split())
    assert outcome.code == code, outcome.err
    assert said in outcome.out
    assert keymint("query", FLEET, question).out == outcome.out


@pytest.mark.parametrize(
    ("question", "message", "help_"),
    [
        ("who can publish /robot1/cmd_ve", "no rule is about '/robot1/cmd_ve'", "did you mean '/robot1/cmd_vel'?"),
        ("can /robot1/base subscribe /robot1/cmd_vle", "no rule is about", "did you mean '/robot1/cmd_vel'?"),
        (
            "who can publish /robot1/navigate",
            "'/robot1/navigate' is the name of a ros_action",
            "ros_request and ros_op",
        ),
        ("who can publish robot1/cmd_vel", "is read as a raw topic", "did you mean '/robot1/cmd_vel'?"),
        ("can /fleet/dashbord subscribe /robot1/cmd_vel", "applies to /fleet/dashbord, so it has no perm", ""),
    ],
)
def test_an_object_that_is_misspelt(keymint, question: str, message: str, help_: str) -> None:
    outcome = keymint("query", FLEET, question, "--json")
    (said,) = outcome.document["diagnostics"]
    assert message in said["message"]
    assert help_ in (said["help"] or "")
    assert outcome.code == 0


@pytest.mark.parametrize("question", ["who can publish /elsewhere", "who can publish /robot1/private/x"])
def test_an_object_that_is_like_no_other_is_not_doubted(keymint, question: str) -> None:
    assert keymint("query", FLEET, question, "--json").document["diagnostics"] == []


def test_a_subject_that_is_misspelt(keymint) -> None:
    assert "did you mean '/fleet/dashboard'?" in keymint("query", FLEET, "what can /fleet/dashbord do").out


def test_infrastructure_counts_if_asked(keymint) -> None:
    outcome = keymint("query", FLEET, "isolated", "/robot1/*", "/robot2/*", "--infrastructure")
    assert outcome.code == 3
    assert "not isolated: 2 channels" in outcome.out


def test_what_is_shared_on_purpose(keymint) -> None:
    outcome = keymint("query", FLEET, "isolated", "/robot1/*", "/robot2/*", *SHARED)
    assert outcome.code == 0
    assert outcome.out.startswith("isolated: nothing flows between /robot1/* and /robot2/*, except /parameter_events")
    steps = keymint("query", FLEET, "flows", "/robot1/lidar", "/robot2/base", *SHARED).out.splitlines()
    assert steps[0] == "yes: in 3 steps"
    assert steps[3] == (
        "  /fleet/dispatcher → /robot2/base by ros_topic /fleet/emergency_stop (ros_publish, ros_subscribe)"
    )


def test_the_policy_of_the_workspace(keymint, provisioned: Path) -> None:
    outcome = keymint("query", "who", "can", "publish", "/chatter", "--json", cwd=provisioned)
    assert outcome.document["result"]["answer"] == "yes"
    (holder,) = outcome.document["result"]["holders"]
    assert (holder["subject"], holder["object"]) == ("/talker", "/chatter")
    assert keymint("query", provisioned, "who can publish /chatter").code == 0


def test_partitions(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(
        '<profiles><profile name="a"><attachment>/a</attachment><topic qualifier="ALLOW"><attachment>t</attachment>'
        "<permissions><publish/></permissions><partitions><partition>ops</partition></partitions></topic>"
        "</profile></profiles>"
    )
    question = ["query", "p.xml", "can", "/a", "publish", "t"]
    assert keymint(*question).out.startswith("no:")
    assert "t in partition 'ops'" in keymint(*question, "--partition", "o*").out
    assert "publish     t in partition 'ops'" in keymint("query", "p.xml", "what can /a do").out


@pytest.mark.parametrize(
    ("question", "said"),
    [
        ("who kan publish /x", "expected 'can', not 'kan'"),
        ("who can publsh /x", "did you mean 'publish'?"),
        ("who can ros_publish x", "did you mean '/x', or the raw topic 'x' by --kind topic?"),
        ("who can call x", "did you mean '/x'?"),
        ("who can call /x --kind topic", "there is no permission 'call' of a topic"),
        ("whom can publish /x", "did you mean 'who'?"),
        ("what can /a", "expected 'do'"),
        ("flows /a", "too few words"),
        ("who can publish \\", "ends with a lone"),
        ("who can publish /x --except /y", "takes no --except"),
        ("who can publish /x --infrastructure", "takes no --infrastructure"),
    ],
)
def test_mistakes(keymint, policy: Path, question: str, said: str) -> None:
    outcome = keymint("query", policy, *question.split())
    assert (outcome.code, outcome.out) == (2, "")
    assert said in outcome.err


def test_subjects_that_the_policy_does_not_name(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(
        '<profiles><profile name="g"><attachment>/guest/*</attachment><ros_topic qualifier="ALLOW"><attachment>'
        "{namespace}say</attachment><permissions><ros_publish/><ros_subscribe/></permissions></ros_topic></profile>"
        "</profiles>"
    )
    told = keymint("query", "p.xml", "what", "can", "/guest/*", "do", "--json").document["result"]
    assert told["subjects"] == ["/guest/x"]
    assert told["abilities"][0]["expression"] == "/guest/say"
    assert keymint("query", "p.xml", "what", "can", "/host/*", "do").out == (
        "no profile of the policy applies to any subject that /host/* matches\n"
    )
    assert keymint("query", "p.xml", "isolated", "/guest/a/*", "/guest/b/*").code == 0
    assert keymint("query", "p.xml", "isolated", "/guest/*", "/guest/b").code == 3


def test_no_question(keymint, policy: Path) -> None:
    assert "the question is missing" in keymint("query", policy).err
    assert "the question is missing" in keymint("query").err


@pytest.mark.parametrize(
    ("question", "said"),
    [
        ("who can publish //x", "no ros_topic can have a name like '//x'"),
        ("who can publish fleet/emergency_stop", "did you mean '/fleet/emergency_stop'?"),
        ("can /robt1/base publish /robot1/odom", "did you mean '/robot1/base'?"),
        ("flows /robot1/base /nobody", "no profile of the policy applies to /nobody"),
    ],
)
def test_what_may_not_be_meant_is_said(keymint, question: str, said: str) -> None:
    outcome = keymint("query", FLEET, question)
    assert (outcome.code, outcome.err.count("warning:")) == (0, 1)
    assert said in outcome.err


def test_a_raw_topic_that_is_meant(keymint) -> None:
    assert keymint("query", FLEET, "who can publish ros_discovery_info").err == ""


@pytest.mark.parametrize(
    ("question", "said"),
    [
        ("publish rt/fleet/emergency_stop", "/fleet/dispatcher ros_publish /fleet/emergency_stop"),
        ("publish rt/robot1/*", "/robot1/base ros_publish /robot1/odom"),
        ("subscribe rt/robot1/cmd_vel", "/robot1/base ros_subscribe /robot1/cmd_vel"),
        (
            "publish rq/robot1/navigate/_action/send_goalRequest",
            "/fleet/dispatcher ros_call /robot1/navigate/_action/send_goal",
        ),
        ("subscribe rr/robot1/navigate/_action/send_goalReply", "/fleet/dispatcher ros_call /robot1/navigate/"),
        ("publish rr/robot1/navigate/_action/send_goalReply", "/robot1/navigator ros_execute /robot1/navigate/"),
    ],
)
def test_a_raw_topic_that_a_ros_name_maps_to(keymint, question: str, said: str) -> None:
    """A rule on the ROS name gives the right, so the answer may not be a proven no."""
    outcome = keymint("query", FLEET, "who can", *question.split())
    assert said in outcome.out
    assert outcome.err == ""
    assert keymint("query", FLEET, f"can /* {question}", "--kind", "topic").out.startswith("yes: ")


@pytest.mark.parametrize("question", ["publish rt/elsewhere", "publish rq/robot1/navigateReply", "relay rr/xReply"])
def test_a_raw_topic_that_nobody_has_a_right_on(keymint, question: str) -> None:
    assert keymint("query", FLEET, f"who can {question}").out.startswith("nobody: ")


def test_a_raw_topic_may_begin_with_a_slash(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(
        '<profiles><profile name="a"><attachment>/a</attachment><topic qualifier="ALLOW"><attachment>/t</attachment>'
        "<permissions><publish/></permissions></topic></profile></profiles>"
    )
    assert keymint("query", "p.xml", "who can publish /t").out.startswith("nobody")
    assert keymint("query", "p.xml", "who can publish /t", "--kind", "topic").out.startswith("/a publish /t")
    assert keymint("query", "p.xml", "who can publish t", "--kind", "topic").err == ""


def test_the_slash_of_a_subject_is_optional(keymint, policy: Path) -> None:
    for question in ("can {}talker publish /chatter", "what can {}talker do", "flows {}talker {}listener"):
        with_slash, without = (keymint("query", policy, question.replace("{}", slash)) for slash in ("/", ""))
        assert without.out.replace("no profile", "") != ""
        assert with_slash.code == without.code
        assert with_slash.out.partition("(")[0] == without.out.replace("flows from ", "flows from ").partition("(")[0]


NODES = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="a"><attachment>/a</attachment><xi:include href="common/node.xml" parse="xml"/></profile>
  <profile name="b"><attachment>/b</attachment><xi:include href="common/node.xml" parse="xml"/>{own}</profile>
  <profile name="guests"><attachment>/guest/*</attachment><xi:include href="common/node.xml" parse="xml"/></profile>
</profiles>"""


def isolated(keymint, folder: Path, own: str, *subjects: str) -> tuple[str, set[str], set[str]]:
    """Return the answer, the channels, and those that are infrastructure."""
    (folder / "nodes.xml").write_text(NODES.format(own=own))
    result = keymint("query", "nodes.xml", "isolated", *(subjects or ("/a", "/b")), "--json").document["result"]
    channels, infrastructure = ({each["object"] for each in result[key]} for key in ("channels", "infrastructure"))
    return result["answer"], channels, infrastructure


def test_infrastructure_is_what_the_library_allows_to_both_ends(keymint, tmp_path: Path) -> None:
    shared = {"ros_discovery_info", "/parameter_events"}
    assert isolated(keymint, tmp_path, "") == ("yes", set(), shared)
    reads = '<ros_topic qualifier="ALLOW"><attachment>{}</attachment><permissions>{}</permissions></ros_topic>'
    # The library lets /a write to /rosout, but the policy says that /b reads it.
    assert isolated(keymint, tmp_path, reads.format("/rosout", "<ros_subscribe/>")) == ("no", {"/rosout"}, shared)
    assert isolated(keymint, tmp_path, reads.format("/clock", "<ros_publish/>")) == ("no", {"/clock"}, shared)
    assert isolated(keymint, tmp_path, reads.format("/*", "<ros_subscribe/>")) == ("no", {"/rosout"}, shared)
    # A denial takes it away from either.
    denied = reads.format("/parameter_events", "<ros_publish/><ros_subscribe/>").replace("ALLOW", "DENY")
    assert isolated(keymint, tmp_path, denied) == ("yes", set(), {"ros_discovery_info"})


def test_infrastructure_of_subjects_that_are_not_named(keymint, tmp_path: Path) -> None:
    assert isolated(keymint, tmp_path, "", "/guest/x", "/guest/*")[:2] == ("yes", set())
    own = (
        '<ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>'
    )
    assert isolated(keymint, tmp_path, own, "/b", "/guest/*")[:2] == ("yes", set())
    outcome = keymint("query", "nodes.xml", "isolated", "/guest/x", "/guest/*", "--infrastructure")
    assert outcome.code == 3


def test_a_changed_library_is_no_infrastructure(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(NODES.format(own=""))
    assert keymint("provision", "p.xml", "-w", "ws").code == 0
    assert keymint("query", "ws", "isolated", "/a", "/b").code == 0
    (copy,) = (tmp_path / "ws").rglob("common/node/graph.xml")
    copy.write_text(copy.read_text().replace("ros_discovery_info", "anything"))
    outcome = keymint("query", "ws", "isolated", "/a", "/b")
    assert outcome.code == 3
    assert "by topic anything" in outcome.out


UNNAMED = """<profiles>
  <profile name="all">
    <attachment>/x/*</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/a</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="one">
    <attachment>/x/one</attachment>
    <ros_topic qualifier="DENY"><attachment>/a</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="hub">
    <attachment>/hub</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/a</attachment><permissions><ros_subscribe/></permissions></ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/b</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="end">
    <attachment>/end</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/b</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
  <profile name="others">
    <attachment>/other/*</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/b</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
  <profile name="none">
    <attachment>/other/none</attachment>
    <ros_topic qualifier="DENY"><attachment>/b</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
  <profile name="start">
    <attachment>/start</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/a</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="robots">
    <attachment>/robot*</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/r</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
</profiles>
"""


@pytest.mark.parametrize(
    ("question", "answer", "steps"),
    [
        ("flows /robot* /robot*", "unknown", [("/robot*", "/robot*")]),
        ("flows /robot1 /robot2", "yes", []),
        ("flows /robot* /x/*", "no", []),
        ("flows /x/* /hub", "unknown", [("/x/*", "/hub")]),
        ("flows /x/* /end", "unknown", [("/x/*", "/hub"), ("/hub", "/end")]),
        ("flows /x/one /end", "no", []),
        ("flows /h* /e*", "yes", []),
        ("flows /hub /other*", "unknown", [("/hub", "/other/*")]),
        ("flows /robot* /o*", "no", []),
        ("flows /s* /o*", "unknown", [("/start", "/hub"), ("/hub", "/other/*")]),
        ("flows /end /x/*", "no", []),
        ("what can /x/* do", "unknown", []),
        ("what can /x/one do", "no", []),
        ("what can /en* do", "yes", []),
    ],
)
def test_subjects_without_a_name_are_not_forgotten(
    keymint: Callable, tmp_path: Path, question: str, answer: str, steps: list[tuple[str, str]]
) -> None:
    """The answer was no, as only the subjects that the policy names were asked."""
    (tmp_path / "unnamed.xml").write_text(UNNAMED)
    outcome = keymint("query", "unnamed.xml", *question.split(), "--json")
    result = outcome.document["result"]
    assert (result["answer"], outcome.code) == (answer, 3 if answer == "unknown" else 0)
    assert [(each["writer"], each["reader"]) for each in result.get("perhaps", ())] == steps
    assert ("unknown: no" in keymint("query", "unnamed.xml", *question.split()).out) == (answer == "unknown")
