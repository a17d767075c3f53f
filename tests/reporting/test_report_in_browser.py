"""The page in a real browser: nothing is complained of, tables sort, clips play, no request leaves it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from me3bev_cli.main import app

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")

Make = Callable[..., Path]

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


def installed(*names: str) -> str | None:
    return next((path for path in map(shutil.which, names) if path), None)


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    chromium, driver = installed("chromium", "chromium-browser", "google-chrome"), installed("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("Chromium and its driver are not installed (Debian: apt-get install chromium chromium-driver)")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (*FLAGS, f"--user-data-dir={tmp_path / 'profile'}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=driver))
    found.set_script_timeout(60)
    try:
        yield found
    finally:
        found.quit()


@pytest.fixture
def page(evaluated: Make) -> Path:
    """A report of two runs with clips and latencies."""
    runs = [evaluated("one"), evaluated("two", "seed=9")]
    rows = [
        {"name": run.name, "context": "window", "length": 4, "own": True, "median_ms": 5.0, "p95_ms": 6.0, "stages": {}}
        for run in runs
    ]
    setup = {"device": "cpu", "threads": 1, "dtype": "float32", "batch": 1}
    (runs[0] / "latency.json").write_text(json.dumps({"setup": setup, "rows": rows}))
    done = CliRunner().invoke(app, ["report", *map(str, runs), "--clips", "2"])
    assert done.exit_code == 0, done.output
    return Path("report/index.html").resolve()


def column(browser: Any, table: str, number: int) -> list[str]:
    rows = "[...document.querySelectorAll(`#${arguments[0]} tbody tr`)]"
    script = f"return {rows}.map((row) => row.cells[arguments[1]].dataset.value)"
    found: list[str] = browser.execute_script(script, table, number)
    return found


def requested(browser: Any, page: Path) -> list[str]:
    """Every address that the page asked for; the browser's own first page asks for others."""
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [m["params"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    return [one["request"]["url"] for one in sent if one["documentURL"].startswith(page.as_uri())]


PLAY = """
const [video, done] = [document.querySelector("video"), arguments[arguments.length - 1]];
video.addEventListener("error", () => done(`error ${video.error && video.error.message}`));
video.addEventListener("timeupdate", () => {
  if (video.currentTime > 0.2) done([video.currentTime, video.videoWidth]);
});
document.querySelector("button.play").click();
"""


def test_the_page_in_a_browser(browser: Any, page: Path) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    # Where scripts do not run, the browser's own controls are there.
    assert " controls " in page.read_text().partition("<video")[2].partition(">")[0]
    browser.get(page.as_uri())
    sections = [link.get_attribute("textContent") for link in browser.find_elements(By.CSS_SELECTOR, "nav a")]
    assert sections == [
        "Summary", "Methods", "Maps", "Comfort and efficiency", "Convergence", "Latency", "Failures", "Recipes",
        "Reproduce",
    ]  # fmt: skip

    # By mouse: numbers fall, then rise; what has no value stays at the end.
    heading = browser.find_elements(By.CSS_SELECTOR, "#methods-1 thead button")[2]
    browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", heading)
    heading.click()
    falling = [float(value) for value in column(browser, "methods-1", 2)]
    assert falling == sorted(falling, reverse=True)
    assert len(set(falling)) > 1
    # By keyboard: the other way, then by name.
    heading.send_keys(Keys.ENTER)
    assert [float(value) for value in column(browser, "methods-1", 2)] == sorted(falling)
    name = browser.find_elements(By.CSS_SELECTOR, "#methods-1 thead button")[0]
    name.send_keys(Keys.SPACE)
    assert column(browser, "methods-1", 0) == sorted(column(browser, "methods-1", 0))
    states = [th.get_attribute("aria-sort") for th in browser.find_elements(By.CSS_SELECTOR, "#methods-1 thead th")]
    assert states[0] == "ascending"
    assert set(states[1:]) == {"none"}
    assert browser.find_element(By.ID, "said").get_attribute("textContent").startswith("sorted by method")

    time, width = browser.execute_async_script(PLAY)
    assert time > 0
    assert width == 640
    button = browser.find_element(By.CSS_SELECTOR, "button.play")
    assert button.text == "Pause"
    button.send_keys(Keys.ENTER)
    assert browser.execute_script("return document.querySelector('video').paused")

    problems = [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
    assert problems == []
    asked = requested(browser, page)
    assert page.as_uri() in asked
    assert any(url.endswith(".webm") for url in asked)
    assert [url for url in asked if not url.startswith((page.parent.as_uri() + "/", "data:"))] == []


def test_phones_the_dark_and_the_keyboard(browser: Any, page: Path) -> None:
    from selenium.webdriver.common.keys import Keys

    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 360, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    )
    papers = []
    for scheme in ("light", "dark"):
        feature = {"name": "prefers-color-scheme", "value": scheme}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        browser.get(page.as_uri())
        # Nothing is wider than the screen but what scrolls in itself.
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 360
        papers.append(browser.execute_script("return getComputedStyle(document.body).backgroundColor"))
        smallest = browser.execute_script(
            "return Math.min(...[...document.querySelectorAll('svg.chart')].map(s => 11 * s.clientWidth / 380))"
        )
        assert smallest > 8
    assert papers[0] != papers[1]
    # The first stop of the keyboard leads past the navigation.
    body = browser.switch_to.active_element
    body.send_keys(Keys.TAB)
    assert browser.switch_to.active_element.get_attribute("textContent") == "Skip to the summary"
    loose = "return [...document.querySelectorAll('video:not([aria-label]), svg.chart:not([aria-label])')].length"
    assert browser.execute_script(loose) == 0
