# SPDX-License-Identifier: Apache-2.0
"""Enclaves and a router's file made of real certificates, and inspections of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any

from keymint_ros2_zenoh import build_type

from keymint.api import (
    BuildOptions,
    CertificateSpec,
    Credentials,
    Inspection,
    Package,
    SigningAuthority,
    Validity,
)
from keymint.pki import certificates, keys

from .workspaces import ORIGIN, P256, VALIDITY

NOW = datetime(2027, 1, 1, tzinfo=UTC)
OPTIONS = BuildOptions()
_LONG = Validity(VALIDITY.not_before - timedelta(days=2), VALIDITY.not_after + timedelta(days=3650))


@cache
def authority(name: str) -> certificates.Issuer:
    key = keys.generate(P256)
    spec = CertificateSpec(f"CN={name}", _LONG, None, "", "SHA256", P256, (), ORIGIN)
    return certificates.Issuer(certificates.issue(spec, key.public_key(), key, authority=True).certificate, key)


def pem(name: str) -> bytes:
    return certificates.to_pem(authority(name).certificate)


def signer(name: str = "permissions_ca") -> SigningAuthority:
    return SigningAuthority(name, pem(name), keys.to_pem(authority(name).key))


def credentials(package: Package, identity: str = "identity_ca") -> Credentials:
    key = keys.generate(package.identity.key)
    issued = certificates.issue(package.identity, key.public_key(), authority(identity), authority=False)
    return Credentials(
        {"identity": pem(identity), "access": pem("permissions_ca")},
        {"access": signer()},
        certificates.to_pem(issued.certificate),
        keys.to_pem(key),
    )


def installed(package: Package, **changed: Any) -> dict[str, bytes]:
    """Return the files of an enclave."""
    documents = build_type.build(package, OPTIONS).documents
    secrets = replace(credentials(package), **changed)
    artifacts = build_type.install(package, documents, secrets, "sros2", {})
    return {name: artifact.content for name, artifact in artifacts.items()}


def inspection(package: Package, files: Mapping[str, bytes], **fields: Any) -> Inspection:
    documents = build_type.build(package, OPTIONS).documents
    chains = {"identity": pem("identity_ca"), "access": pem("permissions_ca")}
    usual = Inspection([package], documents, files, f"install/enclaves{package.subject}", "sros2", chains, NOW, 0)
    return replace(usual, **fields)


def shared(packages: Sequence[Package], by: str = "permissions_ca") -> dict[str, bytes]:
    """Return the router's file with its signature."""
    documents = build_type.build_shared(packages, OPTIONS).documents
    secrets = Credentials({"access": signer(by).certificate}, {"access": signer(by)})
    artifacts = build_type.install_shared(packages, documents, secrets, "sros2", {})
    return {name: artifact.content for name, artifact in artifacts.items()}


def shared_inspection(packages: Sequence[Package], files: Mapping[str, bytes], **fields: Any) -> Inspection:
    documents = build_type.build_shared(packages, OPTIONS).documents
    chains = {"identity": pem("identity_ca"), "access": pem("permissions_ca")}
    return replace(Inspection(packages, documents, files, "install", "sros2", chains, NOW, 0), **fields)
