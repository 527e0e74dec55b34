"""The index of many campaigns on the real parts: the command, a browser, a run that appears in it."""

import re
import shutil
import signal
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import psutil
import pytest
from playwright.sync_api import Browser

from tests.end_to_end.methods import six_campaigns
from tests.end_to_end.processes import Process, Processes, contents, of_run, processes, wait_for
from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report.browser import Watched
from tests.end_to_end.report.test_live import answer_to, get

browser = chromium.browser
NAMES = ("standing", "violated", "budget")
READ = "html[data-unread='0']"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three finished campaigns, one for each verdict, a stopped and a damaged one; do not change them."""
    folder = tmp_path_factory.mktemp("index")
    six_campaigns.write(folder)
    with processes(folder) as found:
        for name in NAMES:
            ended = found.run("perfbound", "run", f"{name}.toml", "--out", f"runs/cars/{name}")
            assert ended.code == 0, ended.err
    shutil.copytree(folder / "runs" / "cars" / "budget", folder / "runs" / "stopped")
    (folder / "runs" / "stopped" / "certificate.json").unlink()
    (folder / "runs" / "damaged").mkdir()
    (folder / "runs" / "damaged" / "campaign.db").write_bytes(b"no database" * 100)
    return folder


def serve(started: Processes, folder: Path) -> tuple[Process, str]:
    process = started.start("perfbound", "web", folder)
    wait_for(lambda: ": http://" in process.err or not process.running)
    (line,) = process.err.splitlines()
    assert line.startswith(f"live page of the campaigns in {folder}: ")
    return process, line.rpartition(" ")[2]


@pytest.fixture
def watch(started: Processes, made: Path, browser: Browser) -> Iterator[Watched]:
    """An open index, which has no error and asks for nothing from elsewhere."""
    _, url = serve(started, made / "runs")
    with chromium.watched(browser) as found:
        found.page.goto(url)
        found.page.wait_for_selector(READ)
        yield found
        assert found.errors == []
        assert all(each.startswith((url, "data:")) for each in found.requests)


def names(watch: Watched) -> list[str]:
    """Return the paths of the rows in their order."""
    rows = "[...document.querySelectorAll('#campaigns tbody tr')]"
    found: list[str] = watch.page.evaluate(f"{rows}.map((row) => row.dataset.path)")
    return found


def words(watch: Watched, path: str) -> list[str]:
    """Return the cells of a row."""
    return watch.page.locator(f"tr[data-path='{path}'] td").all_inner_texts()


def test_each_row_has_the_verdict_the_margin_and_the_state(watch: Watched) -> None:
    assert set(names(watch)) == {"cars/standing", "cars/violated", "cars/budget", "stopped", "damaged"}
    counts = watch.page.locator(".counts").inner_text()
    assert counts == "5 campaigns: 1 SHOWN, 1 VIOLATED, 1 NOT SHOWN, 1 stopped, 1 damaged"
    _, verdict, claim, required, state, rollouts, violations, changed = words(watch, "cars/standing")
    assert (verdict, required, state, violations) == ("SHOWN", "\u2265\u00a00 m", "finished", "0")
    assert claim.startswith("\u2265\u00a0")
    assert claim.endswith(" m, clipped")
    assert int(rollouts.replace(",", "")) > 100
    assert changed.endswith(" ago")
    assert words(watch, "cars/violated")[1].startswith("VIOLATED\nAt gap = ")
    assert "the budget of 6 tests is spent" in words(watch, "cars/budget")[1]
    assert words(watch, "stopped")[4] == "stopped\n6 of at most 6 tests"
    assert re.fullmatch("so far \u2265\u00a0\u2212[0-9.]+ m", words(watch, "stopped")[2])
    damaged = words(watch, "damaged")
    fault = "campaign.db: not a campaign database (file is not a database); restore it from a copy"
    assert damaged[0] == f"damaged\n{fault}"
    assert damaged[4] == "damaged"
    assert watch.page.locator("tr[data-path='damaged'] a").count() == 0


def test_filters_search_and_order_without_a_request(watch: Watched) -> None:
    page = watch.page
    page.route("**/campaigns.json*", lambda route: route.fulfill(status=204))
    before = len(watch.requests)
    page.select_option("[name=verdict]", "NOT SHOWN")
    assert names(watch) == ["cars/budget"]
    page.select_option("[name=verdict]", "none")
    assert set(names(watch)) == {"stopped", "damaged"}
    page.select_option("[name=state]", "stopped")
    assert names(watch) == ["stopped"]
    assert page.locator("#found").inner_text() == "1 of 5 campaigns shown."
    page.click("text=Show all")
    assert page.locator("#found").inner_text() == "All 5 campaigns shown."
    page.fill("[type=search]", "CARS budget")
    assert names(watch) == ["cars/budget"]
    page.fill("[type=search]", "nothing like it")
    assert names(watch) == []
    page.click("text=Show all")
    page.click("#campaigns th >> text=Violations")
    assert (names(watch)[0], sorted_column(watch)) == ("cars/violated", "Violations descending")
    page.click("#campaigns th >> text=Violations")
    assert (names(watch)[-1], sorted_column(watch)) == ("cars/violated", "Violations ascending")
    page.click("#campaigns th >> text=First claim")
    assert names(watch)[0] == "cars/standing"
    assert set(names(watch)[-2:]) == {"stopped", "damaged"}, "those without a claim are last"
    page.click("#campaigns th >> text=First claim")
    assert names(watch)[2] == "cars/standing"
    assert set(names(watch)[-2:]) == {"stopped", "damaged"}, "in both directions"
    assert [each for each in watch.requests[before:] if "campaigns.json" not in each] == []


def sorted_column(watch: Watched) -> str:
    """Return the heading that says to be sorted, and how."""
    (found,) = watch.page.locator("th[aria-sort]").all()
    return f"{found.inner_text()} {found.get_attribute('aria-sort')}"


def test_a_campaign_is_a_click_away_and_back(watch: Watched) -> None:
    page = watch.page
    page.fill("[type=search]", "standing")
    page.click("#campaigns a")
    page.wait_for_selector("[data-verdict='SHOWN'] .word")
    assert page.url.endswith("/runs/cars/standing/")
    page.go_back()
    page.wait_for_selector(READ)
    assert names(watch) == ["cars/standing"], "the choices are kept"
    page.click("#campaigns a")
    page.click("text=All campaigns")
    page.wait_for_selector(READ)
    assert len(names(watch)) == 5


def test_by_keyboard_and_for_a_screen_reader(watch: Watched) -> None:
    page = watch.page
    page.focus("[type=search]")
    for name in ("verdict", "state"):
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.name") == name
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert sorted_column(watch) == "Campaign ascending"
    assert page.evaluate("document.activeElement.dataset.order") == "name", "the focus stays"
    assert page.get_by_role("table", name="Campaigns").count() == 1
    assert page.get_by_role("columnheader").count() == 8
    assert page.get_by_role("row").count() == 6
    assert page.get_by_role("search").count() == 1
    page.set_viewport_size({"width": 360, "height": 800})
    assert page.get_by_role("row").count() == 5, "also as cards"
    assert watch.overflow() <= 0
    page.select_option("[name=order]", "violations down")
    assert names(watch)[0] == "cars/violated"


def test_it_prints_without_its_controls(watch: Watched) -> None:
    page = watch.page
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 1010, "height": 700})
    assert watch.overflow() <= 0
    assert not page.locator("[data-choices]").is_visible()
    assert " UTC" in words(watch, "cars/standing")[-1]
    assert page.locator("tr[data-path='cars/violated'] .word").first.inner_text() == "VIOLATED"


def test_a_new_campaign_appears_runs_and_is_finished(started: Processes, made: Path, browser: Browser) -> None:
    folder = started.folder / "runs"
    folder.mkdir()
    shutil.copy(made / "car.py", started.folder)
    campaign = started.folder / "new.toml"
    campaign.write_text((made / "standing.toml").read_text().replace("alpha = 3.0", "alpha = 0.01"))
    process, url = serve(started, folder)
    with chromium.watched(browser) as watch:
        watch.page.goto(url)
        watch.page.wait_for_selector("#empty")
        assert f"perfbound run CAMPAIGN.toml --out {folder}/first" in watch.page.locator("#empty").inner_text()
        run = started.start("perfbound", "run", campaign, "--out", folder / "new")
        watch.page.wait_for_selector("[data-state=running] progress")
        shutil.copytree(made / "runs" / "cars" / "violated", folder / "later")
        watch.page.wait_for_selector("tr[data-path=later]")
        assert names(watch)[0] == "new" or not run.running, "those that run come first"
        watch.page.wait_for_selector("tr[data-path=new] [data-verdict=SHOWN]")
        assert run.wait().code == 0
        shutil.rmtree(folder / "later")
        wait_for(lambda: names(watch) == ["new"])
        process.popen.send_signal(signal.SIGTERM)
        assert process.wait().code == 143
        watch.page.wait_for_selector("#live[data-connection=lost]")
        assert "connection lost" in watch.page.locator("#live").inner_text()
        assert names(watch) == ["new"]
        assert [error for error in watch.errors if "net::ERR_" not in error] == []
    assert of_run(folder / "new") == []


def test_nothing_in_the_folder_is_changed(started: Processes, made: Path) -> None:
    before = contents(made / "runs")
    process, url = serve(started, made / "runs")
    one = "runs/cars/standing/"
    for good in ("", "campaigns.json", one, f"{one}story.json", "runs/stopped/story.json"):
        assert get(url + good)[0] == 200
    assert get(f"{url}runs/damaged/")[0] == 503
    host = b"Host: localhost\r\nConnection: close\r\n\r\n"
    for path, status in {
        b"/runs/../campaign.db": b"404",
        b"/runs/%2e%2e/%2e%2e/car.py": b"404",
        b"/runs/cars/standing/..%2f..%2fstopped%2fcampaign.db": b"404",
        b"/runs/cars/standing": b"307",
        b"/runs/%00/": b"404",
        b"/runs/" + b"a/" * 400: b"404",
    }.items():
        answer = answer_to(url, b"GET " + path + b" HTTP/1.1\r\n" + host)
        assert answer.startswith(b"HTTP/1.1 " + status), (path, answer[:200])
    assert get(url, Host="evil.example")[0] == 400
    process.popen.send_signal(signal.SIGINT)
    ended = process.wait()
    assert (ended.code, "Traceback" in ended.err) == (130, False)
    assert contents(made / "runs") == before


def test_a_folder_that_is_not_there_is_named(started: Processes) -> None:
    ended = started.run("perfbound", "web", "rusn")
    assert (ended.code, ended.fault) == (
        1,
        "perfbound: rusn: no such folder; name a run directory, or the folder with many of them",
    )


def renamed(source: Path, copy: Path, name: str) -> None:
    """Copy the database and certificate of a campaign; its rows say that they are those of the other one."""
    copy.mkdir(parents=True)
    for each in ("campaign.db", "certificate.json"):
        shutil.copy(source / each, copy / each)
    with closing(sqlite3.connect(copy / "campaign.db", isolation_level=None)) as connection:
        (mode,) = connection.execute("PRAGMA journal_mode=DELETE").fetchone()
        assert mode == "delete"
    assert name == copy.name


def test_two_hundred_campaigns_cost_nothing_while_still(started: Processes, made: Path, browser: Browser) -> None:
    """All of them are there, and a look for changes costs next to nothing."""
    folder = started.folder / "runs"
    for number in range(200):
        source = made / "runs" / "cars" / NAMES[number % 3]
        renamed(source, folder / f"run-{number:03}", f"run-{number:03}")
    process, url = serve(started, folder)
    with chromium.watched(browser) as watch:
        watch.page.goto(url)
        watch.page.wait_for_selector(READ)
        assert len(names(watch)) == 200
        server = psutil.Process(process.pid)
        used = sum(server.cpu_times()[:2])
        watch.page.wait_for_timeout(6000)
        idle = sum(server.cpu_times()[:2]) - used
        watch.page.fill("[type=search]", "run-17")
        assert len(names(watch)) == 10
        assert watch.errors == []
    assert idle < 6.0 / 10, "of a processor, while nothing changes"
