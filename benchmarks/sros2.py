# SPDX-License-Identifier: Apache-2.0
"""Compare with SROS2: the time from nothing to a keystore of N enclaves, side by side on this machine.

usage: python benchmarks/sros2.py FOLDER [--sizes 2,100,1000] [--repeat 3]

FOLDER is a checkout of https://github.com/ros2/sros2. Both get the same enclaves with the same rules: SROS2 a policy of
its own form; Keymint the same file, imported, and the policy of ``fleet.py``, which has what real nodes need besides.
SROS2 runs as ``ros2 security generate_artifacts`` does, without the command line: a process calls its library, with
stand-ins for the parts of ROS 2 that it imports (folder of a package, check of a name, name of the RMW). That saves it
the start of ``ros2``, so the ratio is in its favour. Runs of both alternate; the best repeat of each counts.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
import types
import warnings
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric import ec
from fleet import KEYMINT, ROLES, Spent, policy, spent

ENCLAVE = """    <enclave path="/robot{robot}/{role}"><profiles><profile ns="/robot{robot}" node="{role}">
      <topics {access}="ALLOW"><topic>chatter</topic><topic>/fleet/map</topic></topics>
      <services request="ALLOW"><service>/fleet/report</service></services>
    </profile></profiles></enclave>
"""


def sros2_policy(size: int) -> str:
    """Return a policy of SROS2 with the topics and services of :func:`fleet.policy`."""
    enclaves = (
        ENCLAVE.format(robot=number // 2, role=role, access=permission.removeprefix("ros_"))
        for number in range(size)
        for role, permission in [ROLES[number % 2]]
    )
    return f'<policy version="0.2.0"><enclaves>\n{"".join(enclaves)}</enclaves></policy>\n'


def generate_artifacts(checkout: Path, keystore: Path, policy_file: Path) -> None:
    """Let SROS2 make a keystore from a policy.

    Args:
        checkout: a checkout of its repository.
        keystore: a folder that does not exist.
        policy_file: a policy of SROS2.
    """

    def stand_in(name: str, **members: object) -> None:
        module = types.ModuleType(name)
        vars(module).update(members)
        sys.modules[name] = module

    stand_in("ament_index_python", get_package_share_directory=lambda _: str(checkout / "sros2"))
    stand_in("rclpy")
    stand_in("rclpy.exceptions", InvalidNamespaceException=type("InvalidNamespaceException", (Exception,), {}))
    stand_in("rclpy.validate_namespace", validate_namespace=lambda _: True)
    stand_in("rclpy.utilities", get_rmw_implementation_identifier=lambda: "rmw_cyclonedds_cpp")
    # Versions from before 2024-08 pass the class of the curve, which the library no longer takes.
    generate = ec.generate_private_key
    ec.generate_private_key = lambda curve, *_: generate(curve() if isinstance(curve, type) else curve)  # type: ignore[assignment]
    warnings.simplefilter("ignore")
    sys.path.insert(0, str(checkout / "sros2"))
    importlib.import_module("sros2.api._artifact_generation").generate_artifacts(keystore, [], [policy_file])


def compare(checkout: Path, scratch: Path, size: int, repeat: int) -> None:
    """Measure both for a number of enclaves, and print the ratios.

    Args:
        checkout: a checkout of SROS2.
        scratch: an empty folder.
        size: the number of enclaves.
        repeat: how often each runs.
    """
    (scratch / "sros2.xml").write_text(sros2_policy(size))
    (scratch / "policy.xml").write_text(policy(size))
    spent(*KEYMINT, "import", "sros2.xml", "-o", "imported.xml", cwd=scratch, codes=(0, 3))
    best: dict[str, Spent] = {}
    for attempt in range(repeat):
        commands = {
            "SROS2": (sys.executable, __file__, str(checkout), "--keystore", f"sros2-{attempt}"),
            "Keymint": (*KEYMINT, "provision", "policy.xml", "-w", f"keymint-{attempt}", "-q"),
            "Keymint, imported": (*KEYMINT, "provision", "imported.xml", "-w", f"imported-{attempt}", "-q"),
        }
        for who, command in commands.items():
            took = spent(*command, cwd=scratch)
            best[who] = min(best.get(who, took), took, key=lambda each: each.wall)
    theirs = best.pop("SROS2")
    print(f"{size:6,} enclaves  SROS2 {theirs.wall:8.2f} s wall {theirs.cpu:8.2f} s CPU")
    for who, ours in best.items():
        print(
            f"{'':17}{who:18} {ours.wall:8.2f} s wall {ours.cpu:8.2f} s CPU   "
            f"SROS2 takes {theirs.wall / ours.wall:.2f} x wall, {theirs.cpu / ours.cpu:.2f} x CPU",
            flush=True,
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, nargs="?", help="a checkout of SROS2")
    parser.add_argument("--sizes", default="2,100,1000", help="numbers of enclaves")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--keystore", type=Path, help="only let SROS2 make this keystore from sros2.xml")
    options = parser.parse_args()
    if options.checkout is None or not (options.checkout / "sros2/sros2/__init__.py").is_file():
        print("skipped: name a checkout of https://github.com/ros2/sros2")
        return
    checkout = options.checkout.absolute()
    if options.keystore is not None:
        generate_artifacts(checkout, options.keystore, Path("sros2.xml"))
        return
    shared_memory = Path("/dev/shm")
    for size in map(int, options.sizes.split(",")):
        with tempfile.TemporaryDirectory(dir=shared_memory if shared_memory.is_dir() else None) as scratch:
            compare(checkout, Path(scratch), size, options.repeat)


if __name__ == "__main__":
    main()
