# SPDX-License-Identifier: Apache-2.0
"""Compile the rules of packages on a cluster before they are built here.

A kind with several members is compiled here: the document of the others is that of the first with names put in.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator, Sequence

from keymint.api import BuildOptions, Package
from keymint.errors import KeymintError
from keymint.executors import Pool
from keymint.keymake.kinds import kind_of
from keymint.stages.build import options_of
from keymint.workspace.package_build_types import is_build_current
from keymint.workspace.session import Session


def compile_elsewhere(pool: Pool, session: Session, names: Sequence[str], options: BuildOptions) -> None:
    """Let a cluster compile what the build of some packages needs; what it answers is proven when it is used.

    Args:
        pool: the cluster.
        session: the workspace and its profile.
        names: the packages.
        options: options of the build.

    Raises:
        KeymintError: the cluster is lost, or its versions differ.
    """
    packages = list(_alone(session, names))
    for name in dict.fromkeys(name for package in packages for name in package.build_types):
        compiler = session.plugins.build_type(name)
        own = [each for each in packages if name in each.build_types and compiler.is_remote(each)]
        if not own:
            continue
        tasks = pool.parts([(each, options_of(options, each.subject)) for each in own], 1)
        for part, compiled in zip(tasks, pool.map(compiler.compiling(), tasks), strict=True):
            for (package, its_options), one in zip(part, compiled, strict=False):
                compiler.receive(package, its_options, one, trusted=pool.trusted)


def _alone(session: Session, names: Sequence[str]) -> Iterator[Package]:
    """Yield the packages to build that are the only one of their kind."""
    packages: list[Package] = []
    for name in names:
        if not is_build_current(session, name):
            with contextlib.suppress(KeymintError):  # the build reports it
                packages.append(session.package(name))
    kinds = [(kind_of(each.grant.rules.rules)[0], each.distro, each.grant.domains) for each in packages]
    members = Counter(kinds)
    yield from (package for package, kind in zip(packages, kinds, strict=True) if members[kind] == 1)
