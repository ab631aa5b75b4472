# SPDX-License-Identifier: Apache-2.0
"""``keymint discover``: record the graph of a running system, or read captures of one."""

from __future__ import annotations

import json
import signal
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import reduce
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import click

from comarmor.values import replace
from keymint.api import DiscoveredGraph, GraphSource, graph_json
from keymint.api.graph import NAMES_DIFFER, Graph, differing_names
from keymint.command_line.named_files import deliver, read_input, user_path
from keymint.command_line.options import Number, graph_source
from keymint.command_line.verb import Report, Run, flag, option, path_option, plugin, verb
from keymint.errors import Diagnostic, ExitCode, KeymintError, Origin, usage_error
from keymint.names import typed_subject

_EXIT_CODES = {signal.SIGINT: ExitCode.INTERRUPTED, signal.SIGTERM: ExitCode.TERMINATED}


@verb(workspace=False, dry_run=True)
def discover(
    run: Run,
    domain: int | None = option(type=click.IntRange(0, 232), metavar="N"),
    seconds: float = option(
        type=Number(min=0, min_open=True, max=86_400), default=10.0, show_default=True, metavar="S"
    ),
    captures: tuple[Path, ...] = path_option("--from", multiple=True),
    append: Path | None = path_option(metavar="GRAPH"),
    output: Path | None = path_option("-o"),
    no_fold: bool = flag(),
    subjects: tuple[str, ...] = option("--subject", multiple=True, metavar="ID=NAME"),
    source_name: str | None = plugin("keymint.graph_sources", "--source"),
) -> Report:
    """Record the graph of a running system: the topics, services, actions and parameters that each subject uses.

    Observes the nodes of a domain, or reads captures. Short-lived clients may be missed: observe longer, or again with
    --append. Ctrl-C stops early and keeps the result (exit code 130). docs/graph.md describes the JSON.

    \b
    keymint discover --seconds 30 -o graph.json      while the application runs, without security
    keymint learn graph.json -o policy.xml
    keymint provision policy.xml -w ws

    Options:
        domain: Domain id [$ROS_DOMAIN_ID, else 0].
        seconds: How long to observe. Endpoints that disappear meanwhile count too.
        captures: Read a Keymint graph, or a capture that the source knows, instead (docs/graph.md). May be repeated.
        append: Add to this graph, which is created if missing. Without -o the result is written there.
        output: Write the graph to this file [standard output].
        no_fold: Keep the services and topics of actions and parameters separate.
        subjects: Name the subject whose identifier begins with ID; -v shows identifiers. May be repeated.
        source_name: Plugin that observes and reads graphs [the only one that is installed].
    """
    source = graph_source(run.plugins, source_name, "--source")
    names = _names(subjects)
    if captures and domain is not None:
        raise usage_error("--domain cannot be combined with --from", "a capture contains its domain")
    graphs = [_load(run, source, append, {})] if append and user_path(run, append).exists() else []
    interrupted: ExitCode | None = None
    if captures:
        graphs += [_load(run, source, capture, names) for capture in captures]
    else:
        observed, interrupted = _observe(run, source, domain, seconds, names)
        graphs.append(observed)
    merged = reduce(graph_json.merge, (each.graph for each in graphs), Graph(subjects=(), edges=()))
    graph = source.interpret(merged, fold=not no_fold)
    content = graph_json.dump(graph)
    target = output or append
    if target:
        counts = Counter(object_.kind for _, object_ in graph.objects)
        kinds = ", ".join(f"{counts[kind]} {kind}" for kind in sorted(counts)) or "none"
        run.console.line(f"{len(graph.subjects)} subjects, {len(graph.edges)} edges, objects: {kinds}")
    delivered = deliver(run, target, content)
    result: dict[str, Any] = {
        "subjects": graph.subjects,
        "objects": len(graph.objects),
        "edges": len(graph.edges),
        **delivered,
        "graph": None if target else json.loads(content),
    }
    records = pairwise(source.interpret(each.graph, fold=not no_fold) for each in graphs)
    differ = (note for one, other in records for note in differing_names(one, other))
    diagnostics = tuple(dict.fromkeys((*(said for each in graphs for said in each.diagnostics), *differ)))
    return run.report(result, diagnostics, interrupted or ExitCode.DONE, notes={NAMES_DIFFER})


def _names(typed: Iterable[str]) -> dict[str, str]:
    names: dict[str, str] = {}
    for item in typed:
        identifier, equals, name = item.partition("=")
        if not equals:
            raise usage_error(f"--subject {item!r} is not ID=NAME", "e.g. --subject 0110d9a4=/talker")
        names[identifier] = typed_subject(name)
    return names


def _load(run: Run, source: GraphSource, path: Path, names: dict[str, str]) -> DiscoveredGraph:
    content = read_input(run, path)
    if graph_json.recognises(content):
        return DiscoveredGraph(graph_json.load(content, str(path)))
    if source.recognises(content):
        return source.read(content, str(path), names)
    message = "is neither a graph nor a known capture format"
    help_ = f"expected JSON as in docs/graph.md, or {source.CAPTURES}"
    raise KeymintError(message, where=Origin(str(path)), help=help_, code="capture")


def _observe(
    run: Run, source: GraphSource, domain: int | None, seconds: float, names: dict[str, str]
) -> tuple[DiscoveredGraph, ExitCode | None]:
    """Return the graph of a running system, and the exit code of a signal that stopped the observation early."""
    usable = source.usable()
    if not usable.usable:
        raise KeymintError(
            f"no running system can be observed: {usable.reason}", help=usable.help, code="discovery-unusable"
        )
    if domain is None:
        text = run.setting.environment.get("ROS_DOMAIN_ID", "").strip() or "0"
        if not text.isdecimal() or int(text) > graph_json.MAX_DOMAIN:
            message = f"ROS_DOMAIN_ID is {text!r}, expected a domain id from 0 to {graph_json.MAX_DOMAIN}"
            raise usage_error(message, "set it, or use --domain")
        domain = int(text)
    start = run.setting.monotonic()
    with ended_by_signals() as ended:
        observed = source.observe(domain, lambda: not ended and run.setting.monotonic() < start + seconds, names)
    if ended:
        message = f"interrupted after {run.setting.monotonic() - start:.0f} of {seconds:g} s: the graph is incomplete"
        help_ = "--append GRAPH observes again and adds to the graph"
        early = Diagnostic.warning("discovery-interrupted", message, help=help_)
        return replace(observed, diagnostics=(*observed.diagnostics, early)), ended[0]
    return observed, None


@contextmanager
def ended_by_signals() -> Iterator[Sequence[ExitCode]]:
    """Yield what gets the exit code of the first SIGINT or SIGTERM within the block; a second has its usual effect."""
    ended: list[ExitCode] = []
    if threading.current_thread() is not threading.main_thread():  # only the main thread can set handlers
        yield ended
        return
    before = {number: signal.getsignal(number) for number in _EXIT_CODES}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def note(number: int, _frame: FrameType | None) -> None:
        ended.append(_EXIT_CODES[signal.Signals(number)])
        restore()

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:  # nohup and background jobs of shells ignore it
            signal.signal(number, note)
    try:
        yield ended
    finally:
        restore()
