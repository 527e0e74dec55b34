"""`perfbound reproduce paper` on the real parts, with two campaigns of the test function alone."""

import shutil
import signal
from pathlib import Path

from tests.campaigns import FOLDER
from tests.end_to_end.processes import Processes, contents, query, wait_for


def test_it_goes_on_runs_nothing_twice_and_refuses_an_edited_file(started: Processes, tmp_path: Path) -> None:
    out, files = tmp_path / "my out", Path(shutil.copytree(FOLDER, tmp_path / "files"))
    small = ("--functions", "2", "--seeds", "0", "--direct-seeds", "0", "--no-ours")
    line = ("reproduce", "paper", "--out", "my out", "--campaigns", "files", *small)

    process = started.start("perfbound", *line)
    wait_for(lambda: query(out / "campaigns" / "test-function-1", "SELECT * FROM observations"))
    process.signal_group(signal.SIGINT)
    stopped = process.wait()
    assert stopped.code == 130
    first, second, last = stopped.err.splitlines()
    assert first == "campaign 1 of 2: test-function-0"
    assert second.startswith("campaign 2 of 2: test-function-1, about ")
    command = "perfbound reproduce paper --out 'my out' --campaigns files --functions 2 --seeds 0 --direct-seeds 0"
    assert last == f"perfbound: stopped; continue with: {command} --no-ours"
    assert [path.name for path in out.iterdir()] == ["campaigns"]

    ended = started.run("perfbound", *line)
    assert ended.code == 0, ended.err
    assert ended.err.splitlines()[0] == "campaign 2 of 2: test-function-1"
    written = {path.name for path in out.iterdir()}
    assert written == {"campaigns", "table1.csv", "table1.md", "claims.csv", "claims.md", "figure2.png", "figure2.csv"}
    assert (out / "table1.md").read_text() in ended.out
    assert ended.out.count("| 2     |") == 1
    found = contents(out)

    again = started.run("perfbound", *line)
    assert (again.code, again.out) == (0, ended.out)
    assert len(again.err.splitlines()) == 1
    for name, (data, changed) in contents(out).items():
        assert data == found[name][0], name
        assert changed == found[name][1] or "/" not in name, f"{name} was written again"

    file = files / "test-function.toml"
    file.write_text(file.read_text().replace("resolution = 51", "resolution = 26"))
    refused = started.run("perfbound", *line)
    assert refused.code == 1
    assert refused.fault == (
        "perfbound: my out/campaigns/test-function-0: was run with another files/test-function.toml: "
        "resolution is 51 and 26, respectively; restore that file, or choose another --out"
    )
