# SPDX-License-Identifier: Apache-2.0
"""The stage ``build``: from source packages to unsigned documents and a private key for each subject."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial

from comarmor.text import quantity
from comarmor.values import replace
from keymint.api import BuildOptions, BuildResult, LoadedPolicy, Package
from keymint.errors import Defects, Diagnostic, KeymintError, Origin
from keymint.life import terms
from keymint.life.terms import Term
from keymint.life.workspace_register import register_of
from keymint.names import name_of, subject_of
from keymint.stages import identities
from keymint.stages.documents import (
    build_shared,
    documents_folder,
    kept_documents_step,
    obsolete_documents,
    refuse_edits,
    removals,
)
from keymint.stages.work import InstallRequest, NewPackage, PackagePlan, PackageStage, state_after, steps_of
from keymint.store.changes import Action, DocumentSize, File, FolderChange, Plan, Step, by_folder, same_file
from keymint.view.stamps import Stamp, digest, stamp_of
from keymint.workspace import package_build_types
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session

STAGE = package_build_types.BUILD


class BuildStage(PackageStage):
    """The stage ``build``.

    Args:
        session: the workspace and its profile.
        asked: what the user asks for: options of the build types, and whether documents that were edited by hand are
            overwritten and the private keys of the subjects replaced.
        followers: packages that keep their keys in any case.
        policy: the policy, which knows where the rules of packages are now; loaded when needed if it is not given.
    """

    NAME = STAGE

    def __init__(
        self,
        session: Session,
        asked: InstallRequest,
        followers: Collection[str] = (),
        policy: LoadedPolicy | None = None,
    ) -> None:
        self._session = session
        self._asked = asked
        self._followers = followers
        self._policy = policy
        self._files: dict[str, File] = {}

    def package(self, name: str) -> PackagePlan:
        """Return the plan for a package."""
        subject = subject_of(name)
        try:
            rekey = name in self._asked.rekey and name not in self._followers
            plan = _plan_documents(self._session, name, self._options_of(name), force=self._asked.force, rekey=rekey)
        except KeymintError as error:
            return PackagePlan(name, errors=self._in_policy(error.diagnostics, subject))
        return replace(plan, diagnostics=self._in_policy(plan.diagnostics, subject))

    def new(self, new: NewPackage) -> PackagePlan | None:
        """See :meth:`keymint.stages.work.PackageStage.new`."""
        session, name, workspace = self._session, new.name, self._session.workspace
        contents = {file: each.content for file, each in new.sources.items()}
        if new.forms.package is None:
            new.forms.package = session.package(name), contents
        folder = workspace.shown(f"{workspace.src}/{name}")
        package = session.package_type.load_like(session.profile, *new.forms.package, name, folder, contents)
        if package is None:
            return None
        new.package = package
        digests = {file: each.digest for file, each in new.sources.items()}
        new.inputs = package_build_types.inputs_digest(session, name, package.build_types, digests)
        options = options_of(self._options_of(name), package.subject)
        built = _built(session, package, options)
        new.documents = {file: same_file(self._files, file, content) for file, content in built.documents.items()}
        new.kind = built.alike
        new.key, fingerprint = identities.mint(session, package)
        change = FolderChange(f"{workspace.build}/{name}", new.documents)
        sizes = _sizes(built, dict(sorted(built.plain_sizes.items())))
        step = Step(STAGE, name, Action.CREATED, (new.key, change), *sizes)
        known = new.forms.of(STAGE, new.kind)
        stamp, own = _stamp(session, new.inputs, new.documents, _context(options), package, known=known)
        new.forms.learn(STAGE, new, (own, stamp.lifetimes), lambda one, other: one if one == other else None)
        new.built = PackagePlan(name, step, stamp, built.diagnostics, fingerprint=fingerprint, lifetimes=own)
        return new.built

    def _options_of(self, name: str) -> BuildOptions:
        return self._asked.build or options_as_built(self._session, name)

    def plan(self, planned: Sequence[PackagePlan]) -> Plan:
        """Put the plans for some packages together, and add the shared documents."""
        session, steps = self._session, steps_of(planned)
        # Packages repeat the diagnostics of their authority: keep one of each.
        diagnostics = dict.fromkeys(diagnostic for each in planned for diagnostic in each.diagnostics)
        diagnostics |= dict.fromkeys(self._replaced_keys(planned))
        diagnostics |= dict.fromkeys(terms.of_sources({each.name: each.lifetimes for each in planned}, session))
        built = replace(session, state=state_after(session.state, STAGE, planned))
        try:
            options = self._options_of(planned[0].name) if planned else self._asked.build or BuildOptions()
            shared = _plan_shared(built, options, force=self._asked.force)
        except KeymintError as error:
            raise KeymintError.of(self._in_policy(error.diagnostics)) from error
        diagnostics |= dict.fromkeys(self._in_policy(each for plan in shared for each in plan.diagnostics))
        if steps and not (own := session.profile).distro_named:
            message = f"no distribution is named; as far as installed documents tell, the robots have {own.distro}"
            help_ = f"write <layout>{own.layout}</layout><distro>{own.distro}</distro> into <export>, or what they have"
            diagnostics[Diagnostic.warning("distro-unnamed", message, session.profile_marker(), help_)] = None
        for former, now in session.profile.renamed.items():
            message = f"the element <{former}> is called <{now}> now"
            help_ = "use the new name: the next release reads no other"
            diagnostics[Diagnostic.warning("element-renamed", message, session.profile_marker(), help_)] = None
        return Plan((*steps, *steps_of(shared)), state_after(built.state, STAGE, shared), tuple(diagnostics))

    def _replaced_keys(self, planned: Sequence[PackagePlan]) -> Iterator[Diagnostic]:
        """Yield a warning if packages get new keys in place of those that they have, and that were not revoked."""
        keys = self._session.workspace.identity_key
        asked = (each.name for each in planned if each.name in self._asked.rekey)
        kept = (name for name in asked if self._session.tree.has_file(keys(name)))
        if names := [name for name in kept if not register_of(self._session).withdrawn(name)]:
            message = f"{quantity(len(names), 'private key')} replaced: {', '.join(map(subject_of, names))}"
            ends = f"keymint revoke {names[0] if len(names) == 1 else 'NAME'} --reason superseded"
            help_ = (
                f"deploy them and restart their processes; '{ends}' revokes the certificates of the former keys alone"
            )
            yield Diagnostic.warning("keys-replaced", message, None, help_)

    def _in_policy(self, diagnostics: Iterable[Diagnostic], subject: str = "") -> tuple[Diagnostic, ...]:
        """Return diagnostics about built packages with the places that their rules have now.

        Args:
            diagnostics: the diagnostics, which cite the places that the sources of the packages state.
            subject: whose diagnostics these are; if empty, each names its own.
        """
        found = []
        for each in diagnostics:
            whose = subject or each.subject
            # A cache of the method would be in a circle with this object, and keep the session.
            is_placed = each.where and whose
            moved = self._session.made(("moved rules", whose), partial(self._moves, whose)) if is_placed else {}
            place = moved.get(each.where) if each.where else None
            found.append(replace(each, where=place) if place else each)
        return tuple(found)

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


@lru_cache(maxsize=64)
def _context(options: BuildOptions) -> str:
    """Return the digest of options, for the record."""
    return digest(repr(options))


def options_as_built(session: Session, name: str) -> BuildOptions:
    """Return the options that a package was built with last, as far as the record tells; hints are not recorded."""
    stamp = session.state.stamp(STAGE, name)
    known = (BuildOptions(vendor_specific, optimise) for vendor_specific in (False, True) for optimise in (True, False))
    return next((each for each in known if stamp and stamp.context == digest(repr(each))), BuildOptions())


def options_of(options: BuildOptions, subject: str) -> BuildOptions:
    """Drop other subjects' hints, so that changing them does not rebuild this package."""
    if not options.hints:
        return options
    return replace(options, hints=tuple(each for each in options.hints if each.edge.subject == subject))


def _plan_documents(session: Session, name: str, options: BuildOptions, *, force: bool, rekey: bool) -> PackagePlan:
    """Return the plan for a package and its key, or for the documents over all packages of a build type."""
    shared, folder = package_build_types.shared_type(name), documents_folder(session, name)
    options = options if shared else options_of(options, subject_of(name))
    context = _context(options)
    stamp = session.state.stamp(STAGE, name)
    same = stamp is not None and stamp.context == context and package_build_types.is_build_current(session, name)
    may_stay = same and not force and not rekey and (shared or identities.is_there(session, name))
    if stamp and may_stay and (step := kept_documents_step(session, name, stamp)):
        return PackagePlan(name, step, lifetimes=() if shared else terms.recorded_terms(session, name, stamp))
    package = None if shared else session.package(name)
    built = _built(session, package, options) if package else build_shared(session, shared, options)
    obsolete = sorted(stamp.outputs.keys() - built.documents.keys()) if stamp else []
    present = (*built.documents, *(obsolete if shared else ()))
    existing = {file: session.tree.read(f"{folder}/{file}") for file in present}
    others = {file: content for file, content in existing.items() if content != built.documents.get(file)}
    if not force:
        refuse_edits(session, name, others)
    files = {file: File(content) for file, content in built.documents.items()}
    written = by_folder(folder, {file: new for file, new in files.items() if file in others})
    changes = (*(FolderChange(*each) for each in written.items()), *removals(session, folder, obsolete))
    minted, fingerprint = _key(session, package, rekey=rekey, restore=force) if package else ((), "")
    before = stamp is not None or any(content is not None for content in existing.values())
    action = (Action.UPDATED if before else Action.CREATED) if changes or minted else Action.UNCHANGED
    plain = (
        {file: len(content) for file, content in built.documents.items()}
        if shared
        else dict(sorted(built.plain_sizes.items()))
    )
    shown, sizes = _sizes(built, plain)
    # The sizes of a report are those of packages.
    step = Step(STAGE, "" if shared else name, action, (*minted, *changes), shown, () if shared else sizes)
    inputs = package_build_types.inputs_digest(session, name, package.build_types if package else (shared,))
    made, own = _stamp(session, inputs, files, context, package, shared)
    return PackagePlan(name, step, made, tuple(built.diagnostics), fingerprint=fingerprint, lifetimes=own)


def _sizes(built: BuildResult, plain: Mapping[str, int]) -> tuple[str, tuple[DocumentSize, ...]]:
    """Return the sizes of documents and of their plain forms: in words, and as the report has them."""
    sizes = tuple(DocumentSize(file, len(built.documents[file]), size) for file, size in plain.items())
    plain_bytes = (f", plain {each.plain_bytes:,}" if each.bytes != each.plain_bytes else "" for each in sizes)
    shown = ", ".join(f"{each.file} {each.bytes:,} bytes{more}" for each, more in zip(sizes, plain_bytes, strict=True))
    return shown, sizes


def _stamp(
    session: Session,
    inputs: str,
    files: Mapping[str, File],
    context: str,
    package: Package | None,
    shared: str = "",
    known: tuple[tuple[Term, ...], str] | None = None,
) -> tuple[Stamp, tuple[Term, ...]]:
    """Return the record of some documents, and when they are in force.

    Args:
        session: the workspace and its profile.
        inputs: the digest of all that they are made from.
        files: the documents.
        context: the digest of the options.
        package: the package; None for shared documents.
        shared: the build type of these.
        known: when they are in force, if that is known, and this as the record has it.
    """
    build_types = package.build_types if package else (shared,)
    own = known[0] if known else terms.lifetimes(package) if package else ()
    lifetimes = known[1] if known else terms.dump(own, session.workspace) if package else ""
    outputs = {file: new.digest for file, new in files.items()}
    return Stamp(inputs, outputs, context=context, lifetimes=lifetimes, build_types=build_types), own


def _plan_shared(session: Session, options: BuildOptions, *, force: bool) -> list[PackagePlan]:
    """Return the plans for the documents over all packages of each build type.

    Args:
        session: the workspace and its profile, with the record of the packages that this run builds.
        options: options of the build.
        force: rebuild, and overwrite documents that were edited by hand.

    Raises:
        KeymintError: a package has defects, or packages contradict each other.
    """
    names = [package_build_types.record_key(build_type) for build_type in package_build_types.users(session)]
    planned = [_plan_documents(session, name, options, force=force, rekey=False) for name in names]
    writers: dict[str, str] = {}
    for plan in planned:
        own = package_build_types.shared_type(plan.name)
        stamp = stamp_of(plan.stamp) if plan.stamp else session.state.stamps[STAGE][plan.name]
        for path in stamp.outputs:
            if (other := writers.setdefault(path, own)) != own:
                raise KeymintError(
                    f"the build types {other} and {own} both have a shared document {path}",
                    where=session.profile_marker(),
                    help="use them in different workspaces",
                    code="file-conflict",
                )
    return [*planned, *obsolete_documents(session, STAGE, session.workspace.build / package_build_types.SHARED)]


def _key(session: Session, package: Package, *, rekey: bool, restore: bool) -> tuple[tuple[FolderChange, ...], str]:
    """Return the change that stores a new or restored private key, if one is needed, and its fingerprint.

    Raises:
        KeymintError: the stored key cannot be used, or the key to replace is elsewhere.
    """
    if rekey and (package.issuance.public_key or package.identity.key.uri):
        raise KeymintError(
            f"the private key of {package.subject} is not here, so no other one is made for it",
            where=session.issuance_place(package.name),
            help="run 'keymint request' on the machine that is to have the key, then 'keymint sign' here",
            code="key-elsewhere",
        )
    if package.issuance.public_key or identities.is_awaited(package):
        return (), ""  # the private key is on the subject's machine, and none is needed here
    if not rekey and session.tree.read(session.workspace.identity_key(package.name)) is not None:
        identities.public_key(session, package)
        return (), ""
    change, fingerprint = identities.restore_or_mint(session, package, rekey=rekey, restore=restore)
    return (change,), fingerprint


def _built(session: Session, package: Package, options: BuildOptions) -> BuildResult:
    """Return what all build types of a package build.

    Raises:
        KeymintError: the defects that the build types find together, or two of them build a document of one name.
    """
    documents: dict[str, bytes] = {}
    builders: dict[str, str] = {}
    sizes: dict[str, int] = {}
    alike: list[object] = []
    diagnostics: list[Diagnostic] = []
    defects = Defects()
    for name, build_type in package_build_types.build_types_of(session, package).items():
        with defects:
            built = build_type.build(package, options)
            defects.found += package_build_types.two_writers(session, package, builders, name, built.documents)
            documents |= built.documents
            sizes |= built.plain_sizes
            diagnostics += built.diagnostics
            alike.append(built.alike)
    defects.require_none()
    return BuildResult(documents, tuple(dict.fromkeys(diagnostics)), sizes, None if None in alike else tuple(alike))
