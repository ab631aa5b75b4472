# SPDX-License-Identifier: Apache-2.0
"""A stand-in node, which creates what it is told to; run by the Python of the sourced ROS 2, never imported by Keymint.

It imports nothing of Keymint, and works from Humble (Python 3.10) on. ``network`` as its argument makes it hold a
network namespace instead; :mod:`ros_network` starts both. A node reads one command per line, whose words are separated
by tabs, and answers each with a line:

================================  ======================================================================
``OPEN enclave``                  ``OPENED``, or ``REFUSED text``
``TRY permission name``           ``ALLOWED``, or ``DENIED text``; what is created is deleted at once
``KEEP id permission name``       the same, and what is created stays
``SEND id text``                  ``SENT``, or ``UNMATCHED``: nobody is there who would get it
``READ id milliseconds``          ``SAMPLE text``, or ``TIMEOUT``; everything that is kept works meanwhile
``NODE name namespace``           ``ALLOWED``, or ``DENIED text``: a further node, with default options
================================  ======================================================================

``text`` of ROS is on one line. ``ERROR text`` is the answer to what is no decision of ROS.
"""

from __future__ import annotations

import ctypes
import fcntl
import importlib
import os
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

_FLAGS = 0x8913, 0x8914
"""``SIOCGIFFLAGS`` and ``SIOCSIFFLAGS`` (netdevice(7))."""
_SHARED = b"/dev/shm"
_UP, _MULTICAST = 0x1, 0x1000
_ACTIONS = ("example_interfaces.action", "test_msgs.action", "action_tutorials_interfaces.action")
"""Packages with an action ``Fibonacci``; any of them does, since access control knows no types."""
_GOAL = "_action/send_goal", "_action/cancel_goal", "_action/get_result"
_PROGRESS = "_action/feedback", "_action/status"
_READ = "describe_parameters", "get_parameters", "get_parameter_types", "list_parameters"
_ENTITIES = "publisher", "subscription", "client", "service"
_WRITE = "set_parameters", "set_parameters_atomically"


def _flags(interface: str) -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        answer = fcntl.ioctl(opened, _FLAGS[0], struct.pack("16sh", interface.encode(), 0))
    return int(struct.unpack("16sh", answer)[1])


def network() -> None:
    """Hold the namespaces that this process was started in, until its input ends: loopback alone, and own memory.

    Vendors that share memory would reach other processes of the machine through ``/dev/shm``.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        fcntl.ioctl(opened, _FLAGS[1], struct.pack("16sh", b"lo", _flags("lo") | _UP | _MULTICAST))
    if ctypes.CDLL(None, use_errno=True).mount(b"keymint", _SHARED, b"tmpfs", 0, None):
        raise OSError(ctypes.get_errno(), f"{_SHARED.decode()} cannot be mounted")
    import rclpy  # noqa: PLC0415 - what follows works without ROS

    _say(f"NETWORK {os.getpid()} {rclpy.get_rmw_implementation_identifier()}")
    sys.stdin.read()


class _NoPublisher:
    """Takes what a node publishes about its parameters, if the node may not publish it."""

    def publish(self, message: object) -> None:
        """Drop a message."""


class StandIn:
    """The node of this process, and what it keeps."""

    def __init__(self) -> None:
        import rclpy.node  # noqa: PLC0415 - the network is examined before
        from rcl_interfaces import msg, srv  # noqa: PLC0415
        from rclpy.impl.implementation_singleton import rclpy_implementation  # noqa: PLC0415

        self._ros, self._messages, self._services = rclpy, msg, srv
        self._denial: type[Exception] = rclpy_implementation.RCLError
        self._node: Any = None
        self._kept: dict[str, Any] = {}
        self._inbox: dict[str, deque[str]] = {}

    def open(self, enclave: str) -> str:
        """Create the node with nothing that a node can do without: each right of its own is asked for by a command."""
        create, first = self._ros.node.Node.create_publisher, iter([_NoPublisher()])

        class Bare(self._ros.node.Node):  # type: ignore[misc, name-defined]
            """Its first publisher is the one of events of parameters, which it can do without."""

            def create_publisher(self, *arguments: Any, **options: Any) -> Any:
                return next(first, None) or create(self, *arguments, **options)

        options = ["--enclave", enclave, "--disable-rosout-logs", "-p", "start_type_description_service:=false"]
        try:
            self._ros.init(args=["--ros-args", *options])
            self._node = Bare("keymint_stand_in", enable_rosout=False, start_parameter_services=False)
        except self._denial as error:
            return f"REFUSED {_line(error)}"
        return "OPENED"

    def try_(self, permission: str, name: str) -> str:
        """Create what a permission needs, and delete it."""
        return self._allowed(lambda: self._destroy(self._made(permission, name, deque())))

    def keep(self, id_: str, permission: str, name: str) -> str:
        """Create what a permission needs."""
        inbox = self._inbox[id_] = deque()
        return self._allowed(lambda: self._kept.update({id_: self._made(permission, name, inbox)[0]}))

    def send(self, id_: str, text: str) -> str:
        """Publish, call or request with a text."""
        sends: dict[str, Any] = {"Publisher": self._publish, "Client": self._call, "ActionClient": self._request}
        made = self._kept[id_]
        return "SENT" if sends[type(made).__name__](made, text, self._inbox[id_]) else "UNMATCHED"

    def read(self, id_: str, milliseconds: str) -> str:
        """Return the next text that arrives."""
        deadline = time.monotonic() + int(milliseconds) / 1000
        while not self._inbox[id_] and time.monotonic() < deadline:
            self._ros.spin_once(self._node, timeout_sec=0.05)
        return f"SAMPLE {self._inbox[id_].popleft()}" if self._inbox[id_] else "TIMEOUT"

    def node(self, name: str, namespace: str) -> str:
        """Create a further node, as a program does that sets no option."""
        new = partial(self._ros.node.Node, name, namespace=namespace, use_global_arguments=False)
        return self._allowed(lambda: new().destroy_node())

    def _allowed(self, create: Callable[[], object]) -> str:
        """Create something, and return whether ROS allows it."""
        try:
            create()
        except self._denial as error:
            return f"DENIED {_line(error)}"
        return "ALLOWED"

    # -- what a permission needs ----------------------------------------------------------------------------------

    def _made(self, permission: str, name: str, inbox: deque[str]) -> list[Any]:
        """Create what a permission needs; nothing stays if any part of it is denied."""
        made: list[Any] = []
        try:
            made.extend(make() for make in self._makers(permission, name, inbox))
        except self._denial:
            self._destroy(made)
            raise
        return made

    def _destroy(self, made: list[Any]) -> None:
        for each in made:
            if not any(getattr(self._node, f"destroy_{kind}")(each) for kind in _ENTITIES):
                each.destroy()

    def _makers(self, permission: str, name: str, inbox: deque[str]) -> list[Callable[[], Any]]:
        node, log, get = self._node, self._messages.Log, self._services.GetParameters

        def answer(request: Any, response: Any) -> Any:
            inbox.append(request.names[0])
            response.values = [self._messages.ParameterValue(string_value=f"re: {request.names[0]}")]
            return response

        makers: dict[str, Callable[[str], Any]] = {
            "ros_publish": lambda name: node.create_publisher(log, name, 10),
            "ros_subscribe": lambda name: node.create_subscription(log, name, lambda got: inbox.append(got.msg), 10),
            "ros_call": lambda name: node.create_client(get, name),
            "ros_execute": lambda name: node.create_service(get, name, answer),
        }
        if permission in makers:
            return [lambda: makers[permission](name)]
        if permission in {"ros_read", "ros_write"}:
            names = _READ if permission == "ros_read" else _WRITE
            return [partial(node.create_client, self._type(each), f"{name}/{each}") for each in names]
        if _fibonacci() is not None:
            return [lambda: self._action(permission, name, inbox)]
        client = permission == "ros_request"
        parts = [("ros_call" if client else "ros_execute", each) for each in _GOAL]
        parts += [("ros_subscribe" if client else "ros_publish", each) for each in _PROGRESS]
        return [partial(makers[part], f"{name}/{each}") for part, each in parts]

    def _type(self, service: str) -> Any:
        return getattr(self._services, service.title().replace("_", ""))

    def _action(self, permission: str, name: str, inbox: deque[str]) -> Any:
        from rclpy.action import ActionClient, ActionServer  # noqa: PLC0415 - as late as rclpy

        kind = _fibonacci()

        def execute(goal: Any) -> Any:
            inbox.append(str(goal.request.order))
            goal.succeed()
            return kind.Result(sequence=[goal.request.order])

        try:
            if permission == "ros_request":
                return ActionClient(self._node, kind, name)
            return ActionServer(self._node, kind, name, execute)
        except ValueError as error:  # so rclpy calls a denied service of an action
            raise self._denial(str(error)) from None

    # -- what is sent ---------------------------------------------------------------------------------------------

    def _publish(self, made: Any, text: str, _inbox: deque[str]) -> bool:
        made.publish(self._messages.Log(msg=text))
        return bool(made.get_subscription_count())

    def _call(self, made: Any, text: str, inbox: deque[str]) -> bool:
        if not made.service_is_ready():
            return False
        call = made.call_async(made.srv_type.Request(names=[text]))
        call.add_done_callback(lambda done: inbox.append(done.result().values[0].string_value))
        return True

    def _request(self, made: Any, text: str, inbox: deque[str]) -> bool:
        if not made.server_is_ready():
            return False

        def accepted(sent: Any) -> None:
            result = sent.result().get_result_async()
            result.add_done_callback(lambda done: inbox.append(f"re: {done.result().result.sequence[0]}"))

        made.send_goal_async(_fibonacci().Goal(order=int(text))).add_done_callback(accepted)
        return True


def _fibonacci() -> Any:
    """Return an action's type, or None if no package of these is installed."""
    for module in _ACTIONS:
        try:
            return importlib.import_module(module).Fibonacci
        except ImportError:
            continue
    return None


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _say(line: str) -> None:
    os.write(_ANSWERS, f"{line}\n".encode(errors="replace"))


def main() -> None:
    """Answer the commands on standard input."""
    others = [name for _, name in socket.if_nameindex() if name != "lo" and _flags(name) & _UP]
    if others:  # the kernel may put tunnels that are down into each namespace
        _say(f"ERROR this network has {', '.join(others)} beside loopback: no node is started here")
        return
    if sys.argv[1:] == ["network"]:
        network()
        return
    stand_in = StandIn()
    commands: dict[str, Callable[..., str]] = {
        "OPEN": stand_in.open, "TRY": stand_in.try_, "KEEP": stand_in.keep, "SEND": stand_in.send,
        "READ": stand_in.read, "NODE": stand_in.node,
    }  # fmt: skip
    for line in sys.stdin:
        verb, *words = line.rstrip("\n").split("\t")
        try:
            answer = commands[verb](*words)
        except Exception as error:  # noqa: BLE001 - told to who asked
            answer = f"ERROR {type(error).__name__}: {_line(error)}"
        _say(answer)
    os._exit(0)  # what is kept ends with the process; its threads would wait for each other


if __name__ == "__main__":
    _ANSWERS = os.dup(1)
    os.dup2(2, 1)  # libraries print
    main()
