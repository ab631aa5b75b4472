# SPDX-License-Identifier: Apache-2.0
"""A small file of the form in which RTI Admin Console writes what it discovered."""

from __future__ import annotations

from collections.abc import Sequence

Edge = tuple[str, str, str, Sequence[str]]
"""Permission, topic, type, partitions."""

TALKER_KEY = "101, 2, 3, 1c1"
TALKER_GUID = "000001010000000200000003000001c1"


def endpoint(edge: Edge, key: str) -> str:
    permission, topic, type_name, partitions = edge
    tag = "publication_data" if permission == "publish" else "subscription_data"
    names = "".join(f"<element>{name}</element>" for name in partitions)
    return f"""
                  <element>
                    <{tag}>
                      <key><value>{key}3</value></key>
                      <participant_key><value>{key}</value></participant_key>
                      <topic_name>{topic}</topic_name>
                      <type_name>{type_name}</type_name>
                      <partition><name>{names}</name></partition>
                    </{tag}>
                  </element>"""


def participant(name: str, edges: Sequence[Edge], key: str = TALKER_KEY, domain: int = 0, user_data: str = "") -> str:
    def those(permission: str) -> str:
        return "".join(endpoint(edge, key) for edge in edges if edge[0] == permission)

    return f"""
        <domain_participants>
          <value>
            <element>
              <domain_id>{domain}</domain_id>
              <participant_data>
                <domain_id>{domain}</domain_id>
                <key>
                  <value>{key}</value>
                </key>
                <participant_name>
                  <name>{name}</name>
                </participant_name>
                <user_data>
                  <value>{user_data}</value>
                </user_data>
              </participant_data>
              <publications>
                <value>{those("publish")}
                </value>
              </publications>
              <subscriptions>
                <value>{those("subscribe")}
                </value>
              </subscriptions>
            </element>
          </value>
        </domain_participants>"""


def system(*participants: str) -> bytes:
    processes = "".join(f"\n      <element>{one}\n      </element>" for one in participants)
    return f"""<system>
  <product_version><major>5</major></product_version>
  <processes>
    <value>{processes}
    </value>
  </processes>
</system>
""".encode()
