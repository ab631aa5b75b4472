# SPDX-License-Identifier: Apache-2.0
"""``keymint import``: policies of other tools in the language of Keymint, proven to mean the same."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from comarmor.text import first_few, quantity
from comarmor.xml.reader import looks_like_xml, parse
from keymint import api
from keymint.command_line.named_files import deliver, read_input, replacement_refusal, user_path
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import PolicyOptions, distro_option, force_option, library_option
from keymint.command_line.verb import FILE, Report, Run, argument, flag, option, path_option, verb
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.examine.nodes import node_notes
from keymint.stages.proof_results import ProofEffort, in_words
from keymint.workspace.policy_loading import foreign_policy


@verb(workspace=False, dry_run=True, name="import", former={"as_written": "--accept"})
def import_policy(
    run: Run,
    policy: Path = argument(type=FILE),
    output: Path = path_option("-o", metavar="DIR", default="comarmor.d", show_default=True),
    as_written: bool = flag(),
    implicit: bool = option("--implicit/--no-implicit", default=True, show_default=True),
    force: bool = force_option,
    distro: str | None = distro_option,
    profile_type: str = library_option,
) -> Report:
    """Translate POLICY of another tool into a ComArmor policy, and prove that both mean the same.

    \b
    keymint import policy.xml -o comarmor.d
    keymint provision comarmor.d -w my_ws

    Makes one profile for each enclave of POLICY, and keeps comments. What a ComArmor policy cannot express is an
    error with its line. So is a rule for which the other tool would enforce something other than POLICY says:
    change POLICY, or use --as-written, which takes POLICY as it reads and warns of each change.

    Nothing is written unless, for every name, what is compiled from the new policy permits what the other tool's
    documents permit, as the transport's standard reads them; differences between vendors are notes.

    Options:
        output: Write the new policy into this folder, as NAME.xml.
        as_written: Take the policy as it reads where the other tool enforces something else.
        implicit: Include the rules that the other tool adds by itself.
        profile_type: Plugin that ships the policy library.
    """
    policies = Policies(run, PolicyOptions(distro, profile_type, ""))
    library = policies.shipped()  # an unknown distribution is wrong usage, whatever the file is
    importer = _importer(run, policy)
    file = output / f"{policy.name.removesuffix('.xml').removesuffix('.policy')}.xml"
    request = api.ImportRequest(run.setting.cwd / policy, str(file), library, as_written, implicit)
    imported = importer.translated(request)
    proofs = proofs_of(run, importer, imported, policies.distro)
    _refuse_other_library(run, output, request.library, imported.document)
    keep = None if force else replacement_refusal(file, "imported", "name another folder with -o", "import-exists")
    delivered = deliver(run, file, imported.document, keep=keep)
    same = sum(map(is_same, proofs.values()))
    run.console.line(
        f"{quantity(len(proofs), 'subject')}: {same} proven to permit, for all names, what {importer.TOOL} lets it do"
    )
    subjects = [{"subject": subject, "same": is_same(comparison)} for subject, comparison in proofs.items()]
    rules = ((each.rules, Origin(str(policy))) for each in imported.subjects)
    nodes = node_notes(run.plugins, (importer.BUILD_TYPE,), policies.distro, rules)
    diagnostics = [*imported.diagnostics, *diagnostics_of(proofs, importer.TOOL), *_beside(run, policy, file), *nodes]
    return run.report({**delivered, "subjects": subjects}, diagnostics, notes=True)


def _importer(run: Run, policy: Path) -> api.PolicyType:
    """Return the policy type that recognises and imports a file.

    Raises:
        KeymintError: there is no such file, or no plugin imports it.
    """
    content = read_input(run, policy)
    foreign = foreign_policy(run.plugins, [run.setting.cwd / policy])
    if foreign is None and looks_like_xml(content):
        parse(content, str(policy))  # raises an error if it is no document, which nothing recognises
    if foreign is None or not foreign.imported:
        raise KeymintError(
            "no plugin recognises this as a policy of another tool", where=Origin(str(policy)),
            help="'keymint lint' reads ComArmor policies as they are", code="import-unknown",
        )  # fmt: skip
    return run.plugins.policy_type(foreign.policy_type)


def proofs_of(
    run: Run, translator: api.PolicyType | api.PolicyFormat, made: api.ImportedPolicy | api.ExportedPolicy, distro: str
) -> Mapping[str, api.Comparison]:
    """Return what is proven about subjects whose documents another tool writes, by subject.

    Args:
        run: the run.
        translator: what translates from or into the language of that tool.
        made: the translation; what is said about it comes first if a proof fails.
        distro: ROS 2 distribution.

    Raises:
        KeymintError: the build type compares no documents, a rule cannot be mapped, or documents are not proven to mean
            the same, which was not accepted; with all such subjects.
    """
    reader = run.plugins.build_type(translator.BUILD_TYPE).keystores
    if reader is None:
        raise KeymintError(f"the build type {translator.BUILD_TYPE} compares no documents", code="import-unproven")
    effort = ProofEffort(run.setting.monotonic)
    proofs: dict[str, api.Comparison] = {}
    refuted: list[Diagnostic] = []
    for each in made.subjects:
        with effort.limit(each.rules.rules):
            comparison = reader.compare(each, distro, effort.states, effort.deadline())
        subject = each.rules.subject
        proofs[subject] = comparison
        claims = (*comparison.ours, *(() if each.deviates else api.standard_claims(comparison.theirs)))
        if claim := next((claim for claim in claims if claim.proof is not api.Proof.PROVEN), None):
            example, help_ = claim.counterexample, "simplify the policy"
            reason = f"{claim.model}, {claim.action}: {claim.reason}"
            if example is not None:
                reason, help_ = _difference(example, translator.TOOL), "this is a defect of Keymint: report it"
            message = f"{subject}: not proven to permit what {translator.TOOL}'s document permits: {reason}"
            refuted.append(Diagnostic.error("import-unproven", message, None, help_, subject))
    if refuted:
        raise KeymintError.of([*made.diagnostics, *refuted])
    return proofs


def _refuse_other_library(run: Run, output: Path, library: Path, document: bytes) -> None:
    """Refuse a folder in which the new policy would include other files than those that the proof is about."""
    if b"<xi:include" not in document:
        return
    for path in sorted(library.rglob("*.xml")):
        beside = output / path.relative_to(library)
        if user_path(run, beside).exists() and read_input(run, beside) != path.read_bytes():
            raise KeymintError(
                "the new policy would include this file, which differs from that of the policy library",
                where=Origin(str(beside)), help="name another folder with -o", code="import-library",
            )  # fmt: skip


def _beside(run: Run, policy: Path, file: Path) -> Iterator[Diagnostic]:
    """Yield a warning if the folder has other files that are a part of its policy."""
    files = sorted(path.name for path in (run.setting.cwd / file.parent).glob("*.xml"))
    others = [name for name in files if name != file.name and not name.endswith(".test.xml")]
    if others:
        message = (
            f"the policy {file.parent} consists of {first_few(others, 3)} too: the proof is about {file.name} alone"
        )
        help_ = (
            f"'keymint diff {policy} {file.parent}' shows what they add; remove them, or name another folder with -o"
        )
        yield Diagnostic.warning("import-beside", message, Origin(str(file)), help_)


def is_same(comparison: api.Comparison) -> bool:
    """Tell whether both documents permit the same for all names, as the standard reads them."""
    claims = (*api.standard_claims(comparison.theirs), *comparison.ours)
    return all(claim.proof is api.Proof.PROVEN for claim in claims)


def diagnostics_of(proofs: Mapping[str, api.Comparison], tool: str) -> Iterator[Diagnostic]:
    """Yield what changes for a subject, what vendors read otherwise, and rules that not every vendor supports."""
    for subject, comparison in proofs.items():
        yield from comparison.diagnostics
        standard = api.standard_claims(comparison.theirs)
        for claim in standard:
            if claim.counterexample is not None:
                message = f"{subject}: what is enforced changes: {_difference(claim.counterexample, tool)}"
                where = claim.counterexample.policy.where
                yield Diagnostic.warning("import-changes", message, where, "", subject)
        if not is_same(comparison):
            continue
        seen = {standard[0].model}  # each vendor that reads the other tool's document differently is noted once
        for claim in comparison.theirs:
            if claim.counterexample is not None and claim.model not in seen:
                seen.add(claim.model)
                message = f"{subject}: {claim.model} reads {tool}'s document differently from the standard"
                difference = f"{message}: {_difference(claim.counterexample, tool)}"
                where = claim.counterexample.policy.where
                yield Diagnostic.note("import-vendor", difference, where, "", subject)


def _difference(example: api.Counterexample, tool: str) -> str:
    """Return a shortest name on which both differ, in words."""
    permits, name, allows = in_words(example)
    return f"{tool}'s document {permits} it to {name}, and the policy in ComArmor {allows} it"
