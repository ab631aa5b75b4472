# SPDX-License-Identifier: Apache-2.0
"""Who gains and loses which right when documents are installed in place of others.

*Before* is what the signed documents in the install space grant, which the workspace's authorities must vouch for.
*After* is what the documents grant that are about to be signed: those in the build space, or for a policy that was only
made into sources yet, those that would be built from them. One reader reads both, so that both use the same words.
What has nothing before is new, and what cannot be read is unknown: nothing is guessed.

The changes of a subject are as those of two policies: ``before`` and ``after`` say whether it has an enclave, and any
right. A change of its domains has no permission.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress

from comarmor.patterns.glob import parse
from comarmor.patterns.tokens import STAR
from comarmor.rules import PARTS, Effect
from comarmor.values import replace
from keymint import api
from keymint.analysis.permission_changes import PermissionChange, rule_changes
from keymint.analysis.policy_diff import SubjectChanges
from keymint.analysis.query import effective_permissions
from keymint.analysis.rule_lists import matching_rule
from keymint.analysis.symbolic_search import QueryBudget
from keymint.errors import KeymintError
from keymint.ir import Rule
from keymint.pki import smime
from keymint.stages.documents import build_shared, installed_documents
from keymint.stages.trust_anchors import anchors_of
from keymint.workspace.installed_enclaves import enclave_files
from keymint.workspace.package_build_types import build_types_of
from keymint.workspace.session import Session


def changed_rights(
    session: Session, package: api.Package, built: Mapping[str, bytes], of_all: str = ""
) -> Iterator[SubjectChanges]:
    """Yield what a subject gains and loses.

    Args:
        session: the workspace and its profile, before the documents are installed.
        package: its package.
        built: the unsigned documents by name, of those over all packages by path.
        of_all: name of the build type whose documents over all packages these are; empty for those of the package.
    """
    files = enclave_files(session, package.name)[0] if package.role is api.Role.SUBJECT else {}
    workspace, policy, build_types = session.workspace, package.grant.rules.rules, build_types_of(session, package)
    for name, plugin in build_types.items() if files else ():
        if plugin.prover is None or (name != of_all if of_all else plugin.SHARES):
            continue
        with suppress(KeymintError, KeyError):  # what cannot be read is not the same
            presented = files[plugin.presentation.FILE] if plugin.presentation else b""
            if smime.signed_content(presented) in built.values():
                continue  # whoever signed it
        folders = workspace.shown(session.enclave_folder(package.name)), workspace.shown(workspace.install)
        shared, anchors = installed_documents(session, name), anchors_of(session, package, plugin)
        enclave = api.EnclaveFiles(files, folders[0], anchors, shared, folders[1])
        after, changes = api.InstalledRights(policy, package.grant.domains), list[PermissionChange]()
        try:
            after = plugin.prover.rights(enclave, package.subject, built) or after
            before = plugin.prover.rights(enclave, package.subject)
        except KeymintError as error:
            changes = [PermissionChange(True, "", "", (STAR,), False, "", None, str(error.diagnostics[0]))]
        else:
            for each in _differences(before, after) if before else ():
                # The document that allows what is gained is not there yet.
                rule = each.gains and matching_rule(policy, Effect.ALLOW, each.kind, each.permission, each.word)
                changes.append(replace(each, where=rule.origin if rule else None) if each.gains else each)
        if changes:
            if len(build_types) > 1:
                changes = [replace(each, build_type=name) for each in changes]
            is_left = any(True for _ in effective_permissions(after.rules))
            yield SubjectChanges(package.subject, None, True, is_left, tuple(changes))


def rights_of_sources(session: Session, names: Iterable[str]) -> Iterator[SubjectChanges]:
    """Yield what the subjects of some packages would gain and lose if their sources were built and installed.

    What cannot be built is left out: the build reports it.

    Args:
        session: the workspace with these sources, and its profile.
        names: the packages.
    """
    options = api.BuildOptions(allow_vendor_specific=True)
    shared: dict[str, Mapping[str, bytes]] = {}
    for package in map(session.package, names):
        for name, plugin in build_types_of(session, package).items():
            with suppress(KeymintError):
                if plugin.SHARES and name not in shared:
                    shared[name] = build_shared(session, name, options).documents
                built = shared[name] if plugin.SHARES else plugin.build(package, options).documents
                yield from changed_rights(session, package, built, name)


def _differences(before: api.InstalledRights, after: api.InstalledRights) -> Iterator[PermissionChange]:
    """Yield the differences of what documents grant, and of their domains."""
    yield from rule_changes(_with_composites(before.rules), _with_composites(after.rules), QueryBudget())
    old, new = (
        {number for one in each.domains for number in range(one.first, one.last + 1)} for each in (before, after)
    )
    for name, number in ((f"domain {each}", each) for each in sorted(old ^ new) if before.rules and after.rules):
        yield PermissionChange(number in new, "", "", parse(name), True, name, None)


def _with_composites(rules: Sequence[Rule]) -> tuple[Rule, ...]:
    """Return rules of documents, which know the parts of permissions only, with those that the parts make together."""
    allowed: dict[tuple[str, str], dict[str, Rule]] = {}
    for rule in rules:
        if rule.effect is Effect.ALLOW:
            allowed.setdefault((rule.kind, rule.permissions[0]), {})[rule.expressions[0]] = rule
    composites: list[Rule] = []
    for (kind, permission), ((first_kind, first_part, first_suffix), *others) in PARTS.items():
        for text, rule in allowed.get((first_kind, first_part), {}).items():
            name = text.removesuffix(first_suffix)
            if name != text and all(name + suffix in allowed.get((of, part), {}) for of, part, suffix in others):
                composites.append(replace(rule, kind=kind, permissions=(permission,), expressions=(name,)))
    return (*composites, *rules)
