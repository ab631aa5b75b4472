# SPDX-License-Identifier: Apache-2.0
"""Attacks on real Zenoh with files as Keymint installs them; each works where its defence is left out."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohError

from tests.plugins.keymint_ros2_zenoh.install_spaces import ALL, InstallSpace, merged

from .compiled_space import CompiledSpace, compiled, policy
from .zenoh_network import FENCE, RealNetwork, real_network

pytestmark = [pytest.mark.zenoh, pytest.mark.usefixtures("zenoh_library")]

CHATTER = "0/chatter/type/hash"
ANYBODY = [{"id": name} for name in ("/listener", "/mallory", "/talker")]
"""Subjects without properties, as zenoh_security_tools writes them: they match every link."""
NO_OWN_ACCESS_CONTROL = {"access_control": {"enabled": False}}
NO_NAME_CHECK = {"transport": {"link": {"tls": {"verify_name_on_connect": False}}}}

SENDS = [("publish", "0/wide/**"), ("deny", "0/wide/secret/**")]
PEER = {
    "mode": "peer",
    "listen": {"endpoints": ["tls/127.0.0.1:0"]},
    "scouting": {"gossip": {"enabled": True, "autoconnect": {"peer": ["router", "peer"]}}},
    "transport": {"link": {"tls": {"verify_name_on_connect": False}}},
}
GOSSIP = {"scouting": {"gossip": {"enabled": True}}}


@pytest.fixture(scope="module")
def workspace(zenoh_library: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A talker and a listener; mallory has a certificate of the same authority, and may use the fence only."""
    source = policy(
        listener=[("subscribe", "chatter"), ("subscribe", "fence")],
        mallory=[("publish", "fence")],
        talker=[("publish", "chatter"), ("publish", "fence")],
    )
    return compiled(source, tmp_path_factory.mktemp("compiled"))


@pytest.fixture
def space(workspace: Path, tmp_path: Path) -> CompiledSpace:
    return CompiledSpace(workspace, tmp_path / "install")


@pytest.fixture
def network(space: InstallSpace) -> Iterator[RealNetwork]:
    with real_network(space) as opened:
        yield opened


class TestCertificateOfAnotherEnclave:
    """Mallory is a legitimate enclave, and sends as the talker."""

    def test_the_talker_itself_is_heard(self, network: RealNetwork) -> None:
        network.router()
        listener, talker = network.session("listener"), network.session("talker")
        assert network.arrives(talker, CHATTER, listener, CHATTER)

    @pytest.mark.parametrize("files_of", ["mallory", "talker"])
    def test_the_certificate_decides_and_not_the_configuration(self, network: RealNetwork, files_of: str) -> None:
        network.router()
        listener = network.session("listener")
        mallory = network.session(files_of, NO_OWN_ACCESS_CONTROL, enclave="mallory")
        assert not network.arrives(mallory, CHATTER, listener, CHATTER)

    def test_without_the_common_name_in_the_subject_it_would_be_heard(self, network: RealNetwork) -> None:
        network.router({"access_control": {"subjects": ANYBODY}})
        listener, mallory = network.session("listener"), network.session("mallory")
        assert network.arrives(mallory, CHATTER, listener, CHATTER)

    def test_a_certificate_of_another_authority_gets_no_link(self, network: RealNetwork, tmp_path: Path) -> None:
        network.router()
        stranger = InstallSpace(tmp_path / "stranger", {"/talker": []})
        stranger.write()
        for name in ("cert.pem", "key.pem"):
            own = network.space.folder / "enclaves/mallory" / name
            own.write_bytes((stranger.folder / "enclaves/talker" / name).read_bytes())
        with pytest.raises(ZenohError):
            network.session("mallory")


class TestFalseRouter:
    """Mallory runs a router of its own, to which a talker and a listener are led."""

    def both_usages(self, network: RealNetwork, *, named: bool = False) -> None:
        """Give mallory a certificate for servers too, as enclaves of DDS have it."""
        network.space.enclave("mallory", "/mallory", both=True, host="localhost" if named else "")

    def test_a_node_has_no_certificate_for_servers(self, network: RealNetwork) -> None:
        network.router(NO_OWN_ACCESS_CONTROL, enclave="mallory")
        for victim in ("talker", "listener"):
            with pytest.raises(ZenohError):
                network.session(victim, merged(NO_NAME_CHECK, NO_OWN_ACCESS_CONTROL))

    def test_the_name_of_the_host_is_checked(self, network: RealNetwork) -> None:
        self.both_usages(network)
        network.router(NO_OWN_ACCESS_CONTROL, enclave="mallory")
        with pytest.raises(ZenohError):
            network.session("talker", NO_OWN_ACCESS_CONTROL)

    def test_the_sessions_accept_the_routers_common_name_only(self, network: RealNetwork) -> None:
        self.both_usages(network, named=True)
        network.router(NO_OWN_ACCESS_CONTROL, enclave="mallory")
        talker, listener = network.session("talker"), network.session("listener")
        assert not network.reaches(talker, listener, CHATTER)

    @pytest.mark.parametrize("victims", [("talker",), ("listener",)])
    def test_one_session_that_is_pinned_is_enough(self, network: RealNetwork, victims: tuple[str, ...]) -> None:
        self.both_usages(network, named=True)
        network.router(NO_OWN_ACCESS_CONTROL, enclave="mallory")
        open_ = {
            name: network.session(name, {} if name in victims else NO_OWN_ACCESS_CONTROL)
            for name in ("talker", "listener")
        }
        assert not network.reaches(open_["talker"], open_["listener"], CHATTER)

    def test_without_all_three_it_would_relay_and_read(self, network: RealNetwork) -> None:
        self.both_usages(network)
        network.router(NO_OWN_ACCESS_CONTROL, enclave="mallory")
        unpinned = merged(NO_NAME_CHECK, NO_OWN_ACCESS_CONTROL)
        talker, listener = network.session("talker", unpinned), network.session("listener", unpinned)
        assert network.reaches(talker, listener, CHATTER)


class TestWildcards:
    """Zenoh denies what a deny rule includes; a key expression that only meets it passes."""

    def network(self, tmp_path: Path, receives: list[tuple[str, str]], sends: list[tuple[str, str]]) -> InstallSpace:
        rights = {"/listener": [*receives, ("subscribe", FENCE)], "/talker": [*sends, ("publish", FENCE)]}
        return InstallSpace(tmp_path / "wild", rights)

    @pytest.mark.parametrize("wide", ["0/wide/*/x", "0/wide/se$*/x", "0/wide/**"])
    def test_a_put_around_a_deny_arrives_only_where_the_receiver_may_receive_it(
        self, tmp_path: Path, wide: str
    ) -> None:
        secret = "0/wide/secret/x"
        for receives, reached in (([("subscribe", "0/wide/**")], True), ([("subscribe", secret)], False)):
            with real_network(self.network(tmp_path, receives, SENDS)) as network:
                network.router()
                talker = network.session("talker", NO_OWN_ACCESS_CONTROL)
                listener = network.session("listener")
                assert network.arrives(talker, wide, listener, secret) == reached
                assert not network.arrives(talker, secret, listener, secret)

    @pytest.mark.parametrize("wide", ["0/wide/*/x", "0/wide/**"])
    def test_a_subscription_around_a_deny_of_all_messages_receives_nothing(self, tmp_path: Path, wide: str) -> None:
        sends, secret = [("publish", "0/wide/**")], "0/wide/secret/x"
        space = self.network(tmp_path, [("subscribe", "0/wide/**"), ("deny", "0/wide/secret/**")], sends)
        for left, reached in ((list(ALL), False), (["declare_subscriber"], True)):
            with real_network(space) as network:
                rules = space.router()["access_control"]["rules"]
                changed = [{**rule, "messages": left} if rule["permission"] == "deny" else rule for rule in rules]
                network.router({"access_control": {"rules": changed}})
                talker = network.session("talker")
                listener = network.session("listener", NO_OWN_ACCESS_CONTROL)
                assert network.arrives(talker, secret, listener, wide) == reached
                assert network.arrives(talker, "0/wide/public/x", listener, wide)


class TestPeer:
    """Mallory and the listener speak past the router, which denies everything."""

    @pytest.fixture
    def network(self, space: InstallSpace) -> Iterator[RealNetwork]:
        with real_network(space) as opened:
            for name in ("mallory", "listener"):
                space.enclave(name, f"/{name}", both=True)
            opened.router(merged(GOSSIP, {"access_control": {"rules": [], "subjects": [], "policies": []}}))
            yield opened

    def test_an_installed_session_speaks_with_the_router_only(self, network: RealNetwork) -> None:
        mallory = network.session("mallory", merged(PEER, NO_OWN_ACCESS_CONTROL))
        listener = network.session("listener")
        assert not network.reaches(mallory, listener, CHATTER)
        assert network.sessions.ask("peers", session=listener)["peers"] == []

    def test_the_defaults_of_rmw_zenoh_would_let_them_speak(self, network: RealNetwork) -> None:
        unprotected = merged(PEER, NO_OWN_ACCESS_CONTROL)
        mallory, listener = network.session("mallory", unprotected), network.session("listener", unprotected)
        assert network.reaches(mallory, listener, CHATTER)

    def test_the_own_access_control_of_a_peer_would_stop_it_too(self, network: RealNetwork) -> None:
        mallory = network.session("mallory", merged(PEER, NO_OWN_ACCESS_CONTROL))
        listener = network.session("listener", PEER)
        assert not network.reaches(mallory, listener, CHATTER)


class TestForgedGraph:
    """Mallory announces a node of the talker to the graph."""

    OWN, TALKERS = (f"@ros2_lv/0/aaa/0/1/NN/%{enclave}/%/node" for enclave in ("mallory", "talker"))
    EVERY = "@ros2_lv/0/**"

    def seen(self, network: RealNetwork, *tokens: str) -> set[str]:
        """Declare tokens as mallory, and return those that the listener sees."""
        listener, mallory = network.session("listener"), network.session("mallory", NO_OWN_ACCESS_CONTROL)
        for token in tokens:
            network.sessions.ask("tokens", session=mallory, keys=[token])
        for _ in range(20):
            found = set(network.sessions.ask("alive", session=listener, key=self.EVERY, wait=1.0))
            if tokens[-1] in found:
                return found
        raise AssertionError("the last token was not seen, so nothing is known about the others")

    def test_an_enclave_announces_its_own_nodes_only(self, network: RealNetwork) -> None:
        network.router()
        assert self.seen(network, self.TALKERS, self.OWN) == {self.OWN}

    def test_with_a_right_to_all_tokens_it_would_be_believed(self, network: RealNetwork) -> None:
        control = network.space.router()["access_control"]
        for rule in control["rules"]:
            if any("%mallory" in each for each in rule["key_exprs"]):
                rule["key_exprs"] = [self.EVERY]
        network.router({"access_control": {"rules": control["rules"]}})
        assert self.seen(network, self.TALKERS, self.OWN) == {self.TALKERS, self.OWN}


class TestExpiry:
    """The talker's certificate expires while its link lives."""

    LIFE = 6.0

    @pytest.mark.parametrize("closes", [True, False])
    def test_a_link_ends_with_its_certificate_if_the_router_closes_it(self, space: InstallSpace, closes: bool) -> None:
        import time

        space.lives["/talker"] = self.LIFE
        with real_network(space) as network:
            network.router({"transport": {"link": {"tls": {"close_link_on_expiration": closes}}}})
            listener, talker = network.session("listener"), network.session("talker")
            assert network.arrives(talker, CHATTER, listener, CHATTER)
            expiry = datetime.now(UTC).timestamp() + self.LIFE
            while datetime.now(UTC).timestamp() < expiry + 2:
                time.sleep(0.1)
            assert network.reaches(talker, listener, CHATTER) != closes
            if closes:
                assert network.sessions.ask("peers", session=talker)["routers"] == []
