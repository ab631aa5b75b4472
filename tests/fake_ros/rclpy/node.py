# SPDX-License-Identifier: Apache-2.0
"""A node that is allowed what the environment says."""

import os

from rclpy.impl.implementation_singleton import rclpy_implementation


class Node:
    def __init__(self, name, *, namespace="/", use_global_arguments=True, **_options):
        self._made = []
        self.create_publisher(None, "/parameter_events", 10)
        if use_global_arguments is False:
            self._create("service", f"{namespace}{name}/get_type_description")

    def _create(self, kind, name):
        if name.startswith("/dies"):
            os._exit(7)
        if f"{kind} {name}" not in os.environ["FAKE_ALLOWED"].split(","):
            raise rclpy_implementation.RCLError(f"failed to create {kind}\n of {name}")
        self._made.append((kind, name))
        return kind, name

    def create_publisher(self, _type, name, _depth):
        return self._create("publisher", name)

    def create_subscription(self, _type, name, _heard, _depth):
        return self._create("subscription", name)

    def create_client(self, _type, name):
        return self._create("client", name)

    def create_service(self, _type, name, _answer):
        return self._create("service", name)

    def _destroy(self, made):
        if made in self._made:
            self._made.remove(made)
            return True
        return False

    destroy_publisher = destroy_subscription = destroy_client = destroy_service = _destroy

    def destroy_node(self):
        self._made.clear()
