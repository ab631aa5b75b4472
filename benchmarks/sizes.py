# SPDX-License-Identifier: Apache-2.0
"""Measure the size of permissions (plain, grouped, and as written) of the fleet example and of many exact rules.

usage: python benchmarks/sizes.py [--rules 1000]

Sizes are bytes of the unsigned document; signing adds about 1,450. Handshakes succeeded with signed documents of up to
56,000 bytes on every vendor, and failed on Fast DDS with 67,000. ``grouped`` is the folded form without rewriting, like
a document that a careful person writes by hand.
"""

from __future__ import annotations

import argparse
import functools
import random
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from unittest import mock

import navigation
from keymint_ros.distros import library
from keymint_ros2_comarmor import policy_type
from keymint_ros2_dds import build_type
from keymint_ros2_dds.compiling import grant_compiler, rewriting
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.settings import package_of
from keymint_ros2_dds.vendor_limits import BROKEN, signed_size
from proof import WORDS

from comarmor.errors import Origin
from keymint.api import BuildOptions, Package, PolicySource
from keymint.ir import SubjectRules

FLEET = Path(__file__).parent.parent / "examples" / "fleet"
SPACES = ("amr1", "amr2", "arm", "cell")
HERE = Origin("benchmark")


def package(rules: SubjectRules) -> Package:
    """Return a package with these rules, and a subject name that has the usual length."""
    found, name = package_of(rules, "jazzy"), f"OU=0f,CN={rules.subject}"
    identity, grant = replace(found.identity, subject_name=name), replace(found.grant, subject_name=name)
    return replace(found, identity=identity, grant=grant)


def subjects(path: Path) -> Iterator[SubjectRules]:
    """Yield the rules of every subject that a policy names exactly."""
    loaded = policy_type.load([PolicySource("policy", path, HERE)], library("jazzy"))
    for subject in loaded.subjects():
        rules = loaded.rules(subject)
        if rules is not None:
            yield rules


def exact(names: Sequence[str]) -> str:
    """Return a policy with one subject, and a rule for each name."""
    rules = "".join(
        f'<ros_topic qualifier="ALLOW"><attachment>{name}</attachment>'
        "<permissions><ros_publish/></permissions></ros_topic>"
        for name in names
    )
    return f'<profiles><profile name="p"><attachment>/many</attachment>{rules}</profile></profiles>'


def families(size: int) -> Iterator[tuple[str, list[str]]]:
    """Yield lists of exact names under a few namespaces, each with a title."""
    dice = random.Random(size)
    spaces = [SPACES[number % len(SPACES)] for number in range(size)]
    yield "numbered", [f"/{space}/sensor{number // len(SPACES)}" for number, space in enumerate(spaces)]
    sparse = dice.sample(range(size * 5), size)
    yield (
        "one in five numbers",
        [f"/{space}/sensor{number}" for space, number in zip(spaces, sorted(sparse), strict=True)],
    )
    pairs = [(a, b) for a in WORDS for b in WORDS]
    dice.shuffle(pairs)
    same = [f"/{space}/{a}/{b}" for a, b in pairs for space in SPACES]
    yield "the same words everywhere", same[:size]
    yield (
        "words at random",
        [f"/{space}/{dice.choice(WORDS)}_{dice.choice(WORDS)}{dice.randrange(1000)}" for space in spaces],
    )


def measured(rules: SubjectRules) -> tuple[int, int, int, float]:
    """Return the bytes of the plain, the grouped and the smallest form, and the seconds of a build."""
    source = package(rules)
    with mock.patch.object(
        grant_compiler, "gathered_rules", functools.partial(rewriting.gathered_rules, min_saved=10**9)
    ):
        grouped = build_type.build(source, BuildOptions())
    begin = time.process_time()
    built = build_type.build(source, BuildOptions())
    seconds = time.process_time() - begin
    name = "permissions.xml"
    return built.plain_sizes[name], len(grouped.documents[name]), len(built.documents[name]), seconds


def show(title: str, plain: int, grouped: int, small: int, seconds: float, fits: Callable[[int], str]) -> None:
    gain = (small - plain) / plain
    print(
        f"{title:28} {plain:>9,}{fits(plain)} {grouped:>9,}{fits(grouped)} {small:>9,}{fits(small)} "
        f"{gain:>6.0%} {seconds * 1e3:>7.0f} ms",
        flush=True,
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rules", type=int, default=1000)
    options = parser.parse_args()

    def fits(size: int) -> str:
        return "*" if signed_size(bytes(size)) > BROKEN else " "

    print(f"{'':28} {'plain':>9}  {'grouped':>9}  {'written':>9}  {'gain':>6} {'build':>10}")
    total = [0, 0, 0, 0.0]
    for rules in subjects(FLEET):
        sizes = measured(rules)
        total = [old + new for old, new in zip(total, sizes, strict=True)]
        show(f"fleet {rules.subject}", *sizes, lambda _size: " ")
    show("fleet, all", int(total[0]), int(total[1]), int(total[2]), total[3], lambda _size: " ")
    with tempfile.TemporaryDirectory() as folder:
        for title, names in families(options.rules):
            path = Path(folder) / "policy.xml"
            path.write_text(exact(list(dict.fromkeys(names))))
            for rules in subjects(path):
                show(f"{len(set(names)):,} {title}", *measured(rules), fits)
        path.write_text(navigation.policy())
        for rules in subjects(path):
            with mock.patch.object(dds_xml, "INDENTED", 10**9):
                show("navigation, indented", *measured(rules), fits)
            show("navigation, as written", *measured(rules), fits)
    print("* a signed document of that size breaks handshakes on Fast DDS")


if __name__ == "__main__":
    main()
