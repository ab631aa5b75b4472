# SPDX-License-Identifier: Apache-2.0
"""The keys of ROS names: what rmw_zenoh 0.1 (Humble) to 0.12 (Rolling) uses.

The topic or service ``/a/b`` has the key ``<domain>/a/b/<type>/<hash>``. Beside it, a publisher or subscriber that is
``transient_local`` uses ``<key>/@adv/…``. A token of the graph is
``@ros2_lv/<domain>/<session>/<node>/<entity>/<kind>/<enclave>/…``, where ``%`` replaces each ``/`` of the enclave.
"""

from __future__ import annotations

from enum import StrEnum

from comarmor.text import did_you_mean
from keymint.errors import KeymintError
from keymint_ros2_zenoh.keyexpr.key_expr import ANY_CHUNK, ANY_CHUNKS, KeyExpr, of_chunks

DISTROS = ("humble", "jazzy", "kilted", "lyrical", "rolling")
"""Distributions that have rmw_zenoh."""
TYPE_AND_HASH = (ANY_CHUNK, ANY_CHUNK)
"""The last two chunks of a key: access control does not depend on them."""
ADVANCED = "@adv"
GRAPH = "@ros2_lv"
_TOKEN_IDS = (ANY_CHUNK,) * 4
"""Session, node, entity, and kind of entity."""
TOKEN_ENCLAVE = 2 + len(_TOKEN_IDS)
"""Index of the enclave among the chunks of a token."""


def check_distro(distro: str) -> None:
    """Raise an error for a distribution that has no rmw_zenoh.

    Raises:
        KeymintError: it has none.
    """
    if distro not in DISTROS:
        raise KeymintError(
            f"ROS 2 {distro.capitalize()} has no rmw_zenoh, which this build type is for",
            help=did_you_mean(distro, DISTROS, f"use one of {', '.join(DISTROS)}, or the build type of DDS"),
            code="zenoh-distro",
        )


class Place(StrEnum):
    """Which keys of a name: those of its data, or those beside them that serve ``transient_local``."""

    DATA = "data"
    ADVANCED = "advanced"


def name_key(domain: int, name: KeyExpr, place: Place = Place.DATA) -> KeyExpr:
    """Return the keys of topics or services in a domain.

    Args:
        domain: the domain id.
        name: ROS names without the leading ``/``.
        place: which of their keys.
    """
    beside = () if place is Place.DATA else (ADVANCED, ANY_CHUNKS)
    return of_chunks((str(domain), *name.chunks, *TYPE_AND_HASH, *beside))


def graph_key(domain: int) -> KeyExpr:
    """Return the keys of all tokens of the graph in a domain."""
    return of_chunks((GRAPH, str(domain), ANY_CHUNKS))


def own_tokens_key(domain: int, subject: str) -> KeyExpr:
    """Return the keys of the tokens of an enclave, which only nodes that are started in it use."""
    return of_chunks((GRAPH, str(domain), *_TOKEN_IDS, subject.replace("/", "%"), ANY_CHUNKS))
