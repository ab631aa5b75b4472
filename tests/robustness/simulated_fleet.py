# SPDX-License-Identifier: Apache-2.0
"""A fleet of robots over simulated years: an owner with a workspace, robots that copy their enclaves, and a thief.

The owner runs ``keymint renew`` by the calendar, renews authorities when he is told to, takes rights away, and revokes
certificates. Robots deploy what there is, some of them one round later. The thief has every file that was ever on a
robot, keys included.
"""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, OMG
from keymint_ros2_dds.transports.enclave_model import EnclaveModel

from keymint.api import Environment, InstalledEnclave
from keymint.api.graph import Edge, Object
from tests.conftest import NOW, Outcome

DAY = timedelta(days=1)
START = datetime.fromtimestamp(NOW, UTC)
MODELS = (OMG, CYCLONEDDS_0_10, FASTDDS_2_9)
TOPICS = ("scan", "odom", "image", "pose")
CREDENTIALS = ("cert.pem", "key.pem", "permissions.p7s")
_PROFILE = '<profile name="{name}"><attachment>/{name}</attachment>{rules}</profile>'
_RULE = """<ros_topic qualifier="ALLOW"><attachment>/{topic}</attachment>
<permissions><ros_publish/></permissions></ros_topic>
"""


@dataclass
class Fleet:
    """The owner's workspace, and what is on the robots.

    Attributes:
        keymint: runs the command line.
        folder: an empty folder.
        names: the subjects, one robot each.
        valid_for: validity of certificates, for ``--valid-for``.
        chance: decides what happens.
        now: the clock.
        rights: what the policy lets each subject publish.
        withdrawn: subjects whose key was revoked, and who have no new one yet.
        issued: the credentials that were ever on a robot, by subject: the newest last.
        revocations: how many certificates were revoked.
    """

    keymint: Callable[..., Outcome]
    folder: Path
    names: tuple[str, ...]
    valid_for: str
    chance: random.Random
    now: datetime = START
    rights: dict[str, set[str]] = field(default_factory=dict)
    withdrawn: set[str] = field(default_factory=set)
    issued: dict[str, list[dict[str, bytes]]] = field(default_factory=dict)
    revocations: int = 0

    def __post_init__(self) -> None:
        self.rights = {name: {*TOPICS} for name in self.names}
        self.issued = {name: [] for name in self.names}
        self.provision()
        for name in self.names:
            self.deploy(name)

    @property
    def ws(self) -> Path:
        return self.folder / "ws"

    def robot(self, name: str) -> Path:
        """The keystore's folder of an enclave on its robot."""
        return self.folder / "robots" / name

    def run(self, *arguments: object, codes: Iterable[int] = (0,)) -> Outcome:
        """Run a verb at the simulated time."""
        clock = {"SOURCE_DATE_EPOCH": str(int(self.now.timestamp()))}
        outcome = self.keymint(*arguments, "-w", self.ws, cwd=self.folder, env=clock)
        assert outcome.code in codes, (self.now, arguments, outcome.out[-2000:], outcome.err[-2000:])
        return outcome

    # -- what the owner does ---------------------------------------------------------------------------------------

    def provision(self) -> None:
        """Make the keystore follow the policy; where rights are taken away, the old ones end."""
        bodies = {
            name: "".join(_RULE.format(topic=topic) for topic in sorted(own)) for name, own in self.rights.items()
        }
        profiles = "".join(_PROFILE.format(name=name, rules=rules) for name, rules in bodies.items())
        (self.folder / "policy.xml").write_text(f"<profiles>{profiles}</profiles>")
        options = () if self.ws.exists() else ("--valid-for", self.valid_for)
        self.run("provision", self.folder / "policy.xml", "--revoke-superseded", "-q", *options)

    def renew(self) -> bool:
        """Run what runs by the calendar; renew the authorities that are due. Returns whether all robots must change."""
        outcome = self.run("renew", "--json", codes=(0, 3))
        due = [each["authority"] for each in outcome.document["result"]["authorities_due"]]
        assert outcome.code == (3 if due else 0)
        for authority in due:
            self.run("authority", "renew", authority, "--flag-day")
        if due:  # what the authority shortened is longer now
            self.run("renew")
        return bool(due)

    def revoke(self, name: str, reason: str) -> None:
        """Revoke the certificates of a subject."""
        document = self.run("revoke", name, "--reason", reason, "--json").document
        self.revocations += len(document["result"]["revoked"])
        if reason != "superseded":
            self.withdrawn.add(name)

    def restore(self, name: str) -> None:
        """Give a subject whose key was revoked a new one."""
        self.run("renew", "--rekey", name)
        self.withdrawn.discard(name)

    # -- what happens on robots ------------------------------------------------------------------------------------

    def deploy(self, name: str) -> None:
        """Copy an enclave to its robot; the thief keeps a copy."""
        source, robot = self.ws / "install/enclaves" / name, self.robot(name)
        shutil.rmtree(robot, ignore_errors=True)
        if not source.exists():
            assert name in self.withdrawn
            return
        shutil.copytree(source, robot)
        own = {file: (robot / file).read_bytes() for file in CREDENTIALS}
        if own not in self.issued[name]:
            self.issued[name].append(own)

    # -- what must hold --------------------------------------------------------------------------------------------

    def problems(self, name: str) -> Iterator[str]:
        """Yield why a robot's enclave does not start, or may not do what it could when it was deployed."""
        robot = self.robot(name)
        if not robot.exists():
            return
        model = self._model(robot, name)
        for variation in MODELS:
            if problem := model.refusal or model.unauthenticated(variation):
                yield f"{self.now:%Y-%m-%d} /{name} does not start ({variation.name}): {problem}"
            elif not any(self._allows(model, variation, topic) for topic in TOPICS) and self.rights[name]:
                yield f"{self.now:%Y-%m-%d} /{name} may do nothing ({variation.name}): expired or torn"

    def thefts(self, name: str, peer: str, latest: int) -> Iterator[str]:
        """Yield what the thief may publish as a subject although the policy does not let that subject.

        He combines each certificate with each permissions document, and shows them to a peer that has the latest files.

        Args:
            name: the subject.
            peer: a peer that was deployed just now.
            latest: how many of the newest credentials he tries.
        """
        composite = self.folder / "thief"
        known = self.issued[name][-latest:]
        allowed = set() if name in self.withdrawn else self.rights[name]
        for identity in known:
            for granted in known:
                shutil.rmtree(composite, ignore_errors=True)
                shutil.copytree(self.robot(peer), composite)
                for file, content in {**identity, "permissions.p7s": granted["permissions.p7s"]}.items():
                    (composite / file).write_bytes(content)
                model = self._model(composite, name)
                for variation in MODELS:
                    stolen = {topic for topic in TOPICS if self._allows(model, variation, topic)} - allowed
                    if stolen:
                        yield f"{self.now:%Y-%m-%d} /{name} may publish {sorted(stolen)} ({variation.name})"

    def _model(self, folder: Path, name: str) -> EnclaveModel:
        enclave = InstalledEnclave(f"/{name}", folder, "jazzy", folder.parent)
        return EnclaveModel(enclave, Environment(self.now, self.folder), 0)

    @staticmethod
    def _allows(model: EnclaveModel, variation: object, topic: str) -> bool:
        return model.decide(variation, Edge("/x", "publish", Object("topic", f"rt/{topic}"))).allowed
