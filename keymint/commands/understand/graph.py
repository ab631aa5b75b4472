# SPDX-License-Identifier: Apache-2.0
"""``keymint graph``: draw a policy, or the graph of a system."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from comarmor.text import quantity
from comarmor.values import replace
from keymint.api import graph_json
from keymint.api.graph import EdgeOutcome, Graph
from keymint.command_line.named_files import deliver, made_of, read_input, source_files
from keymint.command_line.named_policies import Policies, library_rules, workspace_library_rules
from keymint.command_line.options import Number, PolicyOptions, graph_source, policy_options
from keymint.command_line.verb import PATH, Report, Run, argument, flag, option, option_group, path_option, plugin, verb
from keymint.drawing.appearance import Theme
from keymint.drawing.captions import left_out_json, left_out_words
from keymint.drawing.labelled_graph import (
    DrawnPolicy,
    LabelledEdge,
    LabelledGraph,
    LeftOut,
    choose_subjects,
    label_graph,
    policy_graph,
    select_edges,
)
from keymint.drawing.simplify import DrawingOptions, Split, simplify
from keymint.errors import Diagnostic, ExitCode, KeymintError, usage_error
from keymint.workspace.policy_loading import load_policy
from keymint.workspace.session import Session

FORMATS = ("svg", "png", "dot", "html")


@verb(dry_run=True, former={"kind": "-f"})
def graph(
    run: Run,
    source: Path | None = argument(metavar="[POLICY|GRAPH]", required=False, type=PATH),
    output: Path | None = path_option("-o"),
    kind: str | None = option("--format", type=click.Choice(FORMATS)),
    policy: Path | None = path_option(metavar="PATH"),
    everything: bool = flag("--all"),
    named: tuple[str, ...] = option("--subject", multiple=True, metavar="NAME"),
    namespaces: tuple[str, ...] = option("--namespace", multiple=True, metavar="NAME"),
    only: str | None = option(type=click.Choice(["allowed", "denied"])),
    drawing: DrawingOptions = option_group(
        DrawingOptions,
        split=option(
            "--by",
            type=click.Choice([str(split) for split in Split]),
            default="none",
            callback=lambda _context, _parameter, value: Split(value),
        ),
        fold=option("--fold/--no-fold", default=None),
        group=option("--group/--no-group", default=None),
        common=flag(),
        limit=option(type=click.IntRange(1), metavar="N"),
        theme=option(
            type=click.Choice([str(theme) for theme in Theme]),
            default="auto",
            show_default=True,
            callback=lambda _context, _parameter, value: Theme(value),
        ),
    ),
    scale: float = option(type=Number(0.1, 10), metavar="FACTOR", default=2.0, show_default=True),
    title: str | None = option(metavar="TEXT"),
    policy_options: PolicyOptions = policy_options,
    source_type: str | None = plugin("keymint.graph_sources"),
) -> Report:
    """Draw a policy, or the graph of a system, as a picture or a web page.

    Edges connect subjects with the topics, services, actions and parameters that they may use. Arrows show the
    direction of data. POLICY is a ComArmor file or directory [the policy of the workspace]; GRAPH is a file written
    by 'keymint discover', or a capture.

    \b
    keymint graph policy.xml -o policy.svg                     what the policy allows and denies
    keymint graph policy.xml -o policy.html                    the same as a page with search
    keymint graph graph.json --policy policy.xml --all -o g.png   every possible edge, with its label

    Options:
        output: Write to this file; its suffix selects the format.
        kind: Format [from the suffix of FILE, else svg].
        policy: Label the edges of GRAPH by this policy.
        everything: Draw every possible edge, also those that no rule allows.
        named: Draw only this subject; may be repeated.
        namespaces: Draw only subjects at or below this name.
        only: Draw only edges with this label.
        split: Draw one panel for each.
        fold: Draw one of several robots that differ in name only [beyond 30 subjects or 600 lines], and objects with
            the same edges as one [from 40 objects].
        group: Draw the subjects of a namespace as a matrix [where more than 30 subjects or 600 lines remain].
        common: Also draw what every node may do: parameters, logging, time, discovery.
        limit: Draw at most this many edges, and count the others by kind [no limit].
        theme: Colours; auto follows the reader's settings.
        scale: Resolution of a PNG.
        title: Title of the picture.
        source_type: Plugin that reads a capture [the only one that is installed].
    """
    chosen_format = _format(output, kind)
    policies = Policies(run, policy_options)

    def policy_at(path: Path) -> DrawnPolicy:
        loaded = policies.at(run.setting.cwd / path, str(path))
        return DrawnPolicy(loaded, path.resolve().stem, run.typed, library_rules(run.setting.cwd, policies.shipped()))

    session: Session | None = None
    system, diagnostics = _graph(run, source, source_type) if source else (None, ())
    if system is None:
        if policy is not None:
            message = f"{source or 'the policy of the workspace'} is a policy; --policy labels only graphs"
            raise usage_error(message, "leave out --policy")
        if source:
            drawn = policy_at(source)
        else:
            session = run.inputs(run.workspace()).session()
            rules = workspace_library_rules(session)
            drawn = DrawnPolicy(load_policy(session), session.profile.name, run.typed, rules)
        made = made_of(run, drawn.loaded, session)
        below = choose_subjects(drawn.loaded.subjects(), (), namespaces) if namespaces else ()
        labelled = policy_graph(title or drawn.name, drawn, tuple(sorted({*named, *below})), everything=everything)
        if session:  # nobody has a right that no transport of the workspace knows
            kinds = {kind for each in session.build_types.values() for kind in each.KINDS}
            labelled = replace(labelled, edges=tuple(each for each in labelled.edges if each.edge.object.kind in kinds))
    else:
        labelling = policy_at(policy) if policy is not None else None
        made = made_of(run, labelling.loaded if labelling else None, graph=read_input(run, source) if source else b"")
        subjects = choose_subjects(system.subjects, named, namespaces)
        name = Path(source or "").stem + (f", labelled by {labelling.name}" if labelling else "")
        if labelling is not None:
            labelled = label_graph(title or name, labelling, system, subjects, everything=everything)
        elif everything:
            raise usage_error("--all needs labels", "name the policy: --policy PATH")
        else:
            unlabelled = LabelledGraph.of(title or name, map(LabelledEdge, system.edges), system.subjects)
            labelled = select_edges(unlabelled, subjects=subjects)
    if only:
        labelled = select_edges(labelled, only={EdgeOutcome.ALLOW if only == "allowed" else EdgeOutcome.DENY})
    content, left_out, counts = _drawn(run, replace(labelled, made=made), chosen_format, drawing, scale)
    result: dict[str, Any] = {
        **deliver(run, output, content),
        "format": chosen_format,
        "subjects": labelled.subjects,
        "objects": len({each.edge.domain_object for each in labelled.edges}),
        "edges": {outcome: labelled.counts[outcome] for outcome in EdgeOutcome if labelled.counts[outcome]},
        "unnamed": labelled.unnamed,
        **counts,
        "left_out": left_out_json(left_out),
        "content": None if output else content.decode(),
    }
    if left_out and drawing.limit is None:
        message = f"{quantity(sum(left_out.values()), 'edge')} not drawn: {left_out_words(left_out)}"
        help_ = "draw a part (--subject, --namespace), or say how much is enough (--limit)"
        diagnostics = (*diagnostics, Diagnostic.warning("picture-incomplete", message, None, help_))
        return run.report(result, diagnostics, ExitCode.FINDINGS)
    return run.report(result, diagnostics)


def _format(output: Path | None, kind: str | None) -> str:
    suffix = output.suffix.removeprefix(".").lower() if output else ""
    chosen = kind or {"gv": "dot", "htm": "html"}.get(suffix, suffix) or "svg"
    if chosen not in FORMATS:
        raise usage_error(f"{output} has an unknown suffix", f"end it in .{', .'.join(FORMATS)}, or use --format")
    if chosen == "png" and output is None:
        raise usage_error("a PNG cannot be printed", "name a file: -o FILE.png")
    return chosen


def _graph(run: Run, source: Path, source_type: str | None) -> tuple[Graph | None, tuple[Diagnostic, ...]]:
    """Return the graph in a file, or None if the file must be a policy."""
    if (run.setting.cwd / source).is_dir():
        return None, ()
    content = read_input(run, source)
    if graph_json.recognises(content):
        return graph_json.load(content, str(source)), ()
    reader = graph_source(run.plugins, source_type, "--source-type")
    if not reader.recognises(content):
        return None, ()
    try:
        capture = reader.read(content, str(source), {})
    except KeymintError:
        return None, ()  # both are XML: a file that is not a capture is read as a policy, which reports its defects
    return reader.interpret(capture.graph, fold=True), capture.diagnostics


def _drawn(
    run: Run, labelled: LabelledGraph, kind: str, options: DrawingOptions, scale: float
) -> tuple[bytes, Mapping[LeftOut, int], Mapping[str, Any]]:
    """Return a picture, how many edges are not in it, and how the others are."""
    # Templates are slow to import, and no other verb needs them.
    from keymint.drawing.html_report import html_report, listed_edges  # noqa: PLC0415
    from keymint.drawing.other_formats import dot_document, dot_simplified, png  # noqa: PLC0415
    from keymint.drawing.svg import draw  # noqa: PLC0415

    if kind == "html":
        left_out = labelled.left_out(listed_edges(labelled))
        counts = {"drawn": labelled.total - sum(left_out.values()), "folded": 0, "alike": []}
        return html_report(labelled, source_files(run, labelled), options), left_out, counts
    drawn = dot_simplified(labelled, options) if kind == "dot" else simplify(labelled, options)
    alike = [{"like": each.like, "names": each.names} for each in drawn.fold.classes]
    counts = {"drawn": len(drawn.stands), "folded": drawn.folded, "alike": alike}
    document = dot_document(drawn) if kind == "dot" else draw(drawn).encode()
    return png(document, scale) if kind == "png" else document, drawn.left_out, counts
