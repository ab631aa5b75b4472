# SPDX-License-Identifier: Apache-2.0
"""Read captures of RTI Admin Console: XML of the participants it discovered, with publications and subscriptions.

The document nests ``system/processes//domain_participants``; each participant holds ``participant_data`` (the sample
of ``DCPSParticipant``), ``publications`` and ``subscriptions`` (samples of ``DCPSPublication``, ``DCPSSubscription``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from lxml import etree

from comarmor.text import lazy_regex, quote
from comarmor.xml.reader import line, parse
from keymint.api import DiscoveredGraph
from keymint.api.graph_json import MAX_DOMAIN
from keymint.errors import KeymintError, Origin
from keymint_ros2_dds.discovery.capture import DiscoveredEndpoint, DiscoveredParticipant, discovered_graph

_NUMBER = lazy_regex(r"[0-9]{1,9}")
_HEX = lazy_regex(r"[0-9a-f]{1,2}(?:,\s*[0-9a-f]{1,2})*\Z", re.IGNORECASE)
_ENDPOINTS = {"publication_data": "publish", "subscription_data": "subscribe"}


def recognises(content: bytes) -> bool:
    """Tell whether a file looks like XML, and so may be a capture."""
    return content.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"<"


def read(content: bytes, name: str, names: Mapping[str, str]) -> DiscoveredGraph:
    """Return the graph of a capture.

    Args:
        content: the XML document.
        name: its file as the user would type it, for messages.
        names: subjects that the user gives, by GUID or the beginning of one.

    Raises:
        KeymintError: not well-formed, too large, with a DOCTYPE, or no such capture; with ``file:line``.
    """
    root, export = parse(content, name), "export the system from RTI Admin Console"
    if root.tag != "system":
        raise _error(name, root, f"the root is <{root.tag}>, expected <system>", export)
    participants = {each.guid: each for each in (_participant(name, data) for data in root.iter("participant_data"))}
    endpoints: dict[DiscoveredEndpoint, None] = {}
    for data in (data for tag in _ENDPOINTS for data in root.iter(tag)):
        endpoint = _endpoint(name, data)
        if endpoint.participant not in participants:
            message = f"the participant {endpoint.participant} of this endpoint is not in the file"
            raise _error(name, data, message)
        endpoints[endpoint] = None
    if not participants:
        raise _error(name, root, "no participant in this file", export)
    return discovered_graph(participants.values(), endpoints, names)


def _error(file: str, element: etree._Element, message: str, hint: str = "") -> KeymintError:
    return KeymintError(message, where=Origin(file, line(element)), help=hint, code="capture")


def _participant(file: str, data: etree._Element) -> DiscoveredParticipant:
    above = data.getparent()
    found = data.findtext("domain_id") or (above.findtext("domain_id") if above is not None else None) or "0"
    domain = found.strip()
    if not _NUMBER.fullmatch(domain) or int(domain) > MAX_DOMAIN:
        raise _error(file, data, f"domain_id is {quote(domain)}, expected a DDS domain id from 0 to {MAX_DOMAIN}")
    guid, name, text = _guid(file, data, "key"), _text(data, "participant_name/name"), _text(data, "user_data/value")
    # User data is written as hexadecimal octets or as text.
    user_data = bytes(int(octet, 16) for octet in text.split(",")) if _HEX.match(text) else text.encode()
    return DiscoveredParticipant(guid, int(domain), name, user_data)


def _endpoint(file: str, data: etree._Element) -> DiscoveredEndpoint:
    topic = _text(data, "topic_name")
    if not topic:
        raise _error(file, data, f"<{data.tag}> has no <topic_name>")
    partitions = tuple((each.text or "").strip() for each in data.iterfind("partition/name/element"))
    participant, permission = _guid(file, data, "participant_key"), _ENDPOINTS[str(data.tag)]
    return DiscoveredEndpoint(participant, permission, topic, _text(data, "type_name"), partitions)


def _guid(file: str, data: etree._Element, key: str) -> str:
    """Return a key as 32 digits; it is written as four hexadecimal numbers of 32 bits."""
    words = (data.findtext(f"{key}/value") or "").split(",")
    try:
        numbers = [int(word, 16) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or any(not 0 <= number < 2**32 for number in numbers):  # noqa: PLR2004 - see above
        raise _error(file, data, f"<{key}> is {','.join(words)!r}, expected four hexadecimal numbers")
    return "".join(f"{number:08x}" for number in numbers)


def _text(data: etree._Element, path: str) -> str:
    return (data.findtext(path) or "").strip()
