# SPDX-License-Identifier: Apache-2.0
"""The report as a person uses it, in headless Chromium: scripts, keyboard, themes, and no network.

Where Chromium is missing these skip; with ``KEYMINT_REQUIRE_VENDORS=1`` in the environment (as in CI) they fail.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from keymint.drawing.html_report import html_report
from keymint.drawing.svg import svg

from .graphs import HOSTILE, fleet, hostile, one_of_each

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

pytestmark = [pytest.mark.chromium, pytest.mark.xdist_group("chromium")]

SOURCES = {"policy.xml": b"<profiles>\n\n  <rule/>\n</profiles>\n"}
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage"),
    *("--window-size=1300,900", "--host-resolver-rules=MAP * ~NOTFOUND"),
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    """Return a browser with a profile of its own."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not chromium or not driver:
        lacking = "Chromium and its driver are needed: apt-get install chromium chromium-driver"
        if os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
            pytest.fail(f"KEYMINT_REQUIRE_VENDORS=1, but {lacking}", pytrace=False)
        pytest.skip(lacking)
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    opened = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield opened
    opened.quit()


class Page:
    """A report that is open."""

    def __init__(self, browser: Chrome) -> None:
        self.browser = browser

    def rows(self, section: str = ".subject-part") -> list[str]:
        """Return the visible edges as subject, permission and object."""
        script = """
            return [...document.querySelectorAll(arguments[0] + " tr[data-v]")].filter((row) => row.checkVisibility())
                .map((row) => [row.closest("section").querySelector("h3")?.textContent ?? "",
                    row.cells[0].textContent.trim(), row.querySelector(".node:not(.subject)").textContent].join(" "))
        """
        return sorted(self.browser.execute_script(script, section))

    def text(self, selector: str) -> str:
        return self.browser.execute_script("return document.querySelector(arguments[0]).textContent", selector)

    def keys(self, *keys: str) -> None:
        """Press keys, wherever the focus is."""
        from selenium.webdriver import ActionChains

        for key in keys:
            ActionChains(self.browser).send_keys(key).perform()

    def focused(self, what: str) -> object:
        return self.browser.execute_script(f"return document.activeElement.{what}")

    def visible(self, selector: str) -> bool:
        return self.browser.execute_script("return document.querySelector(arguments[0]).checkVisibility()", selector)


ALL = [
    "/listener ros_call /talker/set_parameters",
    "/listener ros_subscribe /chatter",
    "/talker ros_publish /chatter",
    "/talker ros_subscribe /chatter",
]


@pytest.fixture
def page(browser: Chrome, tmp_path: Path) -> Iterator[Page]:
    """Open the report on a graph with every outcome; nothing may be complained of or fetched."""
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
    browser.get_log("browser")
    path = tmp_path / "report.html"
    path.write_bytes(html_report(one_of_each(), SOURCES))
    browser.get(path.as_uri())
    yield Page(browser)
    assert browser.get_log("browser") == []
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0


def test_a_box_of_robots_that_are_alike_finds_each_of_them(page: Page, tmp_path: Path) -> None:
    path = tmp_path / "fleet.html"
    path.write_bytes(html_report(fleet(10), SOURCES))
    page.browser.get(path.as_uri())
    assert len(page.rows()) == 41
    dimmed = "return document.querySelectorAll('.picture .edge.dim').length"
    assert page.browser.execute_script(dimmed) == 0
    page.browser.execute_script(
        "const search = document.getElementById('search'); search.value = '/robot7/node2';"
        "search.dispatchEvent(new Event('input'))"
    )
    assert len(page.rows()) == 1
    assert page.browser.execute_script(dimmed) == 2


def test_names_break_between_words_only(page: Page) -> None:
    names = page.browser.execute_script(
        "return [...document.querySelectorAll('.node')]"
        ".map((node) => [getComputedStyle(node).overflowWrap, node.innerHTML])"
    )
    assert names
    assert {wrap for wrap, _ in names} == {"break-word"}
    assert any("/talker/<wbr>set_<wbr>parameters" in html for _, html in names)


def test_search_by_name(page: Page) -> None:
    assert page.rows() == ALL
    assert page.text("#status") == "4 of 4 edges"
    page.keys("/")
    assert page.focused("id") == "search"
    page.keys(*"/talker")
    assert page.rows() == [row for row in ALL if row.startswith("/talker")]
    assert page.text("#status") == "2 of 4 edges"
    assert page.rows("#differences") == []


def test_a_part_of_a_name_finds_objects(page: Page) -> None:
    page.keys("/", *"SET_PAR")
    assert page.rows() == [ALL[0]]
    assert page.visible("#objects tr[data-n]:has(a.ros_service)")
    assert not page.visible("#objects tr[data-n]:has(a.ros_topic)")


def test_what_is_not_there(page: Page) -> None:
    page.keys("/", *"zzz")
    assert page.rows() == []
    assert page.visible("#nothing")


def test_filter_by_verdict_with_the_keyboard(page: Page) -> None:
    page.keys("/", "\ue004", " ")  # Tab to the first verdict, and Space
    assert page.focused("value") == "false-positive"
    assert page.rows() == ALL[1:]
    page.keys("\ue004", " ")
    assert page.rows() == ALL[2:]
    page.keys("\ue00c")  # Escape
    page.browser.execute_async_script("setTimeout(arguments[0])")
    assert page.rows() == ALL


def test_the_picture_follows_the_search(page: Page) -> None:
    page.keys("/", *"/listener")
    dimmed = "return [...document.querySelectorAll('.edge.dim')].map((e) => e.dataset.v).sort()"
    assert page.browser.execute_script(dimmed) == ["allow", "deny"]


def test_a_node_of_the_picture_with_the_keyboard(page: Page) -> None:
    page.browser.execute_script("document.querySelector('svg a[data-n]').focus()")
    page.keys("\ue007")  # Enter
    assert page.browser.execute_script("return document.querySelector('#search').value") == "/listener"
    assert page.rows() == ALL[:2]
    assert page.browser.current_url.endswith("#n0")


def test_the_source_of_a_rule(page: Page) -> None:
    page.browser.execute_script("document.querySelector('.subject-part .why a').focus()")
    page.keys("\ue007")
    assert page.text(":target") == "  <rule/>"
    top = page.browser.execute_script("return document.querySelector(':target').getBoundingClientRect().top")
    assert 0 < top < 900


def test_a_link_to_what_a_filter_hides_shows_it(page: Page) -> None:
    page.keys("/", *"/talker")
    assert not page.visible("#n0")
    page.browser.execute_script("location.hash = '#n0'")
    page.browser.execute_async_script("setTimeout(arguments[0], 50)")
    assert page.visible("#n0")


def test_dark_and_light(page: Page) -> None:
    from selenium.webdriver.common.by import By

    def colours(theme: str) -> tuple[str, str]:
        media = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
        page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
        body = page.browser.find_element(By.TAG_NAME, "body").value_of_css_property("background-color")
        return body, page.browser.find_element(By.CSS_SELECTOR, ".background").value_of_css_property("fill")

    assert colours("light") == ("rgba(255, 255, 255, 1)", "rgb(255, 255, 255)")
    assert colours("dark") == ("rgba(17, 22, 28, 1)", "rgb(17, 22, 28)")


def test_without_scripts(page: Page) -> None:
    page.browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    page.browser.refresh()
    try:
        assert page.rows() == ALL
        assert not page.visible("#controls")
        assert page.visible("#picture svg")
    finally:
        page.browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


def test_hostile_names_do_nothing(page: Page, tmp_path: Path) -> None:
    path = tmp_path / "hostile.html"
    path.write_bytes(html_report(hostile(), {HOSTILE: HOSTILE.encode()}))
    page.browser.get(path.as_uri())
    assert page.browser.execute_script("return document.querySelectorAll('img, script[src]').length") == 0
    assert len(page.rows()) == 1
    page.keys("/", *"onerror")
    assert len(page.rows()) == 1


def test_no_label_leaves_its_box(page: Page, tmp_path: Path) -> None:
    path = tmp_path / "picture.svg"
    path.write_bytes(svg(one_of_each()))
    page.browser.get(path.as_uri())
    script = """
        return [...document.querySelectorAll(".box:has(title)")].filter((box) => {
            const inner = box.querySelector("text").getBBox(), outer = box.querySelector("rect").getBBox();
            return inner.x < outer.x || inner.x + inner.width > outer.x + outer.width
                || inner.y < outer.y || inner.y + inner.height > outer.y + outer.height;
        }).map((box) => box.textContent)
    """
    assert page.browser.execute_script("return document.querySelectorAll('.box:has(title)').length") == 4
    assert page.browser.execute_script(script) == []
