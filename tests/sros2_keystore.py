# SPDX-License-Identifier: Apache-2.0
"""Keystores in the form that ``ros2 security`` gives them, made from a policy without any code of Keymint.

Layout, names, modes, extensions, dates and texts are those of sros2 0.13 (``sros2/keystore``, ``sros2/_utilities``, the
stylesheet ``permissions.xsl``); for the flat layout those of Eloquent (``sros2/api``); for RTI those of its security
guide. What SROS2 is known to do differently from what one expects, it does here as well.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, pkcs7
from cryptography.x509.oid import NameOID
from lxml import etree

DAYS = 3650
"""How long certificates are valid, in days."""
OLD_PERIOD = ("2013-10-26T00:00:00", "2023-10-26T22:45:30")
"""The period of every grant before Foxy, whatever the certificate says."""
_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_SCHEMAS = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_"
_QUALIFIERS = ("publish", "subscribe", "request", "reply", "call", "execute")
"""The attributes of lists, in the order of the stylesheet."""
_SERVICES = ("cancel_goal", "get_result", "send_goal")
_DOMAIN_RULE = (
    ("allow_unauthenticated_participants", "false"),
    ("enable_join_access_control", "true"),
    ("discovery_protection_kind", "ENCRYPT"),
    ("liveliness_protection_kind", "ENCRYPT"),
    ("rtps_protection_kind", "SIGN"),
)
_TOPIC_FLAGS = tuple(
    f"enable_{each}" for each in ("discovery_protection", "liveliness_protection", "read_access_control",
    "write_access_control")
)  # fmt: skip


@dataclass(frozen=True)
class Form:
    """How a keystore differs from that of ``ros2 security`` with its defaults.

    Attributes:
        domain: domain of the grants: ``ROS_DOMAIN_ID`` of the shell that made the enclaves.
        governance_domain: the same of the shell that made the keystore; None for the same domain.
        graph: made with an RMW that has the graph's topic.
        two: two authorities in place of one (SROS2 takes over those that are there).
        zone: dates of grants have a zone, as later versions write them.
        layout: ``sros2``, ``flat`` (before Foxy) or ``rti``.
        period: the period of all grants, in place of the certificate's.
        days: how long certificates are valid, in days from ``now``.
        now: when it is made.
        seconds_later: how much later than the authorities the enclaves are made.
        common_names: common names of certificates, by enclave, where they are not the path.
    """

    domain: int = 0
    governance_domain: int | None = None
    graph: bool = True
    two: bool = False
    zone: bool = False
    layout: str = "sros2"
    period: tuple[str, str] | None = None
    days: int = DAYS
    now: datetime = datetime(2026, 1, 1, tzinfo=UTC)
    seconds_later: int = 0
    common_names: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Credential:
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    def write(self, certificate: Path, key: Path) -> None:
        _write(certificate, self.certificate.public_bytes(Encoding.PEM))
        _write(key, self.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))

    def sign(self, content: bytes) -> bytes:
        builder = pkcs7.PKCS7SignatureBuilder().set_data(content)
        options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
        return builder.add_signer(self.certificate, self.key, hashes.SHA256()).sign(Encoding.SMIME, options)


def make(root: Path, policy: str, form: Form | None = None) -> tuple[str, ...]:
    """Make a keystore.

    Args:
        root: its folder, which must not exist.
        policy: an SROS2 policy without includes, of version 0.2.0 or 0.1.0.
        form: how it is made.

    Returns:
        The paths of its enclaves.
    """
    form = form or Form()
    enclaves = _enclaves(etree.fromstring(policy))
    _folder(root)
    {"sros2": _of_sros2, "flat": _flat, "rti": _of_rti}[form.layout](root, enclaves, form)
    return tuple(enclaves)


def governance(domain: int) -> bytes:
    """Return the governance document of SROS2: its default file, with the domain set."""
    topic_rule = [("topic_expression", "*"), *((flag, "true") for flag in _TOPIC_FLAGS)]
    topic_rule += [("metadata_protection_kind", "ENCRYPT"), ("data_protection_kind", "ENCRYPT")]
    lines = [
        f'<dds xmlns:xsi="{_XSI}"', f'    xsi:noNamespaceSchemaLocation="{_SCHEMAS}governance.xsd">',
        "    <domain_access_rules>", "        <domain_rule>",
        "            <domains>", f"              <id>{domain}</id>", "            </domains>",
        *(f"            <{tag}>{text}</{tag}>" for tag, text in _DOMAIN_RULE),
        "            <topic_access_rules>", "                <topic_rule>",
        *(f"                    <{tag}>{text}</{tag}>" for tag, text in topic_rule),
        "                </topic_rule>", "            </topic_access_rules>",
        "        </domain_rule>", "    </domain_access_rules>", "</dds>", "",
    ]  # fmt: skip
    return "\n".join(lines).encode()


def permissions(
    enclaves: Mapping[str, Sequence[etree._Element]], period: tuple[str, str], domain: int = 0, *, graph: bool = True
) -> bytes:
    """Return a permissions document as SROS2 writes it.

    Args:
        enclaves: the ``<profiles>`` of each enclave by path: a grant for each.
        period: begin and end of the grants, as text.
        domain: the domain of all rules.
        graph: allow ``ros_discovery_info``.
    """
    root = etree.Element("dds", nsmap={"xsi": _XSI})
    root.set(f"{{{_XSI}}}noNamespaceSchemaLocation", f"{_SCHEMAS}permissions.xsd")
    holder = etree.SubElement(root, "permissions")
    for path, groups in enclaves.items():
        for group in groups:
            grant = etree.SubElement(holder, "grant", name=path)
            etree.SubElement(grant, "subject_name").text = f"CN={path}"
            validity = etree.SubElement(grant, "validity")
            for tag, date in zip(("not_before", "not_after"), period, strict=True):
                etree.SubElement(validity, tag).text = date
            for tag, qualifier in (("deny_rule", "DENY"), ("allow_rule", "ALLOW")):
                found = [each for each in group.iterfind("profile/*") if qualifier in each.attrib.values()]
                if found:
                    _rule(grant, tag, domain, [pair for each in found for pair in _topics(each, qualifier)])
            if graph:
                pairs = [(action, ["ros_discovery_info"]) for action in ("publish", "subscribe")]
                _rule(grant, "allow_rule", domain, pairs)
            etree.SubElement(grant, "default").text = "DENY"
    return etree.tostring(root, pretty_print=True)


def enclaves_of(policy: str) -> Mapping[str, Sequence[etree._Element]]:
    """Return the ``<profiles>`` of each enclave of a policy without includes."""
    return _enclaves(etree.fromstring(policy))


def _enclaves(root: etree._Element) -> dict[str, list[etree._Element]]:
    """Return the ``<profiles>`` by enclave; in version 0.1.0 each node has its own."""
    found: dict[str, list[etree._Element]] = {}
    for enclave in root.iterfind("enclaves/enclave"):
        found[enclave.attrib["path"]] = enclave.findall("profiles")
    for profile in root.findall("profiles/profile"):
        group = etree.Element("profiles")
        group.append(profile)
        found[f"{profile.attrib['ns'].rstrip('/')}/{profile.attrib['node']}"] = [group]
    return found


def _rule(grant: etree._Element, tag: str, domain: int, lists: Sequence[tuple[str, Sequence[str]]]) -> None:
    """Add a rule: lists are sorted by their first topic, and what came before is left out."""
    rule = etree.SubElement(grant, tag)
    etree.SubElement(etree.SubElement(rule, "domains"), "id").text = str(domain)
    for action in ("publish", "subscribe"):
        sorted_lists = sorted((topics for each, topics in lists if each == action), key=lambda topics: topics[0])
        names = dict.fromkeys(name for topics in sorted_lists for name in topics)
        if names:
            holder = etree.SubElement(etree.SubElement(rule, action), "topics")
            for name in names:
                etree.SubElement(holder, "topic").text = name


def _topics(rules: etree._Element, qualifier: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the lists of DDS topics of a list, each with what may be done."""
    node = rules.getparent()
    assert node is not None
    names = [_resolved(node.attrib["ns"], node.attrib["node"], entry.text or "") for entry in rules.iterfind("*")]
    for attribute in _QUALIFIERS:
        if rules.get(attribute) != qualifier or not names:
            continue
        if rules.tag == "topics":
            yield attribute, [f"rt{name}" for name in names]
            continue
        asks = attribute in {"request", "call"}
        out, back = ("publish", "subscribe") if asks else ("subscribe", "publish")
        if rules.tag == "services":
            yield out, [f"rq{name}Request" for name in names]
            yield back, [f"rr{name}Reply" for name in names]
            continue
        yield out, [f"rq{name}/_action/{each}Request" for name in names for each in _SERVICES]
        replies = (*(("rr", f"{each}Reply") for each in _SERVICES), ("rt", "feedback"), ("rt", "status"))
        yield back, [f"{prefix}{name}/_action/{end}" for name in names for prefix, end in replies]


def _resolved(ns: str, node: str, name: str) -> str:
    base = ns if ns.endswith("/") else f"{ns}/"
    if name.startswith("/"):
        return name
    return f"{base}{node}{name[1:]}" if name.startswith("~") else f"{base}{name}"


def _of_sros2(root: Path, enclaves: Mapping[str, Sequence[etree._Element]], form: Form) -> None:
    """Make the layout of Foxy and later: links in ``public``, ``private`` and in every enclave."""
    public, private, folder = (_folder(root / name) for name in ("public", "private", "enclaves"))
    if form.two:
        authorities = [_authority("sros2CA", form), _authority("sros2CA", form)]
        for name, each in zip(("identity_ca", "permissions_ca"), authorities, strict=True):
            each.write(public / f"{name}.cert.pem", private / f"{name}.key.pem")
    else:
        authorities = [_authority("sros2CA", form)] * 2
        authorities[0].write(public / "ca.cert.pem", private / "ca.key.pem")
        for name in ("permissions_ca", "identity_ca"):
            (public / f"{name}.cert.pem").symlink_to("ca.cert.pem")
            (private / f"{name}.key.pem").symlink_to("ca.key.pem")
    issuer, signer = authorities
    _signed(folder, "governance", governance(_governance_domain(form)), signer)
    for path, groups in enclaves.items():
        place = _folder(folder / path.lstrip("/"))
        for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
            (place / name).symlink_to(os.path.relpath(public / name, place))
        if place != folder:
            (place / "governance.p7s").symlink_to(os.path.relpath(folder / "governance.p7s", place))
        _enclave(place, path, groups, issuer, signer, form)


def _flat(root: Path, enclaves: Mapping[str, Sequence[etree._Element]], form: Form) -> None:
    """Make the layout of Eloquent and before: one authority at the top, governance as a copy."""
    authority = _authority("sros2testCA", form)
    authority.write(root / "ca.cert.pem", root / "ca.key.pem")
    _signed(root, "governance", governance(_governance_domain(form)), authority)
    for path, groups in enclaves.items():
        place = _folder(root / path.lstrip("/"))
        for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
            (place / name).symlink_to(os.path.relpath(root / "ca.cert.pem", place))
        _write(place / "governance.p7s", (root / "governance.p7s").read_bytes())
        _enclave(place, path, groups, authority, authority, form)


def _of_rti(root: Path, enclaves: Mapping[str, Sequence[etree._Element]], form: Form) -> None:
    """Make the files that RTI's guide makes with openssl: no folders of participants, and no unsigned copies there."""
    identity, signer = _authority("Identity CA", form), _authority("Permissions CA", form)
    cert, xml = _folder(root / "cert"), _folder(root / "xml")
    identity.write(cert / "identity_ca.pem", _folder(root / "private") / "identity_ca_key.pem")
    signer.write(cert / "permissions_ca.pem", root / "private" / "permissions_ca_key.pem")
    _write(xml / "governance.p7s", signer.sign(governance(_governance_domain(form))))
    for path, groups in enclaves.items():
        name = path.strip("/").replace("/", "_")
        own = _identity(form.common_names.get(path, path), identity, form)
        own.write(cert / f"{name}.pem", cert / f"{name}_key.pem")
        document = permissions({path: groups}, _period(own, form), form.domain, graph=form.graph)
        _write(xml / f"permissions_{name}.p7s", signer.sign(document))


def _enclave(
    place: Path, path: str, groups: Sequence[etree._Element], issuer: _Credential, signer: _Credential, form: Form
) -> None:
    own = _identity(form.common_names.get(path, path), issuer, form)
    own.write(place / "cert.pem", place / "key.pem")
    graph = form.graph and form.layout == "sros2"
    _signed(place, "permissions", permissions({path: groups}, _period(own, form), form.domain, graph=graph), signer)


def _governance_domain(form: Form) -> int:
    return form.domain if form.governance_domain is None else form.governance_domain


def _period(own: _Credential, form: Form) -> tuple[str, str]:
    if form.period:
        return form.period
    if form.layout == "flat":
        return OLD_PERIOD
    dates = (own.certificate.not_valid_before_utc, own.certificate.not_valid_after_utc)
    begin, end = (date.isoformat() if form.zone else date.replace(tzinfo=None).isoformat() for date in dates)
    return begin, end


def _authority(common_name: str, form: Form) -> _Credential:
    return _certificate(common_name, None, form)


def _identity(common_name: str, issuer: _Credential, form: Form) -> _Credential:
    return _certificate(common_name, issuer, form)


def _certificate(common_name: str, issuer: _Credential | None, form: Form) -> _Credential:
    """Return a key and its certificate: basic constraints are the only extension, critical in authorities only."""
    key = ec.generate_private_key(ec.SECP256R1())
    # SROS2 issues names that are longer than X.520 allows, which cryptography refuses by now.
    with warnings.catch_warnings(action="ignore"):
        common_names = common_name.split("+")  # several make a name that no tool of ROS makes
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, each, _validate=False) for each in common_names])
    begin = form.now + timedelta(seconds=form.seconds_later if issuer else 0)
    constraints = x509.BasicConstraints(ca=issuer is None, path_length=1 if issuer is None else None)
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(issuer.certificate.subject if issuer else name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(begin + timedelta(days=form.days))
        .add_extension(constraints, critical=issuer is None)
    )
    return _Credential(builder.sign(issuer.key if issuer else key, hashes.SHA256()), key)


def _signed(folder: Path, name: str, content: bytes, signer: _Credential) -> None:
    _write(folder / f"{name}.xml", content)
    _write(folder / f"{name}.p7s", signer.sign(content))


def _folder(path: Path) -> Path:
    """Make a folder that everyone may read, as an ordinary umask gives it."""
    missing = [each for each in (path, *path.parents) if not each.exists()]
    path.mkdir(parents=True, exist_ok=True)
    for each in missing:
        each.chmod(0o755)
    return path


def _write(path: Path, content: bytes) -> None:
    """Write a file that everyone may read, keys included: SROS2 leaves that to the umask."""
    path.write_bytes(content)
    path.chmod(0o644)
