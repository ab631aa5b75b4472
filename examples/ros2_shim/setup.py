# SPDX-License-Identifier: Apache-2.0
"""A package for colcon (ament_python)."""

from setuptools import setup

NAME = "keymint_ros2cli"

setup(
    name=NAME,
    version="1.0.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    zip_safe=True,
    entry_points={"ros2cli.command": [f"keymint = {NAME}:KeymintCommand"]},
)
