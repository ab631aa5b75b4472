# SPDX-License-Identifier: Apache-2.0
"""What the shell offers for an option or an argument: names of plugins, of the workspace, and of its policy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path

import click

from comarmor.patterns.tokens import SPECIAL
from comarmor.text import natural_order
from comarmor.xml.package_folders import InstalledPackages
from keymint.analysis.query import FORMS, HEADS
from keymint.api import BuildType, LoadedPolicy, ProfileType
from keymint.api.graph import LABELLED
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import DEFAULT_PROFILE_TYPE, PolicyOptions, policy_options
from keymint.command_line.verb import Word
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.output.explanations import explanations
from keymint.run.run import Run, Setting
from keymint.view.tree import Tree
from keymint.workspace.workspace import packages

_MOST = 2000
"""The most values that are offered."""


def values(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Return the values of a parameter that begin like a word, in an order for people; none if they cannot be told.

    Args:
        context: what was typed before.
        parameter: the option or argument.
        incomplete: the word.
    """
    setting: Setting = context.find_root().obj()
    named = context.params.get("workspace")
    run = Run(setting, "", {"quiet": True, "verbose": 0, "as_json": False, "workspace": named})
    name = str(parameter.name)
    find = _VALUES.get(f"{context.info_name} {name}", _VALUES.get(name, lambda *_: ()))
    try:
        group = parameter.type.group if isinstance(parameter.type, Word) else ""
        known = run.plugins.names(group) if group else find(run, context)
        found = {each for each in known if each.startswith(incomplete)}
    except (KeymintError, OSError):
        return []
    return sorted(found, key=natural_order)[:_MOST]


def _profile_type(run: Run, context: click.Context) -> ProfileType:
    return run.plugins.profile_type(context.params.get("profile_type") or DEFAULT_PROFILE_TYPE)


def _build_types(run: Run) -> Iterator[BuildType]:
    return map(run.plugins.build_type, run.plugins.names("keymint.build_types"))


def _formats(run: Run, _context: click.Context) -> Iterable[str]:
    read = (each.FORMAT for each in run.plugins.policy_types().values())
    return filter(None, (*run.plugins.names("keymint.policy_formats"), *read))


def _authorities(run: Run, _context: click.Context) -> Iterable[str]:
    names = (name.partition(".cert.") for name, _ in Tree().names(run.workspace().public))
    return (name for name, _, is_certificate in names if is_certificate)


def _policy(run: Run, context: click.Context) -> LoadedPolicy:
    """Return the policy that was typed, or that of the workspace."""
    words = [word for word in (context.params.get("words") or ())[:1] if word not in HEADS]
    typed = next(filter(None, (context.params.get("policy"), *words)), None)
    plugins = {name: policy_options.options[name](name).default for name in ("profile_type", "policy_type")}
    given = {name: context.params.get(name) or default for name, default in plugins.items()}
    options = PolicyOptions(context.params.get("distro"), **given)
    return Policies(run, options).load(None if typed is None else Path(typed))


def _objects(run: Run, context: click.Context) -> Iterator[str]:
    """Yield the names without wildcards in the rules of the subject that was typed, or of all subjects."""
    policy, subject = _policy(run, context), context.params.get("subject")
    for name in (f"/{subject.strip('/')}",) if isinstance(subject, str) else policy.subjects()[:_MOST]:
        rules = policy.rules(name)
        expressions = chain.from_iterable(rule.expressions for rule in (rules.rules if rules else ()))
        yield from (each for each in expressions if not SPECIAL.search(each))


def _question(run: Run, context: click.Context) -> Iterator[str]:
    """Yield what may come next in a query."""
    typed = list(context.params.get("words") or ())
    del typed[: int(bool(typed) and typed[0] not in HEADS)]
    for form in (form for each in FORMS for form in (each.replace("[ever] ", ""), each.replace("[ever]", "ever"))):
        words = form.split()
        fits = all(own == word or own.isupper() for own, word in zip(words, typed, strict=False))
        if fits and len(typed) < len(words):
            following = words[len(typed)]
            find = _VALUES.get(following.lower())  # of SUBJECT, PERMISSION and OBJECT
            yield from find(run, context) if find else (following,)


_VALUES: Mapping[str, Callable[[Run, click.Context], Iterable[str]]] = {
    "distro": lambda run, context: _profile_type(run, context).choices("distro"),
    "subject_format": lambda run, context: _profile_type(run, context).choices("subject-format"),
    "setting": lambda run, context: _profile_type(run, context).SETTINGS,
    "value": lambda run, context: _profile_type(run, context).choices(str(context.params.get("setting"))),
    "transports": lambda run, _: (each.TRANSPORT for each in _build_types(run)),
    "layout": lambda run, _: chain.from_iterable(each.LAYOUTS for each in _build_types(run)),
    "replace vendors": lambda run, _: chain.from_iterable(each.VENDORS for each in _build_types(run)),
    "vendors": lambda run, _: (f"{name}=" for each in _build_types(run) for name in each.VENDORS),
    "trust_package": lambda run, _: (name for name, *_ in InstalledPackages(run.setting.environment).shipping()),
    "create given": lambda run, context: (each[i:] for each in _policy(run, context).subjects() for i in (0, 1)),
    "codes": lambda *_: explanations(),
    "form": _formats,
    "permission": lambda *_: chain.from_iterable(LABELLED.values()),
    "words": _question,
    **dict.fromkeys(
        ("given", "rekey", "enclave"),
        lambda run, _: (each for name in packages(Tree(), run.workspace().src) for each in (name, subject_of(name))),
    ),
    **dict.fromkeys(("name", "names", "new_authority", "report sign"), _authorities),
    **dict.fromkeys(
        ("request name", "subject", "graph named", "namespaces"), lambda run, context: _policy(run, context).subjects()
    ),
    **dict.fromkeys(("object", "object_name", "but", "safety"), _objects),
}
"""The values by the name of the parameter, with its verb before it where others have the same name."""
