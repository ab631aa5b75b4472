# SPDX-License-Identifier: Apache-2.0
"""Policies of any size in several shapes, to measure how the cost of a stage grows with the size."""

from __future__ import annotations

from itertools import islice, product


def _rule(effect: str, expression: str, kind: str = "ros_topic", permission: str = "ros_publish") -> str:
    return (
        f'<{kind} qualifier="{effect}"><attachment>{expression}</attachment>'
        f"<permissions><{permission}/></permissions></{kind}>\n"
    )


def _profile(name: str, attachment: str, *inside: str) -> str:
    return f'<profile name="{name}"><attachment>{attachment}</attachment>\n{"".join(inside)}</profile>\n'


def _policy(*inside: str) -> str:
    return "<profiles>\n" + "".join(inside) + "</profiles>\n"


def flat(size: int) -> str:
    """Return ``size`` profiles of one subject and three rules each; each subscribes to the topic of the next."""
    return _policy(
        *(
            _profile(
                f"n{at}",
                f"/cell{at // 50}/node{at}",
                _rule("ALLOW", f"/cell{at // 50}/data{at}"),
                _rule("ALLOW", f"/cell{at // 50}/data{(at + 1) % size}", permission="ros_subscribe"),
                _rule("ALLOW", "{namespace}common"),
            )
            for at in range(size)
        )
    )


def misspelt(size: int) -> str:
    """Return ``size`` profiles whose topics have no other end, and nearly the same names."""
    words = ["".join(letters) for letters in islice(product("abcdefgh", repeat=5), size)]
    return _policy(
        *(
            _profile(
                word, f"/n_{word}", _rule("ALLOW", f"/topic_{word}_pub"),
                _rule("ALLOW", f"/topic_{word[::-1]}_sub", permission="ros_subscribe"),
            )
            for word in words
        )
    )  # fmt: skip


def wild(size: int) -> str:
    """Return ``size`` profiles whose attachments have wildcards and overlap."""
    return _policy(*(_profile(f"n{at}", f"/cell{at}/*", _rule("ALLOW", f"/cell{at}/x*")) for at in range(size)))


def nested(size: int, depth: int = 50) -> str:
    """Return ``size`` profiles, nested in chains; all profiles of a chain attach to the same subjects."""
    chains = []
    for chain in range(max(1, size // depth)):
        inner = ""
        for level in range(depth):
            inner = _profile(f"c{chain}l{level}", f"/c{chain}/*", _rule("ALLOW", f"/c{chain}/t{level}"), inner)
        chains.append(inner)
    return _policy(*chains)


def infixes(size: int) -> str:
    """Return one profile with ``size`` rules ``*a*b*``, alternately ALLOW and DENY."""
    words = [f"{one}{two}" for one, two in product("abcdefghijklmnopqrst", repeat=2)]
    rules = [_rule("DENY" if at % 2 else "ALLOW", f"/*{words[at]}*{words[-at - 1]}*") for at in range(size)]
    return _policy(_profile("p", "/s", *rules))


def bracketed(size: int) -> str:
    """Return one profile with ``size`` rules of names with brackets and wildcards."""
    rules = [_rule("ALLOW", f"/n{at}[0-9a-f]?x[!z]*") for at in range(size)]
    return _policy(_profile("p", "/s", *rules))


def tunables(rules: int, values: int = 20) -> str:
    """Return one profile with a tunable of ``values`` expressions with wildcards in every rule."""
    listed = "".join(f"<value>/v{at}*</value>" for at in range(values))
    tunable = f'<tunable name="T">{listed}</tunable>\n'
    return _policy(tunable, _profile("p", "/s", *(_rule("ALLOW", f"@{{T}}/t{at}") for at in range(rules))))


def exact(size: int) -> str:
    """Return one profile with ``size`` exact rules."""
    return _policy(_profile("p", "/s", *(_rule("ALLOW", f"/cell{at // 40}/sensor{at}") for at in range(size))))


def partitioned(size: int) -> str:
    """Return one profile with ``size`` topics with wildcards, each in one of seven partitions."""
    rules = []
    for at in range(size):
        partition = f"<partitions><partition>p{at % 7}</partition></partitions>"
        rule = _rule("ALLOW", f"t{chr(97 + at % 5)}*{at % 11}*", "topic", "publish")
        rules.append(rule.replace("<permissions>", f"{partition}<permissions>"))
    return _policy(_profile("p", "/s", *rules))


FAMILIES = {
    each.__name__: each for each in (flat, misspelt, wild, nested, infixes, bracketed, tunables, exact, partitioned)
}
