"""Signatures of bundles (Ed25519): who exported a bundle, and that nothing in it was changed since.

The digests in bundle.json reveal damage. They do not reveal a forgery, which may have new digests. A
signature covers bundle.json, and with it the digests of all other files. Public keys are lines such as
`ssh-ed25519 AAAA... name`, so `ssh-keygen -t ed25519` makes keys too. The package `cryptography` computes and
verifies signatures.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from deepbots_robot.model import BundleError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

_CONTEXT = b"deepbots bundle 1\n"
"""The prefix of the signed bytes, so that a signature for another purpose is not a signature of a bundle."""
_MAX_KEY_BYTES = 100_000
_KIND = "ssh-ed25519"


class KeyFileError(Exception):
    """The error for a key that cannot be read or written, in one sentence."""


class Signature(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `bundle.sig`.

    Attributes:
        key: The public key, as `ssh-ed25519 AAAA...`.
        signature: The signature in base64.
    """

    format: int
    key: str
    signature: str


def write_key(path: Path) -> Path:
    """Write a new private key that only its owner can read; returns the file of the public key beside it.

    Raises:
        KeyFileError: One of the files exists or cannot be written, or `cryptography` is missing.
    """
    private = _private_key_class().generate()
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    public = path.with_name(f"{path.name}.pub")
    secret = private.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption())
    try:
        for file, content, mode in (
            (path, secret, 0o600),
            (public, f"{_line(private.public_key())}\n".encode(), 0o644),
        ):
            with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as stream:
                stream.write(content)
    except FileExistsError as error:
        raise KeyFileError(f"{error.filename} exists; a key is never overwritten") from error
    except OSError as error:
        raise KeyFileError(f"{error.filename} cannot be written: {error.strerror}") from error
    return public


def sign(description: bytes, key: Path) -> bytes:
    """Return the content of `bundle.sig` for a bundle.json.

    Raises:
        KeyFileError: The file has no Ed25519 key without a password, or `cryptography` is missing.
    """
    private_key = _private_key_class()
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_ssh_private_key

    content = _read_key_file(key)
    load_key = load_ssh_private_key if b"OPENSSH PRIVATE KEY" in content else load_pem_private_key
    try:
        private = load_key(content, password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:  # a TypeError: a password is required
        raise KeyFileError(f"{key} is not a private key without a password") from error
    if not isinstance(private, private_key):
        raise KeyFileError(f"{key} is a key of another kind; make one with: deepbots export --new-key FILE")
    signed = base64.b64encode(private.sign(_CONTEXT + description)).decode()
    return msgspec.json.encode(Signature(1, _line(private.public_key()), signed)) + b"\n"


def keys_of(trusted: str | Path | Sequence[str]) -> tuple[str, ...]:
    """Return public keys as `ssh-ed25519 AAAA...`, from lines or from a file with one key per line.

    Raises:
        BundleError: There is no key, or a line is not a key; or `cryptography` is missing.
    """
    if find_spec("cryptography") is None:
        raise BundleError(
            "checking a signature needs cryptography, which is not installed; install it with: pip install"
            " cryptography"
        )
    if isinstance(trusted, str | Path):
        try:
            lines = _read_key_file(Path(trusted)).decode().splitlines()
        except (KeyFileError, UnicodeDecodeError) as error:
            raise BundleError(f"the trusted keys cannot be read: {error}") from error
    else:
        lines = list(trusted)
    keys = []
    for line in lines:
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 2 or words[0] != _KIND:
            raise BundleError(
                f"{line[:40]!r} is not a trusted key; write a line such as `{_KIND} AAAA... name`"
            )
        keys.append(f"{words[0]} {words[1]}")
    if not keys:
        raise BundleError("there is no trusted key")
    return tuple(keys)


def verify(description: bytes, content: bytes, trusted: Sequence[str]) -> None:
    """Check that a bundle.json is signed with a trusted key.

    Raises:
        BundleError: The signature is damaged, that of another file, or of a key that is not trusted.
    """
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_ssh_public_key

    try:
        signed = msgspec.json.decode(content, type=Signature)
        signature = base64.b64decode(signed.signature, validate=True)
    except (msgspec.DecodeError, ValueError) as error:
        raise BundleError("bundle.sig is damaged") from error
    if signed.key not in trusted:
        raise BundleError("it is signed with a key that is not trusted")
    try:
        key = load_ssh_public_key(next(line for line in trusted if line == signed.key).encode())
        _public_key(key).verify(signature, _CONTEXT + description)
    except (ValueError, UnsupportedAlgorithm) as error:
        raise BundleError("a trusted key is damaged") from error
    except InvalidSignature as error:
        raise BundleError("bundle.json is not the file that was signed") from error


def _public_key(key: object) -> Ed25519PublicKey:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    if not isinstance(key, Ed25519PublicKey):
        raise ValueError
    return key


def _private_key_class() -> type[Ed25519PrivateKey]:
    if find_spec("cryptography") is None:
        raise KeyFileError(
            "signing needs cryptography, which is not installed; install it with: pip install cryptography"
        )
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    return Ed25519PrivateKey


def _line(key: Ed25519PublicKey) -> str:
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return key.public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH).decode()


def _read_key_file(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise KeyFileError(f"{path} is not a file")
        with path.open("rb") as file:
            content = file.read(_MAX_KEY_BYTES + 1)
    except OSError as error:
        raise KeyFileError(f"{path} cannot be read: {error.strerror}") from error
    if len(content) > _MAX_KEY_BYTES:
        raise KeyFileError(f"{path} is too large for keys")
    return content
