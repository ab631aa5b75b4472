# SPDX-License-Identifier: Apache-2.0
"""Creates source packages from the rules of a subject, or from what another tool made, and edits what was taken over.

The edits are a unique subject name, and an authority of its own for signatures. Only the elements that change are
edited, as text, so that comments and all else stay. What a person wrote in another way than Keymint does is an error
that says what to write.

The tool of 2018 wrote ``permissions.xml`` from the policy as well, so both say the same unless somebody edited one of
them. They are compared as they are written: each permission on each expression.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime

from lxml import etree

from comarmor.rules import KIND_OF, Effect
from comarmor.text import lazy_regex, quote
from comarmor.values import Data
from comarmor.xml import reader
from comarmor.xml.reader import line
from keymint import api
from keymint.api import Role, Validity, WorkspaceProfile
from keymint.api.source_documents import Reader
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.ir import SubjectRules
from keymint.names import name_of
from keymint_ros import bootstrap, manifest, permissions, validity
from keymint_ros.manifest import ADOPTED, BUILD_TYPE, MARKER, SIGNER
from keymint_ros.permissions import WrittenGrant
from keymint_ros.profile_reader import base_of

FORMER = ".2018"
"""Suffix of the backup of a ``permissions.xml`` in the format of 2018 that a new one replaces."""


def create(
    profile: WorkspaceProfile, rules: SubjectRules, existing: Mapping[str, bytes], *, force: bool
) -> Mapping[str, bytes]:
    """Return the files to write for a package: see :meth:`keymint.api.PackageType.create`."""
    return {**_new(profile.build_types, existing), **_permissions(profile, rules, existing, force=force)}


def former_rules(rules: SubjectRules, files: Mapping[str, bytes]) -> Sequence[Diagnostic]:
    """Return what permissions of 2018 say differently: see :meth:`keymint.api.PackageType.former_rules`."""
    name = name_of(rules.subject)
    try:
        path = _permissions_path(files, name)
        permissions.read(files.get(path, b""), f"{name}/{path}", rules.subject)
    except KeymintError as error:
        if error.diagnostics[0].code == permissions.OLD_FORMAT:
            return _differences_of_2018(files[path], f"{name}/{path}", rules)
    return ()


def _permissions_path(files: Mapping[str, bytes], name: str) -> str:
    """Return the path of the permissions in a package, as its manifest gives it."""
    if MARKER not in files:
        return "permissions.xml"
    return manifest.path_of("permissions", name, files)


def create_infrastructure(
    profile: WorkspaceProfile, name: str, build_type: str, existing: Mapping[str, bytes]
) -> Mapping[str, bytes]:
    """Return the files to write: see :meth:`keymint.api.PackageType.create_infrastructure`."""
    del profile, name
    return _new((build_type,), existing, Role.INFRASTRUCTURE)


def _new(build_types: tuple[str, ...], existing: Mapping[str, bytes], role: Role = Role.SUBJECT) -> Mapping[str, bytes]:
    """Return the files of a new package, except those that exist; none if it is a package already."""
    if MARKER in existing:
        return {}
    return {file: content for file, content in bootstrap.package(build_types, role).items() if file not in existing}


def _permissions(
    profile: WorkspaceProfile, rules: SubjectRules, existing: Mapping[str, bytes], *, force: bool
) -> Mapping[str, bytes]:
    """Return the permissions document if it must be written.

    Like dpkg for configuration files, this compares three states of the rules: those of the policy when the document
    was written, those in the document, and those of the policy now.
    """
    name, base = name_of(rules.subject), base_of(profile)
    path, new = _permissions_path(existing, name), permissions.render(rules, base)
    current = existing.get(path)
    if current is None:
        return {path: new}
    if current == new:
        return {}
    file = f"{name}/{path}"
    try:
        grant = permissions.read(current, file, rules.subject)
    except KeymintError as error:
        old = error.diagnostics[0].code == permissions.OLD_FORMAT
        if not old and not force:
            raise
        former = {path + FORMER: current} if old and path + FORMER not in existing else {}
        return {**former, path: new}  # the backup first, so that a killed run loses nothing
    if not force and (permissions.has_rules(grant, rules) or _keeps_edit(grant, permissions.digest(rules.rules), file)):
        return {}
    if grant.name == rules.subject and not grant.overrides:
        return {path: new}
    return {path: permissions.render(rules, base, name=grant.name, overrides=grant.overrides)}


def _keeps_edit(grant: WrittenGrant, now: str, file: str) -> bool:
    """Tell whether a document was edited by hand and is kept, since the policy's rules (digest ``now``) did not change.

    Raises:
        KeymintError: the document was edited, and the policy changed too, to other rules than the edit's.
    """
    if not grant.edited or grant.current == now:
        return False
    if grant.base == now:
        return True
    message = "these permissions were edited by hand, and the policy changed too"
    help_ = "move the edits into the policy, then replace the file with --force"
    raise KeymintError(message, where=Origin(file, grant.own.line), help=help_, code="hand-edited")


_EMPTY = b"    <identity/>\n"
_ORIGIN = lazy_regex(rb' origin="[^"]*"')
"""Where a rule stands: lines move, and the checkout as well."""
_read_identity_length = Reader("keymint_ros", "identities", validity.length)
_read_grant_length = Reader("keymint_ros", "permissions", validity.length)


def with_validity(
    profile: WorkspaceProfile, rules: SubjectRules, files: Mapping[str, bytes], valid_for: str, now: datetime
) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.PackageType.with_validity`."""
    name = name_of(rules.subject)
    begin = validity.begin_of_period(valid_for, now)
    element = f"<validity><not_before>{begin}</not_before><duration>{valid_for}</duration></validity>"
    path = manifest.path_of("identities", name, files)
    changed: dict[str, bytes] = {}
    if path not in files or _read_identity_length(files[path], f"{name}/{path}") != valid_for:
        new = bootstrap.package_document("identities.xml")
        if files.get(path, new) != new:
            raise _has_own(name, path, valid_for)
        identity = f"    <identity>\n      <cert>{element}</cert>\n    </identity>\n".encode()
        changed[path] = new.replace(_EMPTY, identity)
    # No other transport than DDS reads the validity of a grant.
    if BUILD_TYPE in manifest.read(files[MARKER], f"{name}/{MARKER}").build_types:
        path = manifest.path_of("permissions", name, files)
        if _read_grant_length(files[path], f"{name}/{path}") != valid_for:
            base = base_of(profile)
            if _ORIGIN.sub(b"", files[path]) != _ORIGIN.sub(b"", permissions.render(rules, base)):
                raise _has_own(name, path, valid_for)
            changed[path] = permissions.render(rules, base, overrides=(element,))
    return changed


def _has_own(name: str, path: str, duration: str) -> KeymintError:
    message = "was edited by hand, so no validity is written into it"
    help_ = f"write <validity> with <duration>{duration}</duration> into it"
    return KeymintError(message, where=Origin(f"{name}/{path}"), help=help_, code="hand-edited")


_EFFECTS = {"allow_rule": Effect.ALLOW, "deny_rule": Effect.DENY}
_OF_GRANT = ("subject_name", "validity")


class _Right(Data):
    """A permission on an expression."""

    effect: Effect
    permission: str
    expression: str
    partitions: tuple[str, ...]

    def __str__(self) -> str:
        inside = f" in {', '.join(map(quote, self.partitions))}" if self.partitions else ""
        return f"{self.effect} {self.permission} {quote(self.expression)}{inside}"


def _differences_of_2018(content: bytes, file: str, rules: SubjectRules) -> tuple[Diagnostic, ...]:
    """Return what a document of 2018 says and the rules of the policy do not, and the other way, as warnings.

    Args:
        content: the document; must be well-formed.
        file: its path, for messages.
        rules: the rules that replace it.
    """
    root = reader.parse(content, file)
    then: dict[_Right, int] = {}
    others: dict[str, int] = {}
    for element in root.iterfind("permissions/grant/*"):
        tag = str(element.tag)
        if tag in _EFFECTS:
            for right, place in _rights(element, others):
                then.setdefault(right, place)
        elif tag in _OF_GRANT or (tag == "default" and (element.text or "").strip() != Effect.DENY):
            others.setdefault(tag, line(element))
    now = dict.fromkeys(
        _Right(rule.effect, permission, expression, rule.partitions)
        for rule in rules.rules
        for permission in rule.permissions
        for expression in rule.expressions
    )
    only_then = [right for right in then if right not in now]
    only_now = [right for right in now if right not in then]
    found = []
    if only_then:
        found.append((then[only_then[0]], f"said {_some(only_then)}, which the policy does not say"))
    if only_now:
        found.append((0, f"did not say {_some(only_now)}, which the policy says"))
    found += [(place, f"had <{tag}> of its own, which the new one has not") for tag, place in others.items()]
    return tuple(
        Diagnostic.warning(
            "permissions-of-2018", f"the permissions of 2018 {text}", Origin(file, place),
            f"they are kept as {file.rpartition('/')[2]}.2018; change the policy, or the new file, if they are right",
            rules.subject
        )
        for place, text in found
    )  # fmt: skip


def _some(rights: list[_Right]) -> str:
    others = len(rights) - 1
    return str(rights[0]) if not others else f"{rights[0]} and {others} more"


def _rights(rule: etree._Element, others: dict[str, int]) -> Iterator[tuple[_Right, int]]:
    """Yield what a rule says, with its line, and add the elements that have no place in the rules of a policy."""
    for criteria in rule:
        permission = str(criteria.tag)
        if permission not in KIND_OF:
            others.setdefault(permission, line(criteria))
            continue
        partitions = tuple((each.text or "").strip() for each in criteria.iterfind("partitions/partition"))
        for group in criteria:
            if group.tag == "partitions":
                continue
            if group.tag != f"{KIND_OF[permission]}s":
                others.setdefault(str(group.tag), line(group))
                continue
            for each in group:
                expression = (each.text or "").strip()
                yield _Right(_EFFECTS[str(rule.tag)], permission, expression, partitions), line(each)


# -- what was taken over -----------------------------------------------------------------------------------------------

_SPECIAL = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def adopted_sources(profile: WorkspaceProfile, sources: api.AdoptedSources) -> Mapping[str, bytes]:
    """Return the files of a package: see :meth:`keymint.api.PackageType.adopted_sources`."""
    ids = [
        f"<id>{each.first}</id>"
        if each.first == each.last
        else f"<id_range><min>{each.first}</min><max>{each.last}</max></id_range>"
        for each in sources.domains
    ]
    domains = [f"<domains>{''.join(ids)}</domains>"] if ids else []
    key = sources.key
    kind = f"<rsa><key_size>{key.size}</key_size></rsa>"
    if key.algorithm == "ec":
        kind = f"<ec><curve>{key.curve}</curve></ec>"
    key_lines = (
        f"<asymmetric_type>{kind}</asymmetric_type>",
        "<encryption_algorithm>NoEncryption</encryption_algorithm>",
        "<password_env></password_env>",
    )
    name = [f"<subject_name>{sources.subject_name.translate(_SPECIAL)}</subject_name>"] if sources.subject_name else []
    cert = (*name, validity.element(sources.validity))
    overrides = (*domains, *name, validity.element(sources.grant_validity))
    return {
        **bootstrap.package(profile.build_types),
        "identities.xml": bootstrap.filled_file("package/identities.adopted.xml", cert=cert, key=key_lines),
        "permissions.xml": permissions.render(sources.rules, base_of(profile), overrides=overrides),
        **{f"{ADOPTED}{name}": content for name, content in sources.documents.items()},
    }


_NAME = lazy_regex(r"<subject_name>[^<]*</subject_name>")
_VALIDITY = lazy_regex(r"^(?=([ \t]*)<validity>)", re.MULTILINE)
_END = lazy_regex(r"(?=  </authorities>)(?!.+  </authorities>)", re.DOTALL)
_COMMENT = lazy_regex(r"<!--.*?-->", re.DOTALL)
_AUTHORITIES = "authorities.xml"
_SIGNED = ("package.defaults/permissions.xml", "package.defaults/governance.xml")


def with_unique_name(profile: WorkspaceProfile, name: str, files: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.PackageType.with_unique_name`."""
    del profile
    element = f"<subject_name>{bootstrap.SUBJECT_NAMES['unique']}</subject_name>"
    edits = {_NAME: element, _VALIDITY: rf"\1{element}\n"}
    changed: dict[str, bytes] = {}
    for part in ("identities", "permissions"):
        path = manifest.path_of(part, name, files)
        changed |= _edited(files, path, f"{name}/{path}", edits, f"write {element} into it")
    return changed


def with_own_signer(profile: WorkspaceProfile, former: str, period: Validity | None = None) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.ProfileType.with_own_signer`."""
    base = base_of(profile)
    wanted = f"<issuer_name>{SIGNER}</issuer_name>"
    added = "".join(f"    {line}\n" for line in bootstrap.authority(SIGNER, period))
    help_ = f'add <authority name="{SIGNER}"> to it'
    changed = _edited(profile.files, _AUTHORITIES, base + _AUTHORITIES, {_END: added}, help_)
    edits = {re.compile(rf"<issuer_name>\s*{re.escape(former)}\s*</issuer_name>"): wanted}
    for path in _SIGNED:
        changed |= _edited(profile.files, path, base + path, edits, f"write {wanted}")
    return changed


def without_comments(content: bytes) -> tuple[str, str]:
    """Return the text of a document, and one of the same length that is blank where it has comments.

    Both are empty for a document in another encoding than UTF-8, which Keymint writes none in.
    """
    try:
        text = content.decode()
    except UnicodeDecodeError:
        return "", ""
    return text, _COMMENT.sub(lambda comment: re.sub(r"[^\n]", " ", comment[0]), text)


def _edited(
    files: Mapping[str, bytes], path: str, shown: str, edits: Mapping[re.Pattern[str], str], help_: str
) -> dict[str, bytes]:
    """Return a file after an edit: the first place of the first pattern that it has gets a new text.

    Raises:
        KeymintError: there is no such file, or it is written in another way than Keymint writes it.
    """
    text, plain = without_comments(files.get(path, b""))
    for pattern, new in edits.items():
        if found := pattern.search(plain):
            return {path: f"{text[: found.start()]}{found.expand(new)}{text[found.end() :]}".encode()}
    message = "is written in a way that Keymint does not edit"
    raise KeymintError(message, where=Origin(shown), help=help_, code="harden-by-hand")
