# SPDX-License-Identifier: Apache-2.0
"""Cases of policies: the examples, random ones, and odd ones that are refused, or should be."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from random import Random

from tests.families import FAMILIES
from tests.generated import pretty, tokens

from .record import Case, Steps
from .workspaces import POLICY, SROS2_POLICY, models, read_all

DISTROS = ("ardent", "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic", "humble", "iron", "jazzy",
           "kilted", "lyrical", "rolling")  # fmt: skip
TRANSPORTS = ((), ("--transport", "zenoh"), ("--transport", "dds", "--transport", "zenoh"))
FORMATS = ("keymint_ros2_sros2", "xacml", "keymint_ros2_comarmor")

# -- examples --------------------------------------------------------------------------------------------------------

_EXAMPLES = {
    "talker_listener": "talker_listener.xml",
    "action": "fibonacci.xml",
    "add_two_ints": "add_two_ints.xml",
    "fleet": "fleet.xml",
    "operator": "operator.xml",
    "ppac_2018": "amended.xml",
}


def examples() -> Mapping[str, Case]:
    """Return a case for each example, build type and kind of distribution."""
    found: dict[str, Case] = {}
    for name, policy in _EXAMPLES.items():
        for number, transport in enumerate(TRANSPORTS):
            found[f"example-{name}-{number}"] = partial(_example, name, policy, transport)
    for distro in DISTROS:
        for name in ("action", "operator"):
            found[f"distro-{distro}-{name}"] = partial(_distro, name, _EXAMPLES[name], distro)
    return found


def _example(name: str, policy: str, transport: tuple[str, ...], s: Steps) -> None:
    folder = s.example(name)
    s.run("provision", f"{folder}/{policy}", "-w", "ws", *transport)
    read_all(s, "ws")
    s.both("test", f"{folder}/{policy}")
    for each in FORMATS:
        s.run("export", f"{folder}/{policy}", "--format", each, "--lossy")
    for kind in ("svg", "dot", "html", "png"):
        s.run("graph", f"{folder}/{policy}", "-o", f"g.{kind}")
    s.both("graph", "-w", "ws", "--all", "--by", "subject", "-o", "all.svg")
    for verb in ("create", "build", "install"):
        s.run(verb, "-w", "ws", *(["--all"] if verb == "create" else []))
    s.run("build", "-f", "--no-optimise", "-w", "ws")
    s.run("install", "-w", "ws", days=1)


def _distro(name: str, policy: str, distro: str, s: Steps) -> None:
    folder = s.example(name)
    for number, transport in enumerate(TRANSPORTS):
        s.run("provision", f"{folder}/{policy}", "-w", f"ws{number}", "--distro", distro, *transport)
        s.both("check", "-w", f"ws{number}")
    s.run("prove", "-w", "ws0", "--json")
    s.run("verify", *models(s, "ws0"), "-w", "ws0", "--json")
    s.run("lint", f"{folder}/{policy}", "--distro", distro)


# -- random policies -------------------------------------------------------------------------------------------------


def random(count: int) -> Mapping[str, Case]:
    """Return cases of policies of a generator: the same policy and options for the same number."""
    return {f"random-{seed:03}": partial(_random, seed) for seed in range(count)}


def _random(seed: int, s: Steps) -> None:
    rng = Random(seed)
    transport = rng.choice((*TRANSPORTS, ()))
    policy = _concrete(pretty(tokens(seed)), rng)
    # Zenoh has no word for much of the language; one in eight of its policies has it all, and is refused.
    zenoh = "zenoh" in transport and rng.random() < 7 / 8
    s.write("policy.xml", _without_dds(policy) if zenoh else policy)
    s.write("other.xml", pretty(tokens(seed + 10_000)))
    options = [*transport, "--distro", rng.choice(("jazzy", *(DISTROS[7:8] + DISTROS[9:] if zenoh else DISTROS)))]
    options += rng.choice(([], ["--domain", str(rng.randrange(231))]))
    options += rng.choice(([], [], ["--subject-format", "sros2"]))
    options += rng.choice(([], [], ["--no-optimise"]))
    if s.run("provision", "policy.xml", "-w", "ws", *options).code:
        s.run("provision", "policy.xml", "-w", "ws", *options, "--allow-vendor-specific")
    s.run("check", "-w", "ws", "--json", "--allow-vendor-specific")
    _ASKED[seed % len(_ASKED)](s)


def _without_dds(policy: str) -> str:
    """Leave out what only DDS has: its topics by their own names, and rights to relay."""
    policy = re.sub(r"<topic .*?</topic>\n", "", policy, flags=re.DOTALL)
    policy = policy.replace("<ros_relay/>\n", "")
    return policy.replace("<permissions>\n</permissions>", "<permissions>\n<ros_publish/>\n</permissions>")


def _concrete(policy: str, rng: Random) -> str:
    """Add subjects to a policy that it names exactly, so that there is something to provision."""
    rule = (
        '<ros_topic qualifier="ALLOW"><attachment>{namespace}*</attachment>'
        f"<permissions><{rng.choice(('ros_publish', 'ros_subscribe'))}/></permissions></ros_topic>"
    )
    names = rng.sample(("/r1/talker", "/robot/driver", "/cell/line/ui", "/camera", "/fleet/r1/planner"), 2)
    added = "".join(f'<profile name="x"><attachment>{name}</attachment>{rule}</profile>\n' for name in names)
    return policy.replace("</profiles>", f"{added}</profiles>")


def _exports(kind: str, s: Steps) -> None:
    s.run("export", "policy.xml", "--format", kind, "--lossy", "-o", "exported")


_ASKED: tuple[Callable[[Steps], object], ...] = (
    lambda s: s.run("lint", "policy.xml", "--json"),
    lambda s: s.both("diff", "policy.xml", "other.xml"),
    lambda s: s.run("fmt", "--diff", "policy.xml"),
    lambda s: s.run("prove", "-w", "ws", "--json"),
    lambda s: s.run("verify", *models(s, "ws"), "-w", "ws", "--json"),
    lambda s: s.both("query", "policy.xml", "who can publish /r1/scan"),
    lambda s: s.both("query", "policy.xml", "what can /r1/talker do"),
    lambda s: s.run("graph", "policy.xml", "--format", "dot"),
    lambda s: s.run("status", "-w", "ws", "--json"),
    *(partial(_exports, kind) for kind in FORMATS),
)  # fmt: skip

# -- odd policies ----------------------------------------------------------------------------------------------------


def _rule(inside: str, kind: str = "ros_topic", qualifier: str = "ALLOW", permission: str = "ros_publish") -> str:
    return f'<{kind} qualifier="{qualifier}">{inside}<permissions><{permission}/></permissions></{kind}>'


def _policy(inside: str, attachment: str = "/talker") -> str:
    return f'<profiles>\n<profile name="p"><attachment>{attachment}</attachment>\n{inside}\n</profile>\n</profiles>'


def _named(name: str, **options: str) -> str:
    return _policy(_rule(f"<attachment>{name}</attachment>", **options))


def _including(href: str) -> str:
    return f'<profiles xmlns:xi="http://www.w3.org/2001/XInclude"><xi:include href="{href}"/></profiles>'


_ODD = {
    "empty": "",
    "blank": "\n",
    "no_profiles": "<profiles/>",
    "not_xml": "talker: publish",
    "half": "<profiles><profile",
    "binary": "\x00\x01",
    "wrong_root": "<policy/>",
    "doctype": '<!DOCTYPE x [<!ENTITY e "x">]><profiles>&e;</profiles>',
    "laughs": '<!DOCTYPE l [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]><profiles>&b;</profiles>',
    "xxe": '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><profiles>&e;</profiles>',
    "latin1": '<?xml version="1.0" encoding="iso-8859-1"?><profiles/>',
    "pi": "<?php x?><profiles/>",
    "namespace": '<profiles xmlns="urn:x"/>',
    "deep": "<profiles>" + "<profile>" * 400 + "</profile>" * 400 + "</profiles>",
    "unknown_element": _policy("<ros_topik/>"),
    "unknown_attribute": "<profiles version='3'/>",
    "unknown_permission": _named("/t", permission="ros_publsh"),
    "wrong_permission": _named("/t", permission="ros_call"),
    "unknown_qualifier": _named("/t", qualifier="PERMIT"),
    "lower_qualifier": _named("/t", qualifier="deny"),
    "unknown_kind": _named("/t", kind="ros_topics"),
    "no_permission": _policy('<ros_topic qualifier="ALLOW"><attachment>/t</attachment><permissions/></ros_topic>'),
    "no_attachment": _policy(_rule("")),
    "empty_attachment": _named(""),
    "relative": _named("chatter"),
    "blank_name": _named("/a b"),
    "double_slash": _named("//a"),
    "trailing_slash": _named("/a/"),
    "digit": _named("/1a"),
    "unicode": _named("/größe"),
    "bracket": _named("/a["),
    "bracket_range": _named("/a[z-a]"),
    "brace": _named("/a{b}"),
    "alternatives": _named("/{a,b}"),
    "unknown_placeholder": _named("{nmespace}x"),
    "tilde": _named("~/x"),
    "unknown_tunable": _named("/@{NONE}/x"),
    "question_mark": _named("/a?"),
    "double_star": _named("/a/**"),
    "everything": _named("*"),
    "everything_denied": _named("*", qualifier="DENY"),
    "long": _named("/" + "a" * 300),
    "raw_topic": _named("rt/chatter", kind="topic", permission="publish"),
    "raw_slash": _named("/rt/x", kind="topic", permission="publish"),
    "service": _named("/add", kind="ros_service", permission="ros_call"),
    "service_wild": _named("/*/add", kind="ros_service", permission="ros_execute"),
    "action": _named("/fly", kind="ros_action", permission="ros_execute"),
    "action_call": _named("/fly*", kind="ros_action", permission="ros_call"),
    "parameter": _named("/camera", kind="ros_parameter", permission="ros_write"),
    "parameter_wild": _named("/c*", kind="ros_parameter", permission="ros_read"),
    "subject_relative": _policy("", "talker"),
    "subject_star": _policy("", "*"),
    "subject_root": _policy("", "/"),
    "subject_long": _policy("", "/" + "b" * 120),
    "subject_deep": _policy("", "/a" * 60),
    "subject_case": _policy("", "/Talker").replace("</profiles>", _policy("", "/talker")[len("<profiles>") :]),
    "subject_reserved": _policy("", "/zenoh_router"),
    "subject_unicode": _policy("", "/täler"),
    "subject_public": _policy("", "/public"),
    "subject_dots": _policy("", "/../x"),
    "twice": _policy(_rule("<attachment>/t</attachment>") * 2),
    "conflict": _policy(_rule("<attachment>/t</attachment>") + _rule("<attachment>/t</attachment>", qualifier="DENY")),
    "partition": _policy(
        '<topic qualifier="ALLOW"><attachment>t</attachment><partitions><partition>p*</partition>'
        "</partitions><permissions><publish/></permissions></topic>"
    ),
    "deny_partition": _policy(
        '<topic qualifier="DENY"><attachment>t</attachment><partitions><partition>p</partition>'
        "</partitions><permissions><publish/></permissions></topic>"
    ),
    "include_missing": _including("no.xml"),
    "include_outside": _including("../../etc/x"),
    "include_self": _including("policy.xml"),
    "include_url": _including("http://x/y.xml"),
    "include_package": '<profiles xmlns:xi="http://www.w3.org/2001/XInclude"><profile name="p"><attachment>/t'
    '</attachment><xi:include href="package://nav/x.xml" parse="xml"/></profile></profiles>',
    "tunable_loop": _policy(_rule("<attachment>/@{T}</attachment>")).replace(
        "<profiles>", '<profiles><tunable name="T"><value>@{T}</value></tunable>'
    ),
    "tunable_empty": _policy("").replace("<profiles>", '<profiles><tunable name="T"/>'),
    "audit": _policy(_rule("<attachment>/t</attachment>").replace("qualifier", 'modifier="AUDIT" qualifier')),
    "comment": f"<!-- a -- b -->{_policy('')}",
    "sros2": SROS2_POLICY,
    "sound": POLICY,
}
_TABLES = {
    "sound": "subject,kind,permission,object,qualifier\n*,include,,common/node.xml,\n/a/nav,ros_topic,ros_publish,"
    "{namespace}cmd,ALLOW\n/b,ros_topic,ros_subscribe,/a/cmd,ALLOW\n/b,ros_service,ros_call,/a*/stop,DENY\n",
    "qualifier": "subject,kind,permission,object,qualifier\n/a,ros_topic,ros_publish,/x,ALOW\n",
    "columns": "subject,kind\n/a,ros_topic\n",
    "short": "subject,kind,permission,object,qualifier\n/a\n",
    "empty": "",
}
_SROS2 = {
    "unknown": SROS2_POLICY.replace('publish="ALLOW"', 'publsh="ALLOW"'),
    "version": SROS2_POLICY.replace("0.2.0", "9.9"),
    "tilde": SROS2_POLICY.replace(">chatter<", ">~/chatter<"),
    "deny": SROS2_POLICY.replace('publish="ALLOW"', 'publish="DENY"'),
    "sound": SROS2_POLICY,
    "actions": SROS2_POLICY.replace("<topics", '<actions call="ALLOW"><action>fly</action></actions><topics', 1),
}


def odd() -> Mapping[str, Case]:
    """Return cases of policies that are refused, or that few would write."""
    found: dict[str, Case] = {f"odd-{name}": partial(_odd, "policy.xml", text) for name, text in _ODD.items()}
    found |= {f"odd-table-{name}": partial(_odd, "policy.csv", text) for name, text in _TABLES.items()}
    found |= {f"odd-sros2-{name}": partial(_odd_sros2, text) for name, text in _SROS2.items()}
    found |= {f"odd-large-{name}": partial(_large, family(40)) for name, family in FAMILIES.items()}
    return found


def _odd(name: str, text: str, s: Steps) -> None:
    s.write(name, text)
    for number, transport in enumerate(TRANSPORTS):
        s.both("provision", name, "-w", f"ws{number}", *transport)
    s.run("provision", name, "-w", "ws0", "--allow-vendor-specific", "--json")
    s.both("check", "-w", "ws0")
    s.both("lint", name)
    s.both("fmt", "--diff", name)
    s.both("query", name, "who can publish /t")
    s.run("graph", name, "--format", "dot")
    for each in FORMATS:
        s.both("export", name, "--format", each)


def _odd_sros2(text: str, s: Steps) -> None:
    s.write("policy.xml", text)
    s.both("import", "policy.xml", "--dry-run")
    s.both("import", "policy.xml", "--as-written", "-o", "accepted")
    s.both("import", "policy.xml", "--no-implicit", "-o", "plain")
    s.run("provision", "accepted", "-w", "ws")
    s.both("check", "-w", "ws")
    s.both("lint", "policy.xml", "--policy-type", "keymint_ros2_sros2")


def _large(text: str, s: Steps) -> None:
    s.write("policy.xml", text)
    s.run("provision", "policy.xml", "-w", "ws", "-j", 2)
    s.both("check", "-w", "ws", "--within", "2y")
    s.run("lint", "policy.xml", "--json")
    s.run("provision", "policy.xml", "-w", "zenoh", "--transport", "zenoh", "--no-prove")
