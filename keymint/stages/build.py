# SPDX-License-Identifier: Apache-2.0
"""The stage ``build``: from source packages to unsigned documents and a private key for each subject."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Defects, Diagnostic, Origin
from keymint.api import BuildOptions, BuildResult, LoadedPolicy, Package
from keymint.errors import KeymintError
from keymint.life import terms
from keymint.names import name_of, subject_of
from keymint.stages import identity_keys, shared_documents
from keymint.stages.built_documents import kept_documents_step, refuse_edits
from keymint.stages.package_stage import PackagePlan, state_after, steps_of
from keymint.store.changes import Action, DocumentSize, File, FolderChange, Plan, Step
from keymint.view.stamps import Stamp, digest
from keymint.workspace.package_build_types import BUILD, build_types_of, inputs_digest, is_build_current, two_writers
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Inputs, Session

STAGE = BUILD


class BuildStage:
    """The stage ``build``.

    Args:
        session: the workspace and its profile.
        options: options of the build types; None for those that each package was built with last.
        force: rebuild, and overwrite documents that were edited by hand.
        renew: replace the private keys of the subjects.
        followers: packages that keep their keys in any case.
        policy: the policy, which knows where the rules of packages are now; loaded when needed if it is not given.
    """

    NAME = STAGE

    def __init__(
        self,
        session: Session,
        options: BuildOptions | None,
        *,
        force: bool = False,
        renew: bool = False,
        followers: Collection[str] = (),
        policy: LoadedPolicy | None = None,
    ) -> None:
        self._session = session
        self._options = options
        self._force = force
        self._renew = renew
        self._followers = followers
        self._places = RulePlaces(session, policy)

    def package(self, name: str) -> PackagePlan:
        """Return the plan for a package."""
        subject = subject_of(name)
        try:
            renew = self._renew and name not in self._followers
            plan = _plan_package(self._session, name, self._options_of(name), force=self._force, renew=renew)
        except KeymintError as error:
            return PackagePlan(name, errors=self._places.in_policy(error.diagnostics, subject))
        if not plan.diagnostics:
            return plan
        return replace(plan, diagnostics=self._places.in_policy(plan.diagnostics, subject))

    def _options_of(self, name: str) -> BuildOptions:
        return self._options or options_as_built(self._session, name)

    def plan(self, planned: Sequence[PackagePlan]) -> Plan:
        """Put the plans for some packages together, and add the shared documents."""
        session, steps = self._session, steps_of(planned)
        # Packages repeat the diagnostics of their authority: keep one of each.
        diagnostics = dict.fromkeys(diagnostic for each in planned for diagnostic in each.diagnostics)
        diagnostics |= dict.fromkeys(terms.of_sources({each.name: each.lifetimes for each in planned}, session))
        built = replace(session, state=state_after(session.state, STAGE, planned))
        try:
            options = self._options_of(planned[0].name) if planned else self._options or BuildOptions()
            shared = shared_documents.plan_shared_build(built, options, force=self._force)
        except KeymintError as error:
            raise KeymintError.of(self._places.in_policy(error.diagnostics)) from error
        diagnostics |= dict.fromkeys(self._places.in_policy(each for plan in shared for each in plan.diagnostics))
        if steps and not (own := session.profile).distro_named:
            message = f"no distribution is named; as far as installed documents tell, the robots have {own.distro}"
            help_ = f"write <layout>{own.layout}</layout><distro>{own.distro}</distro> into <export>, or what they have"
            diagnostics[Diagnostic.warning("distro-unnamed", message, session.profile_marker(), help_)] = None
        return Plan((*steps, *steps_of(shared)), state_after(built.state, STAGE, shared), tuple(diagnostics))


def options_as_built(session: Session, name: str) -> BuildOptions:
    """Return the options that a package was built with last, as far as the record tells; hints are not recorded."""
    stamp = session.state.stamp(STAGE, name)
    known = (BuildOptions(vendor_specific, optimise) for vendor_specific in (False, True) for optimise in (True, False))
    return next((each for each in known if stamp and stamp.context == digest(repr(each))), BuildOptions())


def is_built(inputs: Inputs, name: str) -> bool:
    """Tell whether a package was built and has its documents; a package whose rights are shared has none of its own."""
    return document_digests(inputs, name) is not None


def document_digests(inputs: Inputs, name: str) -> dict[str, str] | None:
    """Return the digests of :func:`built_documents`; None if not built."""
    stamp, folder = inputs.state.stamp(STAGE, name), f"{inputs.workspace.build}/{name}"
    if stamp is None:
        found = {file: digest(content) for file, content in built_documents(inputs, name).items()}
        return found or None
    digests = {file: inputs.tree.digest(f"{folder}/{file}") for file in sorted(stamp.outputs)}
    found = {file: value for file, value in digests.items() if value is not None}
    return found if found or not stamp.outputs else None


def built_documents(inputs: Inputs, name: str) -> dict[str, bytes]:
    """Return the unsigned documents of a package by file name; empty if it was not built."""
    folder = inputs.workspace.build / name
    stamp = inputs.state.stamp(STAGE, name)
    if stamp is None:
        return inputs.tree.files(folder)
    contents = {file: inputs.tree.read(f"{folder}/{file}") for file in sorted(stamp.outputs)}
    return {file: content for file, content in contents.items() if content is not None}


def options_of(options: BuildOptions, subject: str) -> BuildOptions:
    """Drop other subjects' hints, so that changing them does not rebuild this package."""
    if not options.hints:
        return options
    return replace(options, hints=tuple(each for each in options.hints if each.edge.subject == subject))


def _plan_package(session: Session, name: str, options: BuildOptions, *, force: bool, renew: bool) -> PackagePlan:
    folder = session.workspace.build / name
    options = options_of(options, subject_of(name))
    options_digest = digest(repr(options))
    stamp = session.state.stamp(STAGE, name)
    same = stamp is not None and stamp.context == options_digest and is_build_current(session, name)
    may_stay = stamp and same and not force and not renew and identity_keys.is_there(session, name)
    if stamp and may_stay and (step := kept_documents_step(session, stamp, folder, name)):
        return PackagePlan(name, step, lifetimes=terms.recorded_terms(session, name, stamp))
    package = session.package(name)
    built = _built(session, package, options)
    existing = {file: session.tree.read(f"{folder}/{file}") for file in built.documents}
    files = {file: File(content) for file, content in built.documents.items()}
    new_files = {file: new for file, new in files.items() if existing[file] != new.content}
    if not force:
        refuse_edits(session, name, folder, {file: existing[file] for file in new_files}, name)
    changes: tuple[FolderChange, ...] = (FolderChange(folder, new_files),) if new_files else ()
    obsolete = [file for file in stamp.outputs if file not in built.documents] if stamp else []
    changes += shared_documents.removals(session, folder, obsolete)
    minted, fingerprint = _key(session, package, renew=renew)
    before = stamp is not None or any(content is not None for content in existing.values())
    action = (Action.UPDATED if before else Action.CREATED) if changes or minted else Action.UNCHANGED
    outputs = {file: new.digest for file, new in files.items()}
    sizes = _sizes(built)
    step = Step(STAGE, name, action, (*minted, *changes), ", ".join(map(_smaller, sizes)), sizes)
    own = terms.lifetimes(package)
    made = Stamp(
        inputs_digest(session, name, package.build_types),
        outputs,
        context=options_digest,
        lifetimes=terms.dump(own, session.workspace),
        build_types=package.build_types,
    )
    return PackagePlan(name, step, made, built.diagnostics, fingerprint=fingerprint, lifetimes=own)


def _key(session: Session, package: Package, *, renew: bool) -> tuple[tuple[FolderChange, ...], str]:
    """Return the change that stores a new or restored private key, if one is needed, and its fingerprint.

    Raises:
        KeymintError: the stored key cannot be used, or the key to replace is elsewhere.
    """
    if renew:
        identity_keys.refuse_elsewhere(session, package.name)
    if package.issuance.public_key or identity_keys.is_awaited(package):
        return (), ""  # the private key is on the subject's machine, and none is needed here
    if not renew and session.tree.read(session.workspace.identity_key(package.name)) is not None:
        identity_keys.public_key(session, package)
        return (), ""
    new_key = identity_keys.mint if renew else identity_keys.restore_or_mint
    change, fingerprint = new_key(session, package)
    return (change,), fingerprint


def _built(session: Session, package: Package, options: BuildOptions) -> BuildResult:
    """Return what all build types of a package build.

    Raises:
        KeymintError: the defects that the build types find together, or two of them build a document of one name.
    """
    documents: dict[str, bytes] = {}
    builders: dict[str, str] = {}
    sizes: dict[str, int] = {}
    diagnostics: list[Diagnostic] = []
    defects = Defects()
    for name, build_type in build_types_of(session, package).items():
        with defects:
            built = build_type.build(package, options)
            defects.found += two_writers(session, package, builders, name, built.documents)
            documents |= built.documents
            sizes |= built.plain_sizes
            diagnostics += built.diagnostics
    defects.require_none()
    return BuildResult(documents, tuple(dict.fromkeys(diagnostics)), sizes)


def _sizes(built: BuildResult) -> tuple[DocumentSize, ...]:
    return tuple(
        DocumentSize(file, len(built.documents[file]), plain) for file, plain in sorted(built.plain_sizes.items())
    )


def _smaller(size: DocumentSize) -> str:
    if size.bytes == size.plain_bytes:
        return f"{size.file} {size.bytes:,} bytes"
    return f"{size.file} {size.bytes:,} bytes, plain {size.plain_bytes:,}"


class RulePlaces:
    """The places of the rules of packages in the policy as it is now.

    Args:
        session: the workspace and its profile.
        policy: its policy; loaded at the first diagnostic about a rule if it is not given.
    """

    def __init__(self, session: Session, policy: LoadedPolicy | None = None) -> None:
        self._session = session
        self._policy = policy
        self._moved = functools.cache(self._moves)

    def in_policy(self, diagnostics: Iterable[Diagnostic], subject: str = "") -> tuple[Diagnostic, ...]:
        """Return diagnostics about built packages with the places that their rules have now.

        Args:
            diagnostics: the diagnostics, which cite the places that the sources of the packages state.
            subject: whose diagnostics these are; if empty, each names its own.
        """
        return tuple(self._now(each, subject or each.subject) for each in diagnostics)

    def _now(self, diagnostic: Diagnostic, subject: str) -> Diagnostic:
        where = diagnostic.where
        if where is None or not subject:
            return diagnostic
        place = self._moved(subject).get(where)
        return replace(diagnostic, where=place) if place else diagnostic

    def _moves(self, subject: str) -> Mapping[Origin, Origin]:
        """Return the rules that moved: their places in the policy by those that the sources state."""
        try:
            stated = self._session.package(name_of(subject)).grant.rules.rules
            if self._policy is None:
                self._policy = lazy_policy(self._session)
            present = self._policy.rules(subject)
        except KeymintError:  # another stage says what is wrong with the package or the policy
            return {}
        now = present.rules if present else ()
        pairs = list(zip(stated, now, strict=False))
        if len(stated) != len(now) or any(old != replace(new, origin=old.origin) for old, new in pairs):
            return {}  # the sources have other rules than the policy
        moved = [(old.origin, new.origin) for old, new in pairs if old.origin != new.origin]
        return {old.alone(): new.alone() for old, new in moved} | dict(moved)  # some diagnostics leave out the includes
