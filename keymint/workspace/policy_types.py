# SPDX-License-Identifier: Apache-2.0
"""Recognise policies of other types, where a policy of one type cannot be loaded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.api import PolicyImporter, RecognisedPolicy
from keymint.api.plugin_loader import Plugins
from keymint.errors import KeymintError


@dataclass(frozen=True, slots=True)
class ForeignPolicy:
    """A file that a policy type recognises.

    Attributes:
        path: the file.
        policy_type: name of the policy type.
        noun: what its files are called, with its article.
        imported: its type translates it; else it is used as it is.
    """

    path: Path
    policy_type: str
    noun: str
    imported: bool

    def refusal(self, shown: str, profile: str = "") -> KeymintError:
        """Return the error that the file must be imported first, or that its type must be named.

        Args:
            shown: its path as the user would type it.
            profile: path of the document that names the type of the policy, if a workspace has the file.
        """
        if self.imported:
            help_ = f"keymint import {shown} -o comarmor.d"
        elif profile:
            help_ = f"write <policy_type>{self.policy_type}</policy_type> into {profile}, or make a new workspace"
        else:
            help_ = "'keymint lint', 'keymint query' and 'keymint provision' read it"
        return KeymintError(f"this is {self.noun}", where=Origin(shown), help=help_, code="policy-foreign")


def foreign_policy(plugins: Plugins, paths: Iterable[Path], expected: str = "") -> ForeignPolicy | None:
    """Return the first file of some policies that another policy type recognises, or None.

    Args:
        plugins: the plugins.
        paths: files, and folders with policies directly in them.
        expected: name of the policy type that could not load them; empty if none was tried.
    """
    policy_types: Mapping[str, object] = plugins.policy_types()
    known = {
        name: policy_type
        for name, policy_type in policy_types.items()
        if name != expected and isinstance(policy_type, RecognisedPolicy)
    }
    for path in (file for each in paths for file in _files(each)):
        for name, policy_type in known.items():
            if policy_type.recognises(path):
                return ForeignPolicy(path, name, policy_type.NOUN, isinstance(policy_type, PolicyImporter))
    return None


def _files(path: Path) -> Iterator[Path]:
    """Yield a file, or the files of a folder that may be roots of a policy."""
    try:
        yield from sorted(path.glob("*.xml")) if path.is_dir() else (path,)
    except OSError:
        return
