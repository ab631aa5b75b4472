# SPDX-License-Identifier: Apache-2.0
"""``keymint query``: answer questions about a policy, for all names and subjects."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import islice, product
from pathlib import Path
from typing import Any

from comarmor.patterns.decision_lists import Equal
from comarmor.patterns.glob import Glob, literal, matches, parse
from comarmor.patterns.tokens import PatternError
from comarmor.rules import PERMISSIONS, Effect, of_raw_topic
from comarmor.text import did_you_mean, first_few, nearest_word, quantity
from comarmor.values import Data, replace
from keymint.analysis.channels import Channel, ChannelSearch
from keymint.analysis.query import FORMS, HEADS, PermissionHolder, who_can
from keymint.analysis.rule_lists import allow_only, display_name, find_permitted, query_pattern
from keymint.analysis.subject_patterns import representatives, rules_of, unknown_subject, with_distinct_rules
from keymint.api import LoadedPolicy
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import PolicyOptions, kind_option, policy_options, raw_topic_doubt
from keymint.command_line.verb import Report, Run, argument, findings_if, flag, option, verb
from keymint.errors import Diagnostic, usage_error
from keymint.names import RAW, typed_permission, typed_subject
from keymint.output.audit_rights import holder_json, subject_rights
from keymint.output.report import members

_OPTIONAL = "[ever]"
_MOST = 20
_Answer = tuple[str, dict[str, Any]]
"""``yes``, ``no`` or ``unknown``, and further results."""


class _Question(Data):
    """A parsed query.

    Attributes:
        head: ``who``, ``what``, ``can``, ``flows`` or ``isolated``.
        subjects: expressions of subjects.
        kind: kind of the object; empty without an object.
        permission: a permission of that kind.
        object: expression of the object.
        partition: expression of the partition of a raw topic.
    """

    head: str
    subjects: tuple[str, ...]
    kind: str = ""
    permission: str = ""
    object: str = ""
    partition: str = ""

    @property
    def names(self) -> Glob:
        """Pattern of the words of the object."""
        return query_pattern(self.kind, self.object, self.partition)


def _parse(words: Sequence[str], kind: str, partition: str) -> _Question:
    """Parse the words of a query.

    Args:
        words: the words.
        kind: kind of the object; empty if it follows from the words.
        partition: expression of the partition of a raw topic.

    Raises:
        KeymintError: the query has none of the forms.
    """
    head, rest = (words[0], list(words[1:])) if words else ("", [])
    if head not in HEADS:
        hint = did_you_mean(head, HEADS, f"queries are: {'; '.join(FORMS)}")
        raise usage_error(f"no query starts with {head!r}" if head else "the query is empty", hint, "question")
    form = next(form for form in FORMS if form.startswith(head))
    expected = [word for word in form.split()[1:] if word != _OPTIONAL]
    if _OPTIONAL in form and rest[1:2] == [_OPTIONAL.strip("[]")]:
        del rest[1]
    for at, word in enumerate(expected):
        if word.islower() and rest[at : at + 1] != [word]:
            found = f", not {rest[at]!r}" if at < len(rest) else ""
            raise usage_error(f"expected {word!r}{found}", f"write '{form}'", "question")
    if len(rest) != len(expected):
        number = "few" if len(rest) < len(expected) else "many"
        raise usage_error(f"the query has too {number} words", f"write '{form}'", "question")
    subjects = tuple(
        legal_expression(typed_subject(text)) for text, word in zip(rest, expected, strict=True) if word == "SUBJECT"
    )
    if "OBJECT" not in expected:
        return _Question(head, subjects)
    *_, permission, name = rest
    return _Question(head, subjects, *typed_permission(permission, name, kind), legal_expression(name), partition)


def legal_expression(text: str) -> str:
    """Return an expression of subjects or objects that is right.

    Raises:
        KeymintError: it has an error.
    """
    try:
        parse(text)
    except PatternError as error:
        diagnostic = error.diagnostics[0]
        raise usage_error(f"{text!r}: {diagnostic.message}", diagnostic.help, "question") from None
    return text


@verb()
def query(
    run: Run,
    words: tuple[str, ...] = argument(nargs=-1, metavar="[POLICY] QUESTION..."),
    but: tuple[str, ...] = option("--except", multiple=True, metavar="OBJECT"),
    infrastructure: bool = flag(),
    kind: str | None = kind_option,
    partition: str = option(default="", metavar="NAME"),
    policy_options: PolicyOptions = policy_options,
) -> Report:
    """Ask a policy a question. SUBJECT and OBJECT may be patterns; the prefix 'ros_' of permissions is optional.

    \b
    keymint query who can publish /safety/estop
    keymint query what can /amr1/nav do
    keymint query can '/amr*/nav' ever subscribe '/amr2/*'
    keymint query flows /amr1/camera /cloud/uplink
    keymint query isolated '/amr1/*' '/amr2/*' --except '/fleet/*'

    POLICY is a ComArmor file or directory, or a workspace [the current workspace]. The answer 'no' is proven for all
    names and subjects, including subjects that the policy does not name. 'flows' searches paths through the subjects
    that the policy names; 'isolated' searches direct channels. Both list channels that the shipped common/node.xml
    allows every node, such as ros_discovery_info, separately; they count only with --infrastructure.

    Exit code 3: subjects are not isolated, or the answer is unknown.

    Options:
        but: flows, isolated: ignore these objects.
        infrastructure: flows, isolated: also count what the library allows every node.
        partition: Partition of a raw topic [the default one].
    """
    path, question = _read(words, run.setting.cwd, kind or "", partition)
    about_flows = question.head in ("flows", "isolated")
    if (but or infrastructure) and not about_flows:
        message = f"'{question.head}' takes no {'--except' if but else '--infrastructure'}"
        raise usage_error(message, "use it with 'flows' or 'isolated'")
    for expression in but:
        legal_expression(expression)
    policies = Policies(run, policy_options)
    policy = policies.load(path)
    if about_flows:
        channels = ChannelSearch(policy, but, (lambda _: False) if infrastructure else policies.common(path))
        one, other = (representatives(policy, parse(each)) for each in question.subjects)
        verdict, more = (_flows if question.head == "flows" else _isolated)(run, channels, question, one, other)
    else:
        verdict, more = (_what if question.head == "what" else _permitted)(run, policy, question)
    warnings = list(_doubts(policy, question, verdict, typed=kind is not None))
    if verdict == "unknown":
        warnings.append(Diagnostic.warning("query-unknown", "the answer is unknown"))
    failed = verdict == "unknown" or (question.head == "isolated" and verdict == "no")
    result = {"question": question.head, "answer": verdict, **more}
    return run.report(result, warnings, findings_if(failed))


def _doubts(policy: LoadedPolicy, question: _Question, verdict: str, *, typed: bool) -> Iterator[Diagnostic]:
    """Yield warnings about likely mistakes in a question."""
    for subject in question.subjects if question.head != "what" else ():
        if problem := unknown_subject(policy, parse(subject)):
            yield Diagnostic.warning("query-subject", problem)
    name, kind = question.object, question.kind
    if not name:
        return
    if isinstance(find_permitted(kind, allow_only(question.names)), Equal):
        help_ = "segments are letters, digits and '_', do not begin with a digit, and none is empty"
        yield Diagnostic.warning("query-object", f"no {kind} can have a name like {name!r}", help=help_)
    elif verdict == "no":
        yield from raw_topic_doubt(kind, name, typed=typed) or _unwritten(policy, kind, name)


def _unwritten(policy: LoadedPolicy, kind: str, name: str) -> Iterator[Diagnostic]:
    """Yield a warning about a name that no rule has, if a rule has a similar one, or has it for another kind."""
    kinds: dict[str, set[str]] = defaultdict(set)
    denied: set[str] = set()
    for _, rules in with_distinct_rules((each, rules_of(policy, each)) for each in policy.subjects()):
        for rule in rules:
            kinds[rule.kind].update(rule.expressions)
            denied.update(rule.expressions if rule.effect is Effect.DENY else ())
    if name in kinds[kind] or any(matches(parse(each), name) for each in denied):
        return
    other = next((each for each in PERMISSIONS if name in kinds[each]), "")
    near = nearest_word(name, kinds[kind], 0.8)
    if other:
        help_ = f"its permissions are {' and '.join(PERMISSIONS[other])}"
        yield Diagnostic.warning("query-object", f"in the policy, {name!r} is the name of a {other}", help=help_)
    elif near:
        yield Diagnostic.warning("query-object", f"no rule is about {name!r}", help=f"did you mean {near!r}?")


def _read(words: Sequence[str], folder: Path, kind: str, partition: str) -> tuple[Path | None, _Question]:
    """Return the path of the policy, if one is named, and the question, which may be one or several arguments."""
    path: Path | None = None
    rest = list(words)
    if rest and rest[0].split(" ")[0] not in HEADS and (len(rest) > 1 or (folder / rest[0]).exists()):
        path = Path(rest.pop(0))
    if not rest:
        raise usage_error("the question is missing", f"ask one of: {'; '.join(FORMS)}")
    return path, _parse([each for one in rest for each in one.split()], kind, partition)


def _permitted(run: Run, policy: LoadedPolicy, question: _Question) -> _Answer:
    """Return who has the permission that a question is about, of the subjects that it names, else of all.

    Who has a permission on a raw topic may have it by that on the ROS name that maps to it.
    """
    subjects = parse(next(iter(question.subjects), "*"))
    asked = [question]
    if question.kind == RAW and not question.partition and (ros := of_raw_topic(question.permission, question.object)):
        asked.append(replace(question, kind=ros[0], permission=ros[1], object=ros[2]))
    holders = [
        (holder, each) for each in asked for holder in who_can(policy, subjects, each.kind, each.permission, each.names)
    ]
    certain = next((each for each in holders if not each[0].unknown), None)
    verdict = "yes" if certain else "unknown" if holders else "no"
    if question.head == "who":
        run.console.lines(_holder(run, *each) for each in holders)
        if not holders:
            run.console.line(f"nobody: no subject can {question.permission} {question.object}, whatever its name")
        return verdict, {"holders": [_as_data(*each) for each in holders]}
    shown = certain or next(iter(holders), None)
    if shown:
        run.console.line(f"{'yes' if certain else 'not known'}: {_holder(run, *shown)}")
    else:
        run.console.line(f"no: {question.subjects[0]} can never {question.permission} {question.object}")
    return verdict, {"witness": _as_data(*shown) if shown else None}


def _holder(run: Run, holder: PermissionHolder, question: _Question) -> str:
    """Return the holder of a permission, with the name and the rule."""
    like = f" (like {holder.like})" if holder.like and holder.like != holder.subject else ""
    if holder.unknown:
        return f"perhaps {holder.subject or f'subjects like {holder.like}'}: {holder.unknown}"
    name = display_name(question.kind, holder.word)
    return f"{holder.subject}{like} {question.permission} {name} ({run.place(holder.where)})"


def _as_data(holder: PermissionHolder, question: _Question) -> dict[str, Any]:
    return holder_json(holder, question.kind, question.permission)


def _what(run: Run, policy: LoadedPolicy, question: _Question) -> _Answer:
    (asked,) = question.subjects
    subjects = representatives(policy, parse(asked))
    abilities: list[dict[str, Any]] = []
    shown: list[dict[str, Any]] = []
    for rule, ability in subject_rights(policy, subjects):
        abilities.append(ability)
        objects = ability["expression"] + "".join(f" in partition {one!r}" for one in rule.partitions)
        objects += f" but {', '.join(ability['except'])}" if ability["except"] else ""
        objects += "  AUDIT" if rule.audit else ""
        shown.append(ability | {"objects": objects, "place": run.place(rule.origin)})
    if shown:
        columns = {"SUBJECT": "subject"} if len(subjects) > 1 else {}
        run.console.table(columns | {"PERMISSION": "permission", "OBJECTS": "objects", "RULE": "place"}, shown)
    elif not subjects:
        run.console.line(f"no profile of the policy applies to any subject that {asked} matches")
    elif literal(parse(asked)) is None:
        run.console.line(f"unknown: no rule allows {first_few(subjects)} anything, but others like {asked} may")
        return "unknown", {"subjects": subjects, "abilities": ()}
    else:
        applies = any(policy.rules(subject) is not None for subject in subjects)
        hint = did_you_mean(asked, policy.subjects())
        none = f"no profile of the policy applies to it{f'; {hint}' if hint else ''}"
        run.console.line(f"{asked} can do nothing: {'no rule allows it anything' if applies else none}")
    return "yes" if abilities else "no", {"subjects": subjects, "abilities": abilities}


def _flows(
    run: Run, channels: ChannelSearch, question: _Question, sources: Sequence[str], targets: Sequence[str]
) -> _Answer:
    one, other = question.subjects
    for expression, found in ((one, sources), (other, targets)):
        if not found:
            run.console.line(f"no profile of the policy applies to any subject that {expression} matches")
    path = channels.path(sources, targets) if sources and targets else None
    if path is None and question.subjects != (*sources, *targets):
        possible = channels.possible(parse(one), parse(other))
        if perhaps := [*islice(possible, 1)] or channels.path([one, *sources], [other, *targets]):
            run.console.line(f"unknown: no flow between named subjects, but others of {one} and {other} may have one")
            run.console.lines(f"  perhaps: {_step(step)}" for step in perhaps)
            return "unknown", {"path": None, "perhaps": _as_members(perhaps), "infrastructure": []}
    if path is None:
        apart = channels.infrastructure(product(sources, targets))
        run.console.line(f"no: nothing flows from {one} to {other}{_but_for(channels, apart)}")
        return "no", {"path": None, "infrastructure": _as_members(apart)}
    run.console.line(f"yes: in {quantity(len(path), 'step')}")
    run.console.lines(f"  {_step(step)}" for step in path)
    verdict = "yes" if all(step.word for step in path) else "unknown"
    return verdict, {"path": _as_members(path), "infrastructure": []}


def _isolated(
    run: Run, channels: ChannelSearch, question: _Question, writers: Sequence[str], readers: Sequence[str]
) -> _Answer:
    one, other = question.subjects
    pairs = [*product(writers, readers), *product(readers, writers)]
    between = (channel for one, two in pairs if one != two for channel in channels.between(one, two))
    certain = [channel for channel in between if channel.word]
    together: dict[tuple[str, str], list[Channel]] = {}
    for channel in certain:
        together.setdefault((channel.kind, channel.word), []).append(channel)
    perhaps: list[Channel] = []
    for way in ((one, other), (other, one)):
        # Each is listed once, by its name and permissions.
        unnamed = {(each.kind, each.permissions, each.word): each for each in channels.possible(*map(parse, way))}
        perhaps += (each for each in unnamed.values() if (each.kind, each.word) not in together)
    common = channels.infrastructure(pairs)
    for shared in list(together.values())[:_MOST]:
        more = len(shared) - 1
        also = f" (and {quantity(more, 'other pair')})" if more else ""
        run.console.line(f"{_step(shared[0])}{also}")
    if len(together) > _MOST:
        run.console.line(f"… and {len(together) - _MOST} other channels")
    run.console.lines(f"perhaps: {_step(channel)}" for channel in perhaps[:_MOST])
    verdict = "no" if certain else "unknown" if perhaps else "yes"
    apart = f"{one} and {other}"
    run.console.line(
        {
            "yes": f"isolated: nothing flows between {apart}{_but_for(channels, common)}",
            "no": f"not isolated: {quantity(len(together), 'channel')} between {apart}",
            "unknown": f"unknown: no channel between named subjects, but others of {apart} may have one",
        }[verdict]
    )
    if verdict != "yes" and common:
        run.console.line(f"also, by infrastructure: {_names(common)}")
    return verdict, {
        "channels": _as_members(certain),
        "perhaps": _as_members(perhaps),
        "infrastructure": _as_members(common),
    }


def _but_for(channels: ChannelSearch, infrastructure: Sequence[Channel]) -> str:
    """Return what an answer ignores."""
    left = [*channels.but]
    if infrastructure:
        left.append(f"what the library allows every node ({_names(infrastructure)})")
    return f", except {', '.join(left)}" if left else ""


def _names(infrastructure: Sequence[Channel]) -> str:
    return ", ".join(dict.fromkeys(each.object for each in infrastructure))


def _step(channel: Channel) -> str:
    writing, reading = channel.permissions
    name = channel.object or "an unknown name"
    return f"{channel.writer} → {channel.reader} by {channel.kind} {name} ({writing}, {reading})"


def _as_members(channels: Sequence[Channel]) -> list[dict[str, Any]]:
    return [members(each, "writer", "reader", "kind", "permissions", "object") for each in channels]
