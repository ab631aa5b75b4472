# SPDX-License-Identifier: Apache-2.0
"""The record of one case: each command with all that it printed, and all files that it changed."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .checkout import NOW, Checkout, Result
from .shown import Volatile

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
"""The examples of the checkout that this driver is in: all checkouts get the same."""
DAY = 86_400


class Steps:
    """Runs the commands of a case in a folder of its own, and records them.

    Args:
        checkout: runs the commands.
        folder: the folder, which is empty.
        files: record the files that commands change; their modes and contents.
    """

    def __init__(self, checkout: Checkout, folder: Path, *, files: bool = True) -> None:
        self.folder = folder
        self.steps: list[dict[str, Any]] = []
        self._checkout = checkout
        self._files = files
        names = {str(folder): "<work>", str(checkout.metadata): "<metadata>", str(checkout.root): "<checkout>"}
        names |= {sys.prefix: "<prefix>", str(EXAMPLES.parent): "<checkout>"}
        self._volatile = Volatile(folder, names)
        (folder / "home").mkdir()

    # -- commands ------------------------------------------------------------------------------------------------

    def run(
        self, *words: object, days: int = 0, env: Mapping[str, str] | None = None, stdin: str = "", label: str = "",
        cwd: str = "",
    ) -> Result:  # fmt: skip
        """Run a command, and record it.

        Args:
            words: its arguments.
            days: when: after the first day.
            env: more variables.
            stdin: its standard input.
            label: tells the step from others with the same arguments.
            cwd: run it in this folder of the case.
        """
        argv = [str(word) for word in words]
        before = self._volatile.tree() if self._files else {}
        if cwd:
            env = {"HOME": str(self.folder / "home"), **(env or {})}
        result = self._checkout.run(argv, self.folder / cwd, env, stdin, now=NOW + days * DAY)
        after = self._volatile.tree()
        step: dict[str, Any] = {"argv": [self._volatile.text(word) for word in argv], "label": label, "days": days}
        step |= {"exit": result.code, "err": self._volatile.text(result.err).splitlines()}
        document = _document(result.out)
        if document is None:
            step["out"] = self._volatile.text(result.out).splitlines()
        else:
            step["json"] = self._volatile.value(document)
            found = document.get("diagnostics", []) if isinstance(document, dict) else []
            step["codes"] = sorted(f"{each.get('severity')} {each.get('code')}" for each in found)
        if self._files:
            changed = {path: entry for path, entry in after.items() if before.get(path) != entry}
            step["files"] = {**dict.fromkeys(sorted(before.keys() - after.keys())), **changed}
        self.steps.append(step)
        return result

    def both(self, *words: object, **options: Any) -> None:
        """Run a command that reads, in words and with ``--json``."""
        self.run(*words, **options)
        self.run(*words, "--json", **options)

    # -- what somebody does by hand ------------------------------------------------------------------------------

    def write(self, path: str, content: str | bytes) -> Path:
        """Write a file."""
        place = self.folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content.encode() if isinstance(content, str) else content)
        return place

    def edit(self, path: str, old: str, new: str) -> None:
        """Replace a text in a file; a file that has not this text gets a blank line, so that the case goes on."""
        place = self.folder / path
        text = place.read_text()
        place.write_text(text.replace(old, new) if old in text else f"{text}\n")

    def example(self, name: str) -> str:
        """Copy a folder of the examples; return its name."""
        shutil.copytree(EXAMPLES / name, self.folder / "examples" / name)
        return f"examples/{name}"

    def copy(self, source: str, target: str) -> None:
        """Copy a file or a folder over another one."""
        self.remove(target)
        if (self.folder / source).is_dir():
            shutil.copytree(self.folder / source, self.folder / target, symlinks=True)
        else:
            shutil.copyfile(self.folder / source, self.folder / target)

    def remove(self, path: str) -> None:
        """Remove a file or a folder, if it is there."""
        place = self.folder / path
        if place.is_dir() and not place.is_symlink():
            shutil.rmtree(place)
        else:
            place.unlink(missing_ok=True)

    def chmod(self, path: str, mode: int) -> None:
        """Change the mode of a file."""
        (self.folder / path).chmod(mode)

    def link(self, path: str, target: str) -> None:
        """Put a link in the place of a file."""
        self.remove(path)
        (self.folder / path).symlink_to(target)


Case = Callable[[Steps], None]


def _document(text: str) -> Any:
    """Return the JSON document that a command printed; None for a text."""
    if not text.startswith(("{", "[")):
        return None
    try:
        return json.loads(text)
    except ValueError:
        return None
