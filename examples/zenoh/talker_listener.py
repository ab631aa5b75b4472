# SPDX-License-Identifier: Apache-2.0
"""A talker and a listener over Zenoh, with the files that Keymint installed, as they are. No ROS is needed.

usage: python talker_listener.py INSTALL_SPACE

The sessions do what rmw_zenoh does for a publisher and a subscription on the topic ``/chatter``. Then two others try to
publish there too: one with the listener's certificate, and one without any certificate. Needs ``eclipse-zenoh``.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from queue import Empty, Queue

try:
    import zenoh
except ModuleNotFoundError:
    sys.exit("this example needs the library of Zenoh: pip install eclipse-zenoh")

CHATTER = "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported"
"""The key of /chatter in domain 0: domain, name, type and its hash."""


def publish(session: zenoh.Session, text: str, received: Queue[str]) -> bool:
    """Publish a text until it is received; return whether that happens within two seconds."""
    publisher = session.declare_publisher(CHATTER)
    for _ in range(10):
        publisher.put(text)
        session.put(CHATTER, text)  # also without a declared publisher, as an attacker would
        try:
            while received.get(timeout=0.2) != text:
                pass
        except Empty:
            continue
        return True
    return False


def connect(file: Path) -> zenoh.Session:
    """Open a session with a configuration; exit with a message if that fails."""
    try:
        return zenoh.open(zenoh.Config.from_file(str(file)))
    except zenoh.ZError as error:
        sys.exit(f"{file}: error: Zenoh does not start with it: {str(error).splitlines()[0]}")


def without_certificate(file: Path) -> str:
    """Try to open a session without a certificate; return Zenoh's message if it is refused."""
    config = zenoh.Config.from_file(str(file))
    for name in ("connect_certificate", "connect_private_key"):
        config.insert_json5(f"transport/link/tls/{name}", "null")
    config.insert_json5("transport/link/tls/enable_mtls", "false")
    try:
        zenoh.open(config).close()
    except zenoh.ZError as error:
        return str(error)
    return ""


def main(install: Path) -> int:
    """Run the demonstration; return 1 if something is not as the policy says."""
    enclaves = install / "enclaves"
    router = connect(install / "zenoh/router.json5")
    print(f"router     started with {install}/zenoh/router.json5")
    listener, talker = (connect(enclaves / name / "session.json5") for name in ("listener", "talker"))
    received: Queue[str] = Queue()
    listener.declare_subscriber(CHATTER, lambda sample: received.put(sample.payload.to_string()))
    time.sleep(0.2)
    heard = publish(talker, "Hello World: 1", received)
    print(f"/talker    publishes on /chatter:  {'delivered to /listener' if heard else 'NOT DELIVERED'}")
    fourth = connect(enclaves / "listener" / "session.json5")
    forged = publish(fourth, "Hello World: forged", received)
    print(f"/listener  publishes on /chatter:  {'DELIVERED' if forged else 'not delivered: it has no right to'}")
    refusal = without_certificate(enclaves / "talker" / "session.json5")
    print(f"stranger   without a certificate:  {'refused' if refusal else 'CONNECTED'}")
    for session in (fourth, talker, listener, router):
        session.close()
    return 0 if heard and not forged and refusal else 1


if __name__ == "__main__":
    if len(sys.argv) != 2:  # noqa: PLR2004
        sys.exit("usage: python talker_listener.py INSTALL_SPACE")
    sys.exit(main(Path(sys.argv[1])))
