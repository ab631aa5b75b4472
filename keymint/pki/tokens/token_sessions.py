# SPDX-License-Identifier: Apache-2.0
"""PKCS #11 tokens: one session for each in a run, opened when something must be signed or a public key is unknown.

A PIN comes from a file, an environment variable, or a prompt; it is written nowhere, and no error here contains it. A
refused one is never tried again, since tokens lock themselves. ``python-pkcs11`` (the extra ``pkcs11``) is imported
on first use.
"""

from __future__ import annotations

import contextlib
import functools
import os
import stat
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from comarmor.text import did_you_mean, first_few
from keymint.api import KeySpec
from keymint.errors import KeymintError, Origin

if TYPE_CHECKING:
    from keymint.pki import keys
    from keymint.pki.tokens.pkcs11_uri import Pkcs11Uri

PROXY = "p11-kit-proxy.so"
"""The module that reaches all tokens that the system knows (p11-kit)."""
MODULE_VARIABLE = "KEYMINT_PKCS11_MODULE"
"""The environment variable that names another module."""
PIN_VARIABLE = "KEYMINT_PKCS11_PIN"
"""The environment variable of the PIN where none is named."""
PIN_MISSING, PIN_REFUSED = "token-pin-missing", "token-pin-file"
"""Codes of errors: there is no PIN; the file that has it is not usable."""
_MOST_OF_PIN = 255
"""Bytes of a PIN: the longest length that tokens return is a small number (CK_TOKEN_INFO.ulMaxPinLen)."""
_SHOWN = 4
_Place = TypeVar("_Place")
_Opened = tuple[Any, str]
"""A key or a session, with a PIN that may be asked for again."""


class Tokens:
    """The tokens that a run uses.

    Args:
        environment: environment variables.
        ask: shows a text to the user and returns what they type, unseen; None if there is no terminal.
    """

    def __init__(self, environment: Mapping[str, str], ask: Callable[[str], str] | None = None) -> None:
        self._environment = environment
        self._ask = ask
        self._modules: dict[str, Any] = {}
        self._sessions: dict[tuple[str, int], _Opened] = {}
        """Sessions by module and slot, each with the PIN for keys that ask for it again."""
        self._keys: dict[str, _Opened] = {}
        """Private keys by URI, each with the PIN if it asks for it at each signature."""
        self._failed: dict[object, KeymintError] = {}

    def private_key(self, spec: KeySpec, public: keys.PublicKey, where: Origin | None = None) -> keys.PrivateKey:
        """Return the private key that a specification names; the token is opened when it first signs.

        Args:
            spec: names the key (:attr:`keymint.api.KeySpec.uri`) and its PIN.
            public: its public key, as a certificate has it.
            where: the place of the specification, for messages.

        Raises:
            KeymintError: ``pkcs11-uri``. Signing with the key raises those of :meth:`public_key`.
        """
        from keymint.pki.tokens.pkcs11_uri import parse  # noqa: PLC0415 - few runs need it
        from keymint.pki.tokens.token_keys import token_key  # noqa: PLC0415

        parse(spec.uri, where)
        return token_key(public, functools.partial(self._sign, spec, where), where)

    def public_key(self, spec: KeySpec, where: Origin | None = None) -> keys.PublicKey:
        """Open a token, and return the public key of the private key that a specification names.

        Raises:
            KeymintError: ``pkcs11-uri``; ``pkcs11-module``: the software for tokens is missing; ``token-missing``,
                ``token-ambiguous``, ``token-pin``, ``token-key-missing``, ``token-key-ambiguous``, ``token-key-kind``
                and ``token-failed``: what is wrong with the token or the key; and those of
                :meth:`pin`.
        """
        from keymint.pki.tokens.token_objects import public_of  # noqa: PLC0415 - few runs need it

        key, _ = self._key(spec, where)
        with self._errors(spec, where):
            return public_of(key.session, key, where)

    def pin(self, token: str, file: str, variable: str, where: Origin | None = None) -> str:
        """Return the PIN of a token.

        Args:
            token: the token as messages and the prompt name it.
            file: absolute path of the file that has the PIN; empty if none is named.
            variable: name of the environment variable that has it; empty if none is named.
            where: the place that names the key, for messages.

        Raises:
            KeymintError: ``token-pin-missing``: no source has one. ``token-pin-file``: others may read the file, or it
                has no PIN.
        """
        if file:
            return _pin_in_file(file, where)
        variable = variable or PIN_VARIABLE
        pin = self._environment.get(variable, "")
        if not pin and self._ask is not None:
            pin = self._ask(f"PIN of the token {token}: ")
        if not pin:
            message = f"the environment variable {variable}, which holds the PIN of the token {token}, is not set"
            help_ = f"export {variable}=…, run it in a terminal, or name a file of mode 0600: ?pin-source=file:/path"
            raise _error(PIN_MISSING, message, where, help_)
        return pin

    def close(self) -> None:
        """Log out of all tokens, and release their modules."""
        for session, _ in self._sessions.values():
            with contextlib.suppress(RuntimeError):  # the token was removed
                session.close()
        for module in self._modules.values():
            with contextlib.suppress(RuntimeError):
                module.finalize()
        for known in (self._sessions, self._keys, self._modules, self._failed):
            known.clear()

    def _sign(self, spec: KeySpec, where: Origin | None, data: bytes, mechanism: str) -> bytes:
        key, pin = self._key(spec, where)
        import pkcs11  # noqa: PLC0415 - loaded already

        if not hasattr(key, "sign"):
            raise _error("token-key-kind", f"may not sign (CKA_SIGN): {spec.uri}", where, "name another key")
        with self._errors(spec, where):
            signature: bytes = key.sign(data, mechanism=getattr(pkcs11.Mechanism, mechanism), pin=pin or None)
        return signature

    def _key(self, spec: KeySpec, where: Origin | None) -> _Opened:
        """Return a private key, and its PIN if it asks for it at each signature."""
        from keymint.pki.tokens.pkcs11_uri import parse  # noqa: PLC0415 - few runs need it

        return self._once(self._keys, spec.uri, lambda: self._found(spec, parse(spec.uri, where), where))

    def _once(self, known: dict[_Place, _Opened], place: _Place, find: Callable[[], _Opened]) -> _Opened:
        """Return what is known, or find it; what failed, above all a wrong PIN, is not tried again."""
        if place in self._failed:
            raise self._failed[place]
        if place not in known:
            try:
                known[place] = find()
            except KeymintError as error:
                self._failed[place] = error
                raise
        return known[place]

    def _found(self, spec: KeySpec, uri: Pkcs11Uri, where: Origin | None) -> _Opened:
        module = self._module(uri, where)
        token = self._token(module, spec, uri, where)
        place = module.so, token.slot.slot_id
        session, pin = self._once(self._sessions, place, lambda: self._opened(token, spec, uri, where))
        from pkcs11 import Attribute, ObjectClass, PKCS11Error  # noqa: PLC0415 - few runs need it

        wanted = {Attribute.CLASS: ObjectClass.PRIVATE_KEY}
        wanted |= {Attribute.LABEL: uri.label} if uri.label else {}
        wanted |= {Attribute.ID: uri.id} if uri.id else {}
        with self._errors(spec, where):
            found = list(session.get_objects(wanted))
            if len(found) == 1:
                asks_again = False
                with contextlib.suppress(PKCS11Error):  # an old token does not know the attribute
                    asks_again = bool(found[0][Attribute.ALWAYS_AUTHENTICATE])
                return found[0], pin if asks_again else ""
            labels = sorted(
                {str(each.label) for each in session.get_objects({Attribute.CLASS: ObjectClass.PRIVATE_KEY})}
            )
        if found:
            ids = first_few(sorted(f"id={''.join(f'%{octet:02x}' for octet in each.id)}" for each in found), _SHOWN)
            message = f"the token {token.label!r} has {len(found)} private keys that {uri.path} may mean"
            raise _error("token-key-ambiguous", message, where, f"say which: {ids}")
        known = f"it has {first_few(labels, _SHOWN)}" if labels else "it has none; was it logged in as its user?"
        help_ = known if uri.label in labels else did_you_mean(uri.label, labels, known)
        raise _error("token-key-missing", f"the token {token.label!r} has no private key {uri.path}", where, help_)

    def _opened(self, token: Any, spec: KeySpec, uri: Pkcs11Uri, where: Origin | None) -> _Opened:
        from pkcs11 import PROTECTED_AUTH, TokenFlag  # noqa: PLC0415 - few runs need it

        with self._errors(spec, where, token.label):
            if not token.flags & TokenFlag.LOGIN_REQUIRED:
                return token.open(), ""
            if token.flags & TokenFlag.PROTECTED_AUTHENTICATION_PATH:  # the PIN is typed at the token
                return token.open(user_pin=PROTECTED_AUTH), ""
        pin = self.pin(token.label or uri.path, uri.pin_file, spec.pin_env, where)
        with self._errors(spec, where, token.label):
            return token.open(user_pin=pin.encode(errors="surrogateescape").decode("utf-8", "strict")), pin

    def _module(self, uri: Pkcs11Uri, where: Origin | None) -> Any:
        path = uri.module_path or self._environment.get(MODULE_VARIABLE, "") or PROXY
        if path in self._modules:
            return self._modules[path]
        if uri.module_path and uri.module_path != self._environment.get(MODULE_VARIABLE, ""):
            _require_system_file(uri.module_path, where)
        try:
            import pkcs11  # noqa: PLC0415 - an extra
        except ImportError:
            from keymint.api.plugin_loader import how_to_add  # noqa: PLC0415 - for this error only

            help_ = how_to_add("python-pkcs11")
            raise _error("pkcs11-module", "python-pkcs11 is not installed", where, help_) from None
        try:
            self._modules[path] = pkcs11.lib(path)
        except (pkcs11.PKCS11Error, RuntimeError) as error:
            message = f"the PKCS #11 module {path} cannot be used: {str(error) or type(error).__name__}"
            help_ = f"install p11-kit, or name the module of your token in {MODULE_VARIABLE} or ?module-path="
            raise _error("pkcs11-module", message, where, help_) from None
        return self._modules[path]

    def _token(self, module: Any, spec: KeySpec, uri: Pkcs11Uri, where: Origin | None) -> Any:
        """Return the one token that a URI identifies."""
        import pkcs11  # noqa: PLC0415 - loaded already

        present: list[Any] = []
        with self._errors(spec, where):
            for slot in module.get_slots(token_present=True):
                with contextlib.suppress(pkcs11.TokenNotPresent, pkcs11.TokenNotRecognised):
                    present.append(slot.get_token())
        found = [token for token in present if _described(token).items() >= uri.token.items()]
        if len(found) == 1:
            return found[0]
        shown = uri.path
        if found:
            serials = first_few(sorted(f"serial={_described(token)['serial']}" for token in found), _SHOWN)
            message = f"{len(found)} tokens are {shown}"
            raise _error("token-ambiguous", message, where, f"say which: {serials}")
        labels = sorted(token.label for token in present if token.label)
        known = f"{module.so} has {first_few(labels, _SHOWN)}" if labels else f"{module.so} has no tokens"
        message = f"there is no token {shown}"
        raise _error("token-missing", message, where, did_you_mean(uri.token.get("token", ""), labels, known))

    @contextlib.contextmanager
    def _errors(self, spec: KeySpec, where: Origin | None, token: str = "") -> Iterator[None]:
        """Turn the errors of a token into those of this class."""
        from pkcs11 import PKCS11Error  # noqa: PLC0415 - loaded already

        from keymint.pki.tokens.pkcs11_uri import parse  # noqa: PLC0415
        from keymint.pki.tokens.token_objects import token_error  # noqa: PLC0415

        try:
            yield
        except PKCS11Error as error:
            found = token_error(error, token or parse(spec.uri).path, where)
            self._failed[spec.uri] = found
            self._keys.pop(spec.uri, None)
            raise found from None
        except UnicodeError:
            raise _error("token-pin", "the PIN is not UTF-8", where, "correct it") from None


def _error(code: str, message: str, where: Origin | None, help_: str) -> KeymintError:
    return KeymintError(message, where=where, help=help_, code=code)


def _described(token: Any) -> Mapping[str, str]:
    """Return what identifies a token and its slot, by the names of RFC 7512."""
    return {
        "token": token.label,
        "serial": token.serial.rstrip(b"\0").decode(errors="replace"),
        "manufacturer": token.manufacturer_id,
        "model": token.model,
        "slot-id": str(token.slot.slot_id),
        "slot-description": token.slot.slot_description,
        "slot-manufacturer": token.slot.manufacturer_id,
    }


def _require_system_file(path: str, where: Origin | None) -> None:
    """Require that only the administrator wrote a module that a source document names.

    Its code runs in this process (RFC 7512, section 6), and a document may come from somebody else.
    """
    try:
        status = os.stat(path)  # noqa: PTH116 - the path is a text
    except OSError as error:
        message = f"the PKCS #11 module {path} cannot be read: {error.strerror}"
        raise _error("pkcs11-module", message, where, "install it, or correct module-path") from None
    if status.st_uid != 0 or stat.S_IMODE(status.st_mode) & 0o022:
        message = f"the PKCS #11 module {path} may have been written by others than the administrator"
        help_ = f"check it, and confirm it: export {MODULE_VARIABLE}={path}"
        raise _error("pkcs11-module", message, where, help_)


# -- PINs ------------------------------------------------------------------------------------------------------------


def _pin_in_file(path: str, where: Origin | None) -> str:
    """Return the PIN of a file, without the end of its line."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as opened:
            status = os.fstat(descriptor)
            problem = _file_problem(status)
            content = b"" if problem else opened.read(_MOST_OF_PIN + 2)
    except OSError as error:
        problem, content = f"cannot be read: {error.strerror}", b""
    lines = content.splitlines()
    if not problem and (len(lines) != 1 or not 0 < len(lines[0]) <= _MOST_OF_PIN):
        problem = f"is not one line with a PIN of at most {_MOST_OF_PIN} bytes"
    try:
        pin = lines[0].decode() if lines else ""
    except UnicodeDecodeError:
        problem = problem or "is not UTF-8"
    if problem:
        help_ = f"write the PIN into a file of yours, and run: chmod 600 {path}"
        raise _error(PIN_REFUSED, f"the PIN file {path} {problem}", where, help_)
    return pin


def _file_problem(status: os.stat_result) -> str:
    """Return why a PIN must not be read from a file, or an empty text."""
    if not stat.S_ISREG(status.st_mode):
        return "is not a regular file"
    if status.st_uid not in {os.geteuid(), 0}:
        return "belongs to another user"
    mode = stat.S_IMODE(status.st_mode)
    return f"has mode {mode:04o}, so others may read or change it; expected 0600" if mode & 0o077 else ""
