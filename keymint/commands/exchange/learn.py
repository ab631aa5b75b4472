# SPDX-License-Identifier: Apache-2.0
"""``keymint learn``: generate the smallest policy that allows a graph."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

from comarmor.text import quantity
from comarmor.values import replace
from comarmor.xml.reader import looks_like_xml
from keymint.api import GrantedRules, LearnedPolicy, LoadedPolicy, graph_json
from keymint.api.graph import NAMES_DIFFER, Graph, differing_names
from keymint.command_line.named_files import deliver, read_input, replacement_refusal, told_written, write_outputs
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import PolicyOptions, force_option, policy_options
from keymint.command_line.verb import PATH, Report, Run, argument, findings_if, path_option, verb
from keymint.errors import Diagnostic, KeymintError, Origin, usage_error
from keymint.output.json import edge_json
from keymint.stages.proof_results import ProofEffort
from keymint.workspace.policy_loading import foreign_policy


@verb(workspace=False, dry_run=True)
def learn(
    run: Run,
    graphs: tuple[Path, ...] = argument(type=PATH, nargs=-1, metavar="[GRAPH]..."),
    keystore: Path | None = path_option("--from-keystore", metavar="KEYSTORE"),
    policy: Path | None = path_option(metavar="EXISTING"),
    output: Path | None = path_option("-o"),
    force: bool = force_option,
    policy_options: PolicyOptions = policy_options,
) -> Report:
    """Generate the smallest policy that allows the edges of GRAPH, like aa-genprof for robots.

    \b
    keymint learn graph.json -o policy.xml
    keymint learn --from-keystore demo_keystore -o policy.xml

    GRAPH is JSON written by 'keymint discover'. Review the result: it allows everything that the system did during the
    observation, even by an attacker, and nothing that it did not do. Of several graphs, e.g. one of each start of the
    system, the policy allows all edges; names that may change with each start are noted.

    With --policy the result contains only what EXISTING lacks; put both into one directory. Permissions of EXISTING
    that the graph does not use are listed.

    With --from-keystore the policy means what the signed documents of KEYSTORE mean, proven for all names; what no
    policy can say is an error with its line. See 'keymint adopt'.

    Exit code 3: a DENY rule of EXISTING denies an edge of the graph.

    Options:
        keystore: Learn from the signed documents of a keystore in place of a graph.
        policy: Keep this policy; generate only what it lacks.
        output: Write the policy to this file [standard output].
    """
    if keystore is not None:
        if graphs or policy is not None:
            help_ = "learn from one of them at a time, and compare the results: keymint diff ONE OTHER"
            raise usage_error("--from-keystore takes neither a graph nor --policy", help_)
        return _from_keystore(run, keystore, output, policy_options, force=force)
    if not graphs:
        raise usage_error(
            "the argument GRAPH is missing", "name a file of 'keymint discover', or a keystore: --from-keystore"
        )
    policies = Policies(run, policy_options)
    learner = run.plugins.policy_type(policy_options.policy_type)
    if policy_options.distro:
        policies.shipped()  # an unknown distribution is an error even without --policy
    records = [_record(run, graph) for graph in graphs]
    wanted = reduce(graph_json.merge, records)
    existing = policies.at(run.setting.cwd / policy, str(policy), foreign=False) if policy else None
    if output and existing:
        _refuse_overwriting(run, output, existing)
    folder = f"{output.stem}.d" if output else ""
    learned = learner.learn(wanted, existing, folder)
    if learned is None:
        raise KeymintError(f"the policy type {policy_options.policy_type!r} cannot learn", code="learn-unsupported")
    learned = replace(learned, unused=tuple(run.as_typed(rule) for rule in learned.unused))
    written: list[str] = []
    if output and learned.document:
        fragments = {f"{folder}/{name}": content for name, content in learned.fragments.items()}
        written = write_outputs(run, output, learned.document, fragments, keep=None if force else _kept(output))
    _tell(run, learned, output, written, against=policy is not None)
    domains = sorted({edge.domain for edge in wanted.edges})
    result: dict[str, Any] = {
        "domains": domains,
        "file": str(output) if output and learned.document else None,
        "written": written,
        "policy": None if output else learned.document.decode(),
        "missing": [*map(edge_json, learned.missing)],
        "unused": [
            {"code": rule.code, "place": str(rule.where or ""), "message": rule.message} for rule in learned.unused
        ],
    }
    several = f"the graph has domains {', '.join(map(str, domains))}; the policy allows every edge in each"
    apart = "run discover and learn for each, with one workspace each"
    about = _about_domains([(each,) for each in domains], "the graph was recorded in", several, apart, output)
    differ = (note for pair in pairwise(records) for note in differing_names(*pair))
    diagnostics = (*learned.conflicts, *learned.unused, *about, *learned.notes, *differ)
    return run.report(result, diagnostics, findings_if(learned.conflicts), notes={"learn-generated", NAMES_DIFFER})


def _record(run: Run, path: Path) -> Graph:
    """Return the graph of a file.

    Raises:
        KeymintError: it cannot be read, or is none; with its line.
    """
    content = read_input(run, path)
    if looks_like_xml(content) and (foreign := foreign_policy(run.plugins, [run.setting.cwd / path])):
        raise foreign.refusal(str(path))
    return graph_json.load(content, str(path))


def _kept(output: Path | None) -> KeymintError:
    """Return the error for a file that has other content than the learned policy."""
    other = "name another file, compare it with the graph by --policy"
    return replacement_refusal(output, "learned", other, "learn-exists")


def _about_domains(
    domains: Sequence[tuple[int, ...]], one: str, several: str, apart: str, output: Path | None
) -> Iterator[Diagnostic]:
    """Yield a warning unless all is of domain 0: a policy contains no domain.

    Args:
        domains: the different domains that something is of.
        one: where the domains stand, if there are no others; they follow in words.
        several: what is said of others.
        apart: what keeps them separate.
        output: file of the policy.
    """
    if not domains or domains == [(0,)]:
        return
    message, help_ = several, f"to keep the domains separate, {apart}"
    if len(domains) == 1:
        message = f"{one} {_in_words(domains[0])}; policies contain no domain"
        help_ = f"keymint provision {output or 'POLICY'} --domain {domains[0][0]}"
    yield Diagnostic.warning("learn-domain", message, Origin(str(output)) if output else None, help_)


def _refuse_overwriting(run: Run, output: Path, existing: LoadedPolicy) -> None:
    """Refuse to overwrite a file of the existing policy."""
    target = (run.setting.cwd / output).resolve()
    if target.exists() and target in {path.resolve() for path in existing.seen}:
        message = "is part of the existing policy"
        help_ = "name another file in the same directory"
        raise KeymintError(message, where=Origin(str(output)), help=help_, code="learn-overwrites")


def _tell(run: Run, learned: LearnedPolicy, output: Path | None, written: list[str], *, against: bool) -> None:
    if not output:
        run.console.document(learned.document)
        return
    if against:
        run.console.lines(f"missing  {each.subject} {each.permission} {each.object.name}" for each in learned.missing)
        run.console.lines(f"unused   {rule.where or rule.subject}: {rule.message}" for rule in learned.unused)
    if learned.document:
        run.console.lines(told_written(run, output, written))
    else:
        run.console.line("the existing policy allows the graph: nothing to write")


def _from_keystore(
    run: Run, keystore: Path, output: Path | None, policy_options: PolicyOptions, *, force: bool
) -> Report:
    """Learn a policy from the signed documents of a keystore, prove it, and write it.

    Args:
        run: the run.
        keystore: folder of the keystore.
        output: the file to write; None for standard output.
        policy_options: the options of the policy to write.
        force: replace a file with different content.

    Raises:
        KeymintError: a signature does not verify, no policy can say what a document grants, or the proof fails; with
            its place.
    """
    from keymint.adoption.keystore_files import found_in  # noqa: PLC0415
    from keymint.adoption.keystore_policy import Learning, learned_from  # noqa: PLC0415 - graphs need none of it
    from keymint.examine.adopted_documents import unclear_rights  # noqa: PLC0415

    policies = Policies(run, policy_options)
    policies.shipped()  # an unknown distribution is wrong usage, whatever the keystore is
    _, reader, files, found = found_in(run.plugins, run.setting.cwd / keystore, str(keystore), run.setting.now)
    effort = ProofEffort(run.setting.monotonic)
    name = str(output or "policy.xml")
    learning = Learning(reader, policy_options.policy_type, policies.distro, name, effort)
    document, granted, warnings = learned_from(run.plugins, files, found, learning, unclear_rights(found))
    delivered = deliver(run, output, document, keep=None if force else _kept(output))
    if output is not None:
        subjects = quantity(len(granted), "subject")
        run.console.line(f"{subjects}: proven to allow, for all names, what the signed documents permit")
    result: dict[str, Any] = {
        "domains": sorted({domain for each in granted for domain in _signed_domains(each)}),
        **delivered,
        "policy": None if output else document.decode(),
        "missing": [],
        "unused": [],
    }
    groups: dict[tuple[int, ...], str] = {}
    for each in granted:
        if domains := tuple(_signed_domains(each)):
            groups.setdefault(domains, each.rules.subject)
    shown = "; ".join(f"{_in_words(domains)} ({subject})" for domains, subject in groups.items())
    several = f"the documents are for different domains: {shown}; the policy allows all in each"
    apart = "have one keystore and one workspace for each"
    return run.report(result, (*warnings, *_about_domains([*groups], "the documents are for", several, apart, output)))


def _signed_domains(granted: GrantedRules) -> Iterator[int]:
    for each in granted.domains:
        yield from range(each.first, each.last + 1)


def _in_words(domains: Sequence[int]) -> str:
    if len(domains) == 1:
        return f"domain {domains[0]}"
    return f"{len(domains)} domains, {domains[0]} to {domains[-1]}"
