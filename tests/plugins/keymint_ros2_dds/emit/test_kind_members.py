# SPDX-License-Identifier: Apache-2.0
"""A document of a kind is the engine's, byte for byte; whoever violates a condition of the lemma goes to the engine.

Each test of a condition also writes the document that would follow without it, and shows that it is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import event, given, settings, strategies as st
from keymint_ros2_dds import build_type
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.emit import emission, kind_members
from keymint_ros2_dds.emit.kind_members import Structure
from keymint_ros2_dds.proving.claims import prove_content
from keymint_ros2_dds.settings import package_of

from comarmor.rules import parts
from keymint.analysis.subject_patterns import rules_of
from keymint.api import BuildOptions, BuildResult, DomainRange, Package, Proof, Validity
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules, kind_of
from tests.effort import tries
from tests.generated import pretty, tokens
from tests.keymint.analysis.policies import loaded_text
from tests.plugins.keymint_ros2_dds.packages import VALIDITY, package, rule

USUAL = BuildOptions()
TALK, HEAR = ("ros_topic", "ros_publish"), ("ros_topic", "ros_subscribe")
PARAMETERS = ("ros_parameter", "ros_read")

NAMES = ["/a", "/b", "/ab", "/a/b", "/c"]
RAW = ["rt/a", "rt/b", "rt/ab", "x", "rq/aRequest"]
WILD = ["/*", "/a*", "/?", "/a/*", "*b", "/[ab]"]
RAW_WILD = ["rt/*", "*", "r?/a", "rt/a*b"]
KINDS = (
    ("ros_topic", ["ros_publish", "ros_subscribe", "ros_publish ros_subscribe", "ros_relay"], NAMES, WILD),
    ("ros_service", ["ros_call", "ros_execute"], NAMES, WILD),
    ("ros_action", ["ros_request"], NAMES, WILD),
    ("topic", ["publish", "subscribe", "publish subscribe"], RAW, RAW_WILD),
)


def by_engine(loaded: Package) -> BuildResult:
    with mock.patch.object(kind_members, "_known", {}):
        return build_type.build(loaded, USUAL)


def outcome(build, loaded: Package):
    try:
        return build(loaded)
    except KeymintError as error:
        return error.diagnostics


def by_kind(*loaded: Package) -> tuple[list[object], int]:
    """Return what is built for packages in turn, and how often the engine was asked."""
    with mock.patch.object(kind_members, "emit", wraps=emission.emit) as engine:
        return [outcome(lambda each: build_type.build(each, USUAL), each) for each in loaded], engine.call_count


@st.composite
def rules(draw, kinds=KINDS) -> Rule:
    kind, permissions, names, wild = draw(st.sampled_from(kinds))
    expressions = draw(st.lists(st.sampled_from([*names, *names, *wild]), min_size=1, max_size=3))
    return rule(
        draw(st.sampled_from(["ALLOW", "ALLOW", "DENY"])), kind, draw(st.sampled_from(permissions)), *expressions
    )


def names_of_a_subject() -> st.SearchStrategy[dict[str, str]]:
    """Draw another name for each name; they may coincide."""
    others = st.lists(st.sampled_from([*NAMES, "/long/name_0", "/d", "/e"]), min_size=5, max_size=5)
    raw = st.lists(st.sampled_from([*RAW, "rt/d", "rt/e", "y"]), min_size=5, max_size=5)
    return st.builds(lambda *to: dict(zip([*NAMES, *RAW], [*to[0], *to[1]], strict=True)), others, raw)


def renamed_packages(drawn: Sequence[Rule], renamings: Sequence[Mapping[str, str]]) -> list[Package]:
    """Return a package for each renaming of the expressions in some rules."""
    return [
        package(
            *(replace(each, expressions=tuple(names.get(text, text) for text in each.expressions)) for each in drawn),
            subject=f"/robot{number}",
        )
        for number, names in enumerate(renamings)
    ]


@settings(max_examples=tries(50, 100), deadline=None)
@given(st.lists(rules(), min_size=1, max_size=5), st.lists(names_of_a_subject(), min_size=2, max_size=5))
def test_every_member_has_the_bytes_of_the_engine_whoever_is_first(drawn, renamings) -> None:
    loaded = renamed_packages(drawn, renamings)
    expected = [outcome(by_engine, each) for each in loaded]
    for turned in (False, True):
        with mock.patch.object(kind_members, "_known", {}):
            built, asked = by_kind(*loaded[:: -1 if turned else 1])
        event(f"renamed: {asked < len(loaded)}")
        assert built == expected[:: -1 if turned else 1]


@pytest.mark.parametrize("seed", range(tries(6, 120)))
def test_all_subjects_of_a_random_policy_have_the_bytes_of_the_engine(tmp_path: Path, seed: int) -> None:
    policy = loaded_text(tmp_path, pretty(tokens(seed)))
    robots = {f"/{robot}/{name}" for robot in ("r1", "r2", "robot", "fleet/r1", "x") for name in ("talker", "driver")}
    rules_by_subject = {subject: SubjectRules(subject, rules_of(policy, subject)) for subject in sorted(robots)}
    loaded = [package_of(each, "jazzy") for each in rules_by_subject.values()]
    built, _ = by_kind(*loaded)
    assert built == [outcome(by_engine, each) for each in loaded]


OWN_NAMES = ["/a/x", "/b/x", "/ab/x_c", "/x"]
OWN_WILD = ["/a/*", "/a*", "/ab/*_c", "/*", "/b/*/x"]
OWN_RAW = ["rt/a/*", "rt/*", "*", "rt/a*_c", "rq/b*"]
OTHERS = {
    name: st.sampled_from([name, name.replace("a", "robot").replace("b", "arm"), *others])
    for names, others in (
        (OWN_NAMES, [*OWN_NAMES, "/d/x"]),
        (OWN_WILD, [*OWN_WILD, "/a/*_c", "/long/name*", "/a/x*", "/*/x", "*a"]),
        (OWN_RAW, [*OWN_RAW, "rt/*_c", "rt/a/x*", "*_c"]),
    )
    for name in names
}
OWN_KINDS = (
    ("ros_topic", ["ros_publish", "ros_subscribe", "ros_publish ros_subscribe", "ros_relay"], OWN_NAMES, OWN_WILD),
    ("ros_service", ["ros_call", "ros_execute"], OWN_NAMES, OWN_WILD),
    ("topic", ["publish", "subscribe", "publish subscribe"], ["rt/a/x", "rt/c"], OWN_RAW),
)


@settings(max_examples=tries(100, 3_000), deadline=None)
@given(
    st.lists(rules(OWN_KINDS), min_size=1, max_size=5), st.lists(st.fixed_dictionaries(OTHERS), min_size=2, max_size=4)
)
def test_subjects_with_wildcards_of_their_own_have_bytes_and_claims_of_the_engine(drawn, texts) -> None:
    loaded = renamed_packages(drawn, texts)
    expected = [outcome(by_engine, each) for each in loaded]
    built, asked = by_kind(*loaded)
    event(f"renamed: {asked < len(loaded)}")
    assert built == expected
    for each, result in zip(loaded, built, strict=True):
        if isinstance(result, BuildResult):
            question = emission.comparison(each, result.documents["permissions.xml"])
            known = prove_content(question)
            with mock.patch("keymint_ros2_dds.proving.claims._proven", {}):
                assert prove_content(question) == known


def with_own_wildcards(number: int, deny: str = "secret") -> Package:
    return package(
        rule("ALLOW", *TALK, f"/data/n{number}_*", "/map"),
        rule("DENY", "ros_topic", "ros_publish ros_subscribe", f"/data/n{number}_{deny}"),
        rule("ALLOW", "ros_service", "ros_call", f"/robot{number}/*"),
        subject=f"/robot{number}",
    )


def test_robots_with_wildcards_of_their_own_need_the_engine_once() -> None:
    loaded = [with_own_wildcards(number) for number in (1, 22, 3, 400)]
    built, asked = by_kind(*loaded)
    assert asked == 1
    assert built == [by_engine(each) for each in loaded]


def test_the_intersection_of_two_wildcards_is_renamed() -> None:
    """The compiler writes it, since one direction allows what the other one denies: an expression, and a short name."""
    heard = rule("ALLOW", *HEAR, "/*"), rule("DENY", "topic", "subscribe", "*/raw")
    loaded = [
        package(rule("ALLOW", *TALK, f"/{name}/*"), rule("DENY", *TALK, f"/{name}/p"), *heard)
        for name in ("x", "robot")
    ]
    built, asked = by_kind(*loaded)
    assert asked == 1
    for topic in (b"<topic>rt/robot/*/raw<", b"<topic>rt/robot/raw<"):
        assert topic in built[1].documents["permissions.xml"]
    assert built == [by_engine(each) for each in loaded]


def test_the_names_that_are_too_short_for_a_wildcard_are_compared() -> None:
    """``/r1/scan`` begins and ends as ``/r1/*/scan``. It may be a name of the policy, or match another wildcard."""
    loaded = [
        package(
            rule("ALLOW", *TALK, f"/{robot}/*/scan", f"/{robot}/sc*", *more), rule("ALLOW", *PARAMETERS, f"/{robot}/*")
        )
        for more in ((), ("/r1/scan",), ("/robot/scan",), ("/a*",))
        for robot in ("r1", "robot", "a")
    ]
    built, asked = by_kind(*loaded)
    assert asked == 5, (
        "a name or a wildcard more is another kind; of these, a short name is equal to the name or is not"
    )
    assert built == [by_engine(each) for each in loaded]


def test_wildcards_without_a_name_in_common_have_no_intersection() -> None:
    """The texts before and after the ``*`` of one subject are no expression of the other."""
    loaded = [
        package(rule("ALLOW", "topic", "publish", text), rule("ALLOW", *HEAR, "/a*yx"))
        for text in ("rt/*_c", "rt/*q_c")
    ]
    built, asked = by_kind(*loaded)
    assert asked == 1
    assert built == [by_engine(each) for each in loaded]


def test_robots_with_wildcards_for_the_fleet_need_the_engine_once(tmp_path: Path) -> None:
    profiles = (
        f"""<profile name="r{number}"><attachment>/r{number}/driver</attachment>
        <ros_topic qualifier="ALLOW"><attachment>/r{number}/scan</attachment><attachment>/fleet/*</attachment>
          <permissions><ros_publish/></permissions></ros_topic>
        <ros_topic qualifier="DENY"><attachment>/fleet/secret/*</attachment>
          <permissions><ros_publish/><ros_subscribe/></permissions></ros_topic>
        <ros_action qualifier="ALLOW"><attachment>/r{number}/dock</attachment>
          <permissions><ros_operate/></permissions></ros_action></profile>"""
        for number in range(12)
    )
    policy = loaded_text(tmp_path, f"<profiles>{''.join(profiles)}</profiles>")
    subjects = [f"/r{number}/driver" for number in range(12)]
    loaded = [package_of(SubjectRules(each, rules_of(policy, each)), "jazzy") for each in subjects]
    built, asked = by_kind(*loaded)
    assert asked == 1
    assert built == [by_engine(each) for each in loaded]


def fleet(*numbers: int, more: Sequence[Rule] = ()) -> Iterator[Package]:
    for number in numbers:
        own = rule("ALLOW", *TALK, f"/robot{number}/scan", "/map", line=number)
        services = rule("ALLOW", "ros_parameter", "ros_read", f"/robot{number}/talker")
        yield package(own, services, *more, subject=f"/robot{number}")


def test_the_engine_makes_one_document_for_a_kind() -> None:
    loaded = list(fleet(1, 10, 7, 300))
    built, asked = by_kind(*loaded)
    assert asked == 1
    assert built == [by_engine(each) for each in loaded]


def test_topics_are_sorted_again() -> None:
    """``/a`` comes before ``/map`` and ``/z`` after it."""
    loaded = [package(rule("ALLOW", *TALK, "/map", name)) for name in ("/a", "/z")]
    built, asked = by_kind(*loaded)
    assert asked == 1
    assert built == [by_engine(each) for each in loaded]


def test_the_proof_of_a_renamed_document_is_known() -> None:
    loaded = list(fleet(1, 2))
    by_kind(*loaded)
    document = build_type.build(loaded[1], USUAL).documents["permissions.xml"]
    with mock.patch("keymint_ros2_dds.proving.claims.prove_document", side_effect=AssertionError):
        claims = prove_content(emission.comparison(loaded[1], document))
    assert {claim.proof for claim in claims} == {Proof.PROVEN}


@pytest.mark.parametrize("options", [BuildOptions(optimise=False), BuildOptions(allow_vendor_specific=True)])
def test_other_options_are_for_the_engine(options: BuildOptions) -> None:
    with mock.patch.object(kind_members, "emit", wraps=emission.emit) as engine:
        for each in fleet(1, 2):
            build_type.build(each, options)
    assert engine.call_count == 2


class TestConditions:
    """The second subject violates exactly one condition."""

    @staticmethod
    def renamed(first: Package, second: Package, names: Mapping[str, str]) -> bytes:
        """Return the document that renaming would write for the second subject: DDS names of the first, and its own."""
        rules = kind_members.with_renamed_topics(emission.emit(first, USUAL).rules, names)
        return permissions_document.render(second.grant, rules)

    def refuted(self, first: Package, second: Package, names: Mapping[str, str]) -> bool:
        """Tell whether that document is proven to be wrong."""
        document = self.renamed(first, second, names)
        claims = prove_content(emission.comparison(second, document))
        return Proof.COUNTEREXAMPLE in {claim.proof for claim in claims}

    def check(self, first: Package, second: Package, names: Mapping[str, str] | None = None) -> None:
        (_, built), asked = by_kind(first, second)
        assert asked == 2
        assert built == outcome(by_engine, second)
        assert names is None or self.refuted(first, second, names)

    def test_names_that_a_parser_trims(self) -> None:
        first, second = (package(rule("ALLOW", "topic", "publish", name)) for name in ("a", " a"))
        self.check(first, second, {"a": " a"})

    def test_names_that_fall_together_after_mapping(self) -> None:
        """A raw topic has the name of a ROS topic, in the second subject only."""

        def subject(raw: str) -> Package:
            return package(rule("ALLOW", *TALK, "/x"), rule("DENY", "topic", "publish", raw))

        self.check(subject("rt/y"), subject("rt/x"), {"rt/x": "rt/x", "rt/y": "rt/x"})

    def test_a_name_that_a_wildcard_of_the_policy_matches(self) -> None:
        def subject(name: str) -> Package:
            return package(rule("ALLOW", *TALK, name), rule("DENY", *TALK, "/secret/*"))

        self.check(subject("/a"), subject("/secret/a"), {"rt/a": "rt/secret/a"})

    def test_a_name_in_another_part_of_the_intersection_of_two_wildcards(self) -> None:
        """Both names match both wildcards, whose intersection is several patterns. The compiler writes these."""
        wild = rule("ALLOW", *TALK, "/x*ab*"), rule("DENY", *HEAR, "/*ba*")

        def subject(name: str) -> Package:
            return package(*wild, rule("ALLOW", *HEAR, "/x*"), rule("DENY", *TALK, name))

        self.check(subject("/xabba"), subject("/xbaab"))

    def test_a_wildcard_that_is_wider_than_another_one(self) -> None:
        """In the first subject the denied names are none of the allowed ones."""

        def subject(denied: str) -> Package:
            return package(rule("ALLOW", *TALK, "/a/*"), rule("DENY", *TALK, denied))

        self.check(subject("/b/*"), subject("/a/b/*"), {"rt/a/*": "rt/a/*", "rt/b/*": "rt/a/b/*"})

    def test_wildcards_that_end_alike(self) -> None:
        def subject(denied: str) -> Package:
            return package(rule("ALLOW", *TALK, "/a/*_raw"), rule("DENY", *TALK, denied))

        self.check(subject("/a/*_jpg"), subject("/a/*_my_raw"), {"rt/a/*_raw": "rt/a/*_raw"})

    def test_a_name_that_a_wildcard_of_its_own_matches(self) -> None:
        """In the first subject the denial is without effect."""

        def subject(allowed: str, denied: str) -> Package:
            return package(rule("ALLOW", *TALK, allowed), rule("DENY", *TALK, denied))

        self.check(subject("/a/*", "/b/x"), subject("/c/*", "/c/x"), {"rt/a/*": "rt/c/*"})

    def test_a_name_that_is_too_short_for_a_wildcard(self) -> None:
        """``/cbd`` begins and ends as ``/cb*bd``."""

        def subject(wildcard: str, name: str) -> Package:
            return package(rule("ALLOW", *TALK, wildcard, name))

        self.check(subject("/cb*xd", "/cbxd"), subject("/cb*bd", "/cbd"), {"rt/cb*xd": "rt/cb*bd"})

    def test_a_wildcard_that_matches_no_ros_name_gets_its_warning(self) -> None:
        loaded = [package(rule("ALLOW", *TALK, text)) for text in ("/a*", "/a-*")]
        built, asked = by_kind(*loaded)
        assert asked == 2
        assert [each.code for each in built[1].diagnostics] == ["never-matches"]

    def test_notes_are_about_the_wildcards_of_each(self) -> None:
        """RTI Connext may not match a ``*`` before the end."""
        loaded = [package(rule("ALLOW", *TALK, text)) for text in ("/a*", "/a*_c")]
        built, asked = by_kind(*loaded)
        assert asked == 1
        assert [[each.code for each in result.diagnostics] for result in built] == [[], ["vendor-wildcard"]]

    def test_names_in_other_places(self) -> None:
        """Each place has what the policy of this subject says; with names exchanged the proof fails."""
        first, second = (
            package(rule("ALLOW", *TALK, f"/{robot}/out"), rule("ALLOW", *HEAR, f"/{robot}/in")) for robot in "rs"
        )
        _, asked = by_kind(first, second)
        assert asked == 1
        assert self.refuted(first, second, {"rt/r/out": "rt/s/in", "rt/r/in": "rt/s/out"})

    def test_other_domains(self) -> None:
        first, second = (package(rule("ALLOW", *TALK, "/a"), domains=(DomainRange(0, last),)) for last in (0, 1))
        _, asked = by_kind(first, second)
        assert asked == 2
        document = emission.emit(first, USUAL).document
        claims = prove_content(emission.comparison(second, document))
        assert Proof.COUNTEREXAMPLE in {claim.proof for claim in claims}

    def test_a_validity_that_some_vendor_reads_as_empty(self) -> None:
        """Documents have whole seconds; a year of three digits is no date for any vendor."""
        early = Validity(VALIDITY.not_before.replace(year=999), VALIDITY.not_after)
        first, second = (package(rule("ALLOW", *TALK, "/a"), validity=period) for period in (VALIDITY, early))
        self.check(first, second)
        later = Validity(VALIDITY.not_before + timedelta(days=1), VALIDITY.not_after)
        _, asked = by_kind(package(rule("ALLOW", *TALK, "/b"), validity=later))
        assert asked == 0, "another period alone is no reason"

    @pytest.mark.parametrize(("year", "code"), [(2027, "portability-subject-name"), (2262, "portability-date")])
    def test_a_subject_name_that_some_vendor_does_not_recognise(self, year: int, code: str) -> None:
        """Cyclone DDS compares no name of more than twenty parts. The engine says so, and what else is wrong first."""
        period = Validity(VALIDITY.not_before, VALIDITY.not_after.replace(year=year))
        first = package(rule("ALLOW", *TALK, "/a"))
        second = package(rule("ALLOW", *TALK, "/b"), name="OU=x1,CN=/" + "/".join("a" * 25), validity=period)
        self.check(first, second)
        assert [each.code for each in outcome(by_engine, second)] == [code]

    @pytest.mark.parametrize("head", [{"name": "OU=x1,CN=a&b"}, {"subject": "/a<b", "name": "OU=x1,CN=/b"}])
    def test_a_grant_or_subject_whose_name_is_markup(self, head: dict[str, str]) -> None:
        first, second = package(rule("ALLOW", *TALK, "/a")), package(rule("ALLOW", *TALK, "/b"), **head)
        self.check(first, second)

    def test_a_subject_that_gathering_would_help(self) -> None:
        def subject(*names: str) -> Package:
            return package(*(rule("ALLOW", *TALK, f"/some/longer/namespace/{name}/scan") for name in names))

        words = [f"{number:b}".replace("0", "ab").replace("1", "cde") for number in range(64, 128)]
        self.check(subject(*words), subject(*(f"robot{number:03}" for number in range(64))))

    def test_a_document_of_a_size_to_warn_of(self) -> None:
        def subject(length: int) -> Package:
            letters = "abcdefghijklmnopqrstuvwxyz"
            names = (f"/{letter * length}{other}" for letter in letters for other in (letter * 3, letter * 4))
            return package(rule("ALLOW", *TALK, *names))

        first, second = subject(20), subject(1_000)
        (_, built), asked = by_kind(first, second)
        assert asked == 2
        assert "size-permissions" in {each.code for each in built.diagnostics}

    def test_a_document_of_a_size_that_is_not_indented_is_renamed(self) -> None:
        def subject(length: int) -> Package:
            letters = "abcdefghijklmnopqrstuvwxyz"
            return package(rule("ALLOW", *TALK, *(f"/{letter * (length + ord(letter))}" for letter in letters)))

        loaded = [subject(0), subject(1_300)]
        built, asked = by_kind(*loaded)
        assert asked == 1
        assert b"\n<permissions>" in built[1].documents["permissions.xml"]
        assert built == [by_engine(each) for each in loaded]

    @pytest.mark.parametrize("covered", ["/own/*", "/x"], ids=["names often in the plain form", "as often"])
    def test_sizes_of_members_from_small_to_large(self, covered: str) -> None:
        """The size of the plain form is reckoned from that of the first, while all are indented."""

        def subject(length: int) -> Package:
            names = [f"/own/{letter * (length + ord(letter))}" for letter in "abcdefghijklmno"]
            all_of = rule("ALLOW", *TALK, covered), rule("ALLOW", *TALK, *names), rule("ALLOW", *HEAR, names[0])
            return package(*all_of, rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", "/other", *names[:3]))

        lengths = [300, 0, 1, 150, 250, 500, 900, 1_000, 1_300]
        sizes = set()
        for loaded in ([subject(each) for each in order] for order in (lengths, lengths[::-1])):
            with mock.patch.object(kind_members, "_known", {}):
                built, asked = by_kind(*loaded)
            assert asked == 1
            assert built == [by_engine(each) for each in loaded]
            sizes |= {(*each.plain_sizes.values(), len(each.documents["permissions.xml"])) for each in built}
        assert all(plain > size for plain, size in sizes if plain <= dds_xml.INDENTED // 3)
        assert {max(each) > dds_xml.INDENTED // 3 for each in sizes} == {True, False}

    def test_a_name_that_is_also_an_alternative_for_a_set(self) -> None:
        """``[12]`` is written as two texts. In the first subject one of them is its name, too; nobody can tell."""
        first, second = (package(rule("ALLOW", *TALK, "/x[12]", name)) for name in ("/x1", "/x2"))
        self.check(first, second, {"rt/x1": "rt/x2"})

    def test_names_by_which_rules_are_ordered(self) -> None:
        """With partitions, the order of rules depends on names: the meaning is right, but not the bytes."""

        def subject(name: str) -> Package:
            both = rule("ALLOW", "topic", "publish", name, "m", partitions=("p", "q"))
            own, other = (rule("DENY", "topic", "publish", *denied) for denied in ((name,), ("m",)))
            return package(both, replace(own, partitions=("p",)), replace(other, partitions=("q",)))

        first, second = subject("a"), subject("z")
        self.check(first, second)
        assert not self.refuted(first, second, {"a": "z", "m": "m"})
        assert self.renamed(first, second, {"a": "z", "m": "m"}) != by_engine(second).documents["permissions.xml"]

    @pytest.mark.parametrize(
        "other",
        [
            rule("ALLOW", "topic", "publish", "x", partitions=("p",)),
            rule("ALLOW", *TALK, "/x[12]"),
            rule("ALLOW", *TALK, "/a?", "/?a"),
            rule("ALLOW", *TALK, "?x"),
        ],
        ids=["partitions", "a set", "two wildcards with a name in common", "a wildcard for one name"],
    )
    def test_kinds_that_are_for_the_engine(self, other: Rule) -> None:
        loaded = list(fleet(1, 2, 3, more=[other]))
        built, asked = by_kind(*loaded)
        assert asked == 3
        assert built == [outcome(by_engine, each) for each in loaded]

    def test_a_name_that_is_no_ros_name_gets_its_warning(self) -> None:
        loaded = [package(rule("ALLOW", *TALK, name)) for name in ("/a", "/a-b")]
        built, asked = by_kind(*loaded)
        assert asked == 2
        assert [each.code for each in built[1].diagnostics] == ["never-matches"]


def test_many_kinds_are_forgotten_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kind_members, "MOST", 2)
    for number in range(5):
        build_type.build(package(rule("ALLOW", *TALK, f"/n{number}?", "/a")), USUAL)
    assert len(kind_members._known) == 2


def test_the_parts_of_actions_are_names_of_their_own() -> None:
    (found,) = {len(parts("ros_action", "ros_request"))}
    structure = Structure.of(*kind_of([rule("ALLOW", "ros_action", "ros_request", "/a")]), "jazzy")
    assert structure is not None
    assert len(structure.slots) == found + 3, "three of the parts are services, with two topics each"
