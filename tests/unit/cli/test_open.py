"""`perfbound open`: the report in a browser."""

import webbrowser
from pathlib import Path

import pytest
from click.testing import CliRunner

from perfbound.orchestrator.cli import report
from perfbound.orchestrator.cli.group import cli


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("browser", [True, False])
def test_it_opens_the_report_and_writes_a_missing_one_first(
    there: bool, browser: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def shown(address: str) -> bool:
        asked.append(address)
        return browser

    monkeypatch.setattr(webbrowser, "open", shown)
    page = tmp_path / "report.html"
    if there:
        page.write_text("as it is")
    monkeypatch.setattr(report, "_write_report", lambda *_, **__: page.write_text("anew"))
    monkeypatch.setattr(cli.commands["open"].params[0], "callback", lambda _context, _parameter, value: Path(value))
    found = CliRunner().invoke(cli, ["open", str(tmp_path)])
    assert found.exit_code == 0, found.output
    assert str(page) in found.output
    assert asked == [page.as_uri()]
    assert page.read_text() == ("as it is" if there else "anew")
    assert ("there is no browser here" in found.output) == (not browser)
