"""The job files for Slurm: what is published, what a shell makes of hostile names, and what is refused."""

import fcntl
import os
import re
import resource
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from signal import SIGUSR1

import pytest
from click.testing import CliRunner

from perfbound.orchestrator.cli import slurm  # noqa: F401  (it adds the command)
from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.hosts.slurm_files import (
    ORCHESTRATOR,
    ROUTER,
    WORKERS,
    SlurmOptions,
    job_files,
    job_name,
    missing_files,
)
from perfbound.orchestrator.store.lock import LOCK_FILE, campaign_lock
from perfbound.schemas.errors import PerfboundError
from tests.end_to_end.processes import wait_for
from tests.facts import says
from tests.patience import PATIENCE

pytestmark = pytest.mark.integration

HOME = Path("/home/ada")
OPTIONS = SlurmOptions(
    "segway-paper",
    HOME / "segway-paper.toml",
    HOME / "runs" / "segway-paper",
    HOME / "slurm" / "segway-paper",
    HOME / "venv" / "bin",
    64,
    secret=HOME / ".local" / "state" / "perfbound" / "secret",
    partition="long",
)
NOTHING: Mapping[str, str] = {}
HOSTILE = (
    "; touch HIT;",
    "$(touch HIT)",
    "`touch HIT`",
    "' ; touch HIT ; '",
    '" ; touch HIT ; "',
    "a  b *",
    "--export=ALL",
    "#SBATCH --uid=0",
    "%j %x \\",
    "naïve ∀",
)


def head(text: str) -> list[str]:
    """Return the lines that sbatch reads: those before the first command."""
    found = []
    for line in text.splitlines():
        if line and not line.startswith("#"):
            break
        found.append(line)
    return [line for line in found if line.startswith("#SBATCH")]


def test_slurm_warns_a_job_before_its_limit_and_queues_it_again() -> None:
    asked = {"ntasks=1", "cpus-per-task=1", "mem=2G", "time=4:00:00", "partition=long", "open-mode=append"}
    asked |= {"signal=B:USR1@120", "requeue"}
    for job, own in ((ORCHESTRATOR, {"output=%x-%j.log"}), (WORKERS, {"array=1-64", "output=%x-%A_%a.log"})):
        own |= {f"job-name=segway-paper-{job}"}
        assert {line.removeprefix("#SBATCH --") for line in head(job_files(OPTIONS)[f"{job}.sh"])} == asked | own


@pytest.mark.parametrize("name", [*HOSTILE, "line\nbreak\n#SBATCH --uid=0", "../../etc", "", "x" * 5000])
def test_no_name_of_a_campaign_reaches_a_line_of_slurm(name: str) -> None:
    for job in (ROUTER, ORCHESTRATOR, WORKERS):
        found = job_name(name, job)
        assert re.fullmatch(r"[A-Za-z0-9_.-]{1,80}", found)
    plain, odd = (job_files(replace(OPTIONS, name=each)) for each in ("campaign", name))
    for file in plain:
        kept = [[line for line in head(each[file]) if "--job-name=" not in line] for each in (plain, odd)]
        assert kept[0] == kept[1]
        assert sum("--job-name=" in line for line in head(odd[file])) == sum(
            "--job-name=" in line for line in head(plain[file])
        )


def program(folder: Path, name: str) -> None:
    """Write a program that prints its arguments, one a line."""
    path = folder / name
    path.write_text('#!/bin/bash\nprintf "%s\\n" "${0##*/}" "$@" >>"$SEEN"\n')
    path.chmod(0o755)


@pytest.mark.rest
@pytest.mark.parametrize("hostile", HOSTILE)
def test_a_shell_takes_every_value_as_it_is(tmp_path: Path, hostile: str) -> None:
    """The files are run, with programs that print their arguments in the place of the real ones."""
    (tmp_path / "home").mkdir()
    home = tmp_path / "home" / hostile
    for folder in ("bin", "jobs", "tls"):
        (home / folder).mkdir(parents=True)
    for name in ("perfbound", "perfbound-worker"):
        program(home / "bin", name)
    (home / "secret").write_text("a secret of the test")
    options = SlurmOptions(
        hostile,
        home / "c.toml",
        home / "run",
        home / "jobs",
        home / "bin",
        2,
        secret=home / "secret",
        tls=home / "tls",
        router=f"tls/{'r' * 5}:7447",
        system=("--system", f"{home}/cars.py:cars"),
    )
    for name, text in job_files(options).items():
        (home / "jobs" / name).write_text(text)
    seen: dict[str, list[str]] = {}
    for job in (WORKERS, ORCHESTRATOR):
        out = tmp_path / f"{job}.seen"
        done = subprocess.run(
            ["bash", home / "jobs" / f"{job}.sh"],
            cwd=tmp_path,
            env={"PATH": os.environ["PATH"], "SEEN": str(out)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
        seen[job] = out.read_text().splitlines()
    assert not list(tmp_path.rglob("HIT"))

    def tls(role: str) -> list[str]:
        names = {"ca": "ca.pem", "certificate": f"{role}.pem", "key": f"{role}-key.pem"}
        return [part for key, name in names.items() for part in (f"--tls-{key}", f"{home}/tls/{role}/{name}")]

    assert seen[WORKERS] == [
        *("perfbound-worker", "--until-done", "--system", f"{home}/cars.py:cars"),
        *(*tls("worker"), "--connect", "tls/rrrrr:7447"),
    ]
    assert seen[ORCHESTRATOR] == [
        *("perfbound", "orchestrate", f"{home}/c.toml", "--out", f"{home}/run", "--drain"),
        *(*tls("orchestrator"), "--connect", "tls/rrrrr:7447"),
    ]
    assert (home / "jobs" / "ended").read_text() == "0\n"
    assert len(missing_files(options)) == 6


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("partition", "long --uid=0"),
        ("partition", "long\n#SBATCH --uid=0"),
        ("account", "$(id)"),
        ("time", "4 hours"),
        ("time", "infinite;"),
        ("time", "UNLIMITED 1"),
        ("time", "1234-0"),
        ("memory", "2G "),
        ("memory", "-1"),
    ],
)
def test_what_sbatch_would_not_take_as_one_word_is_refused(option: str, value: str) -> None:
    with pytest.raises(PerfboundError, match=f"--{option}"):
        replace(OPTIONS, **{option: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("text", ["1", "3", "0:30", "3:00", "0:03:00", "00:00:59"])
def test_a_job_does_not_end_before_it_has_begun_to_work(text: str) -> None:
    """Slurm warns 120 s before the limit, up to a minute early; a warned job ends, and is queued again, without end."""
    with pytest.raises(PerfboundError, match=f"--time {text}: too short"):
        replace(OPTIONS, time=text)


@pytest.mark.parametrize(
    "text",
    ["0", "4", "30", "1440", "20160", "UNLIMITED", "30:00", "0:04:00", "4:00:00", "2-0", "2-12:30", "14-00:00:00"],
)
def test_times_of_slurm_are_taken(text: str) -> None:
    assert f"#SBATCH --time={text}" in job_files(replace(OPTIONS, time=text))["workers.sh"]


@pytest.mark.parametrize("place", ["campaign", "directory", "folder", "programs", "secret", "tls"])
def test_a_path_with_a_line_break_is_refused(place: str) -> None:
    with pytest.raises(PerfboundError, match="not printed"):
        replace(OPTIONS, **{place: Path("/home/ada\n#SBATCH --uid=0")})  # type: ignore[arg-type]


def test_with_a_router_elsewhere_there_is_no_job_for_one() -> None:
    found = job_files(replace(OPTIONS, router="tcp/login:7447"))
    assert sorted(found) == ["common.sh", "orchestrator.sh", "submit.sh", "workers.sh"]
    assert "jobs=(orchestrator workers)" in found["submit.sh"]


def test_without_secret_and_certificates_no_job_starts(tmp_path: Path) -> None:
    options = replace(OPTIONS, folder=tmp_path, secret=None)
    for name, text in job_files(options).items():
        (tmp_path / name).write_text(text)
    ended = subprocess.run(
        ["bash", tmp_path / "workers.sh"], env={"PATH": os.environ["PATH"]}, capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (1, "PERFBOUND_SECRET: not set; submit the jobs where it is\n")


SBATCH = """#!/bin/bash
echo "sbatch $*" >>"$SEEN"
number=$(wc -l <"$SEEN")
[ "$number" -lt "$FAILS" ] || exit 1
echo "$((number + 40));cluster"
"""


def submit(folder: Path, fails: int = 99, queue: str = "") -> "subprocess.CompletedProcess[str]":
    """Run the submission, with commands that write down what they get in the place of Slurm's."""
    for name, text in job_files(replace(OPTIONS, folder=folder)).items():
        (folder / name).write_text(text)
    bin_folder = folder / "bin"
    bin_folder.mkdir(exist_ok=True)
    texts = {
        "sbatch": SBATCH,
        "scancel": '#!/bin/bash\necho "scancel $*" >>"$SEEN"\n',
        "squeue": "#!/bin/bash\n" + queue,
    }
    for name, text in texts.items():
        (bin_folder / name).write_text(text)
        (bin_folder / name).chmod(0o755)
    (folder / "seen").write_text("")
    environment = {"PATH": f"{bin_folder}:{os.environ['PATH']}", "SEEN": str(folder / "seen"), "FAILS": str(fails)}
    return subprocess.run(["bash", folder / "submit.sh"], env=environment, capture_output=True, text=True, check=False)


def test_each_job_starts_once_the_one_before_runs(tmp_path: Path) -> None:
    (tmp_path / "ended").write_text("1")
    ended = submit(tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[:3] == ["router 41", "orchestrator 42", "workers 43"]
    assert (tmp_path / "seen").read_text().splitlines() == [
        "sbatch --parsable router.sh",
        "sbatch --parsable --dependency=after:41 orchestrator.sh",
        "sbatch --parsable --dependency=after:42 workers.sh",
    ]
    assert (tmp_path / "submitted").read_text() == "41,42,43\n"
    assert not (tmp_path / "ended").exists(), "a note of an earlier submission would end the jobs"


def test_where_one_job_is_refused_the_others_are_withdrawn(tmp_path: Path) -> None:
    ended = submit(tmp_path, fails=3)
    assert ended.returncode == 1
    assert (tmp_path / "seen").read_text().splitlines()[-1] == "scancel 41 42"
    assert not (tmp_path / "submitted").exists()


def test_a_campaign_is_not_submitted_twice(tmp_path: Path) -> None:
    assert submit(tmp_path).returncode == 0
    again = submit(tmp_path, queue="echo 42")
    assert (again.returncode, again.stderr) == (1, "jobs of this campaign are in the queue already: 41,42,43\n")
    assert (tmp_path / "seen").read_text() == ""


def test_a_queue_that_cannot_be_asked_may_have_the_jobs(tmp_path: Path) -> None:
    assert submit(tmp_path).returncode == 0
    (tmp_path / "endpoint").write_text("tcp/node:1\n")
    fault = "slurm_load_jobs error: Unable to contact slurm controller (connect failure)"
    again = submit(tmp_path, queue=f"echo '{fault}' >&2; exit 1")
    assert (again.returncode, again.stdout) == (1, "")
    assert says(again.stderr, f"^squeue: {fault} jobs campaign queue")
    assert (tmp_path / "seen").read_text() == ""
    assert (tmp_path / "endpoint").exists(), "jobs that run read it"


def test_jobs_that_slurm_has_forgotten_have_ended(tmp_path: Path) -> None:
    assert submit(tmp_path).returncode == 0
    again = submit(tmp_path, queue="echo 'slurm_load_jobs error: Invalid job id specified' >&2; exit 1")
    assert again.returncode == 0, again.stderr
    assert len((tmp_path / "seen").read_text().splitlines()) == 3


def test_of_two_submissions_at_once_one_is_refused(tmp_path: Path) -> None:
    """The first one is in the middle when the second one begins."""
    assert submit(tmp_path).returncode == 0
    (tmp_path / "submitted").unlink()
    environment = {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "SEEN": str(tmp_path / "seen"), "FAILS": "99"}
    (tmp_path / "bin" / "squeue").write_text("#!/bin/bash\necho 41\n")
    (tmp_path / "bin" / "sbatch").write_text(
        SBATCH.replace("number=", f'while [ ! -e "{tmp_path}/go" ]; do sleep 0.05; done\nnumber=')
    )
    (tmp_path / "seen").write_text("")
    runs = []
    for number in range(2):
        words = ["bash", str(tmp_path / "submit.sh")]
        runs.append(subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        if number == 0:
            wait_for(lambda: (tmp_path / "seen").read_text() != "")
    wait_for(lambda: second_waits(runs[1].pid) or len((tmp_path / "seen").read_text().splitlines()) > 1)
    (tmp_path / "go").touch()
    errors = [run.communicate(timeout=PATIENCE)[1] for run in runs]
    assert [run.returncode for run in runs] == [0, 1], errors
    assert says(errors[1], "campaign queue 41,42,43")
    assert len((tmp_path / "seen").read_text().splitlines()) == 3


def second_waits(pid: int) -> bool:
    """Whether a process waits for a child that is `flock`."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return any(Path(f"/proc/{child}/comm").read_text() == "flock\n" for child in children)


def test_a_submission_that_is_killed_is_known(tmp_path: Path) -> None:
    killing = '[ "$*" != "--parsable --dependency=after:41 orchestrator.sh" ] || kill -KILL "$PPID"'
    assert submit(tmp_path).returncode == 0
    (tmp_path / "submitted").unlink()
    (tmp_path / "bin" / "sbatch").write_text(SBATCH.replace("number=", f"{killing}\nnumber="))
    (tmp_path / "seen").write_text("")
    environment = {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "SEEN": str(tmp_path / "seen"), "FAILS": "99"}
    ended = subprocess.run(["bash", tmp_path / "submit.sh"], env=environment, capture_output=True, check=False)
    assert ended.returncode == -9
    again = submit(tmp_path, queue="echo 41")
    assert (again.returncode, again.stderr) == (1, "jobs of this campaign are in the queue already: 41\n")


def job(folder: Path, name: str, more: Mapping[str, str] = NOTHING, **programs: str) -> "subprocess.Popen[str]":
    """Start a job with `more` in its environment, and with shell texts in the place of its programs."""
    bin_folder = folder / "bin"
    bin_folder.mkdir()
    for program, text in programs.items():
        (bin_folder / program.replace("_", "-")).write_text(f"#!/bin/bash\n{text}\n")
        (bin_folder / program.replace("_", "-")).chmod(0o755)
    (folder / "secret").write_text("a secret of the test")
    options = replace(
        OPTIONS, folder=folder, directory=folder / "run", programs=bin_folder, secret=folder / "secret", router=None
    )
    for file, text in job_files(options).items():
        (folder / file).write_text(text)
    environment = {"PATH": f"{bin_folder}:{os.environ['PATH']}", "SEEN": str(folder / "seen"), "HOME": str(folder)}
    environment |= {"SLURM_JOB_ID": "7", **more}
    words = ["bash", str(folder / f"{name}.sh")]
    return subprocess.Popen(words, env=environment, cwd=folder, stderr=subprocess.PIPE, text=True)


FULL_ONCE = """for last; do :; done
[ -e "$SEEN.$(basename "$last")" ] || { touch "$SEEN.$(basename "$last")"; exit 1; }
exec /bin/mv "$@"
"""


@pytest.mark.rest
def test_where_a_router_cannot_write_its_endpoint_it_tries_again(tmp_path: Path) -> None:
    """A full disk: without the note all jobs would wait for it until their time limits, in vain."""
    with job(tmp_path, ROUTER, mv=FULL_ONCE, perfbound='cp "$HOME/endpoint" "$SEEN"') as router:
        _, fault = router.communicate(timeout=PATIENCE)
    assert router.returncode == 0, fault
    assert re.fullmatch(r"tcp/.+:[0-9]+\n", (tmp_path / "seen").read_text())
    assert says(fault, f"^{tmp_path}/endpoint: written")


@pytest.mark.rest
def test_the_end_of_a_campaign_is_noted_as_soon_as_there_is_room(tmp_path: Path) -> None:
    (tmp_path / "endpoint").write_text("tcp/node:1\n")
    with job(tmp_path, ORCHESTRATOR, mv=FULL_ONCE, perfbound="exit 0") as orchestrator:
        _, fault = orchestrator.communicate(timeout=PATIENCE)
    assert orchestrator.returncode == 0, fault
    assert (tmp_path / "ended").read_text() == "0\n"


WARNED = """touch "$SEEN"
while [ -e "$SEEN" ]; do sleep 0.05; done
kill -{signal} $$
"""
QUEUED_AGAIN = 'echo "$*" >"$HOME/again"'


@pytest.mark.parametrize("name", [ORCHESTRATOR, WORKERS])
@pytest.mark.parametrize("signal", ["TERM", "ABRT", "SEGV"])
def test_warned_of_its_time_limit_a_job_is_queued_again_whatever_signal_ends_its_program(
    tmp_path: Path, name: str, signal: str
) -> None:
    """Asked to end, a program may crash instead: nothing is lost, so the campaign has not failed."""
    (tmp_path / "endpoint").write_text("tcp/node:1\n")
    text = f"trap 'rm \"$SEEN\"' TERM\n{WARNED.format(signal=signal)}".replace("kill -TERM", "trap - TERM\nkill -TERM")
    with job(tmp_path, name, perfbound=text, perfbound_worker=text, scontrol=QUEUED_AGAIN) as warned:
        wait_for((tmp_path / "seen").exists)
        warned.send_signal(SIGUSR1)
        _, fault = warned.communicate(timeout=PATIENCE)
    assert warned.returncode > 128, fault
    assert (tmp_path / "again").read_text() == "requeue 7\n"
    assert not (tmp_path / "ended").exists()


@pytest.mark.rest
@pytest.mark.parametrize("code", [0, 1])
def test_a_campaign_that_ends_after_the_warning_is_not_queued_again(tmp_path: Path, code: int) -> None:
    (tmp_path / "endpoint").write_text("tcp/node:1\n")
    text = f"trap 'rm \"$SEEN\"' TERM\n{WARNED.format(signal='0')}exit {code}"
    with job(tmp_path, ORCHESTRATOR, perfbound=text, scontrol=QUEUED_AGAIN) as warned:
        wait_for((tmp_path / "seen").exists)
        warned.send_signal(SIGUSR1)
        _, fault = warned.communicate(timeout=PATIENCE)
    assert warned.returncode == code, fault
    assert (tmp_path / "ended").read_text() == f"{code}\n"
    assert not (tmp_path / "again").exists()


LASTING = """trap 'exit 143' TERM
touch "$SEEN"
while :; do sleep 0.05; done
"""


@pytest.mark.parametrize("fault", ["exit 1", "kill -SEGV $$", "exit 2"])
def test_a_router_that_fails_ends_the_campaign_with_its_reason(tmp_path: Path, fault: str) -> None:
    """As where its certificate has ended: the other jobs would wait on their nodes, and queue themselves again."""
    times = 'echo >>"$HOME/times"\necho "the certificate has ended" >&2\n'
    with job(tmp_path, ROUTER, sleep=":", perfbound=times + fault) as router:
        _, reason = router.communicate(timeout=PATIENCE)
    code = {"exit 1": 1, "kill -SEGV $$": 139, "exit 2": 2}[fault]
    assert router.returncode == code, reason
    assert (tmp_path / "times").read_text().count("\n") == (1 if code == 2 else 5)
    assert (tmp_path / "ended").read_text() == f"{code}\n"
    assert says(reason, "router other jobs campaign again")


@pytest.mark.parametrize("code", [0, 143])
def test_a_router_that_is_ended_says_nothing_of_the_campaign(tmp_path: Path, code: int) -> None:
    with job(tmp_path, ROUTER, perfbound=f"exit {code}") as router:
        _, fault = router.communicate(timeout=PATIENCE)
    assert (router.returncode, fault) == (code, "")
    assert not (tmp_path / "ended").exists()


def test_an_orchestrator_ends_with_its_router(tmp_path: Path) -> None:
    (tmp_path / "endpoint").write_text("tcp/node:1\n")
    with job(tmp_path, ORCHESTRATOR, perfbound=LASTING, scontrol=QUEUED_AGAIN) as orchestrator:
        wait_for((tmp_path / "seen").exists)
        (tmp_path / "ended").write_text("1\n")
        _, fault = orchestrator.communicate(timeout=PATIENCE)
    assert (orchestrator.returncode, (tmp_path / "ended").read_text()) == (143, "1\n")
    assert says(fault, "router campaign output")
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize(
    ("code", "restarts", "finished", "again"),
    [(0, 0, False, True), (0, 0, True, False), (0, 2, True, False), (1, 0, False, False), (1, 2, False, True)],
)
def test_a_worker_without_an_orchestrator_for_ten_minutes_waits_in_the_queue(
    tmp_path: Path, code: int, restarts: int, *, finished: bool, again: bool
) -> None:
    """The job of the orchestrator may wait there as well; without workers its campaign would stand still."""
    (tmp_path / "endpoint").write_text("tcp/node:1\n")
    if finished:
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "certificate.json").touch()
    age = {"SECONDS": "600", "SLURM_RESTART_COUNT": str(restarts)}
    with job(tmp_path, WORKERS, age, perfbound_worker=f"exit {code}", scontrol=QUEUED_AGAIN) as worker:
        worker.communicate(timeout=PATIENCE)
    assert worker.returncode == code
    assert (tmp_path / "again").exists() is again


def test_a_worker_with_a_fault_is_not_queued_again(tmp_path: Path) -> None:
    (tmp_path / "endpoint").write_text("tcp/node:1\n")
    with job(tmp_path, WORKERS, perfbound_worker="exit 1", scontrol=QUEUED_AGAIN) as worker:
        worker.communicate(timeout=PATIENCE)
    assert worker.returncode == 1
    assert not (tmp_path / "again").exists()


@pytest.mark.rest
def test_an_orchestrator_whose_router_moves_in_its_first_session_resumes(tmp_path: Path) -> None:
    (tmp_path / "endpoint").write_text("tcp/old:1\n")
    (tmp_path / "run").mkdir()
    text = """echo "$1 ${!#}" >>"$SEEN"
[ "${!#}" = tcp/new:2 ] || { touch "$HOME/run/campaign.db"; exec sleep 1000; }
"""
    with job(tmp_path, ORCHESTRATOR, perfbound=text) as orchestrator:
        wait_for((tmp_path / "run" / "campaign.db").exists)
        (tmp_path / "moved").write_text("tcp/new:2\n")
        (tmp_path / "moved").replace(tmp_path / "endpoint")
        _, fault = orchestrator.communicate(timeout=PATIENCE)
    assert orchestrator.returncode == 0, fault
    assert (tmp_path / "seen").read_text() == "orchestrate tcp/old:1\nresume tcp/new:2\n"


@contextmanager
def locked_on_another_node(directory: Path) -> Iterator[None]:
    """Lock what NFS shares between nodes: the file alone."""
    with (directory / LOCK_FILE).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def test_the_job_of_the_orchestrator_knows_the_lock_file() -> None:
    assert f'"$directory/{LOCK_FILE}"' in job_files(OPTIONS)[f"{ORCHESTRATOR}.sh"]


@pytest.mark.parametrize("holding", [campaign_lock, locked_on_another_node])
def test_an_orchestrator_waits_for_one_that_slurm_has_lost_sight_of(
    tmp_path: Path, holding: Callable[[Path], AbstractContextManager[object]]
) -> None:
    """Queued again while it still runs elsewhere: the campaign has not failed."""
    (tmp_path / "endpoint").write_text("tcp/node:1\n")
    (tmp_path / "run").mkdir()
    locked = 'flock --nonblock --conflict-exit-code 1 "$HOME/run/orchestrator.lock" true || exit\necho "$1" >"$SEEN"'
    with holding(tmp_path / "run"):
        orchestrator = job(tmp_path, ORCHESTRATOR, perfbound=locked)
        assert orchestrator.stderr is not None
        line = f"{tmp_path}/run: another orchestrator is running this campaign; waiting for its end\n"
        assert orchestrator.stderr.readline() == line
        (tmp_path / "run" / "campaign.db").touch()
    with orchestrator:
        assert orchestrator.wait(PATIENCE) == 0
    assert (tmp_path / "ended").read_text() == "0\n"
    assert (tmp_path / "seen").read_text() == "resume\n"


@pytest.mark.rest
def test_when_the_router_has_moved_the_others_connect_to_its_new_place(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    worker = tmp_path / "bin" / "perfbound-worker"
    worker.write_text('#!/bin/bash\necho "${!#}" >>"$SEEN"\n[ "${!#}" = tcp/new:2 ] || exec sleep 1000\n')
    worker.chmod(0o755)
    (tmp_path / "secret").write_text("a secret of the test")
    options = replace(OPTIONS, folder=tmp_path, programs=tmp_path / "bin", secret=tmp_path / "secret")
    for name, text in job_files(options).items():
        (tmp_path / name).write_text(text)
    (tmp_path / "endpoint").write_text("tcp/old:1\n")
    seen = tmp_path / "seen"
    environment = {"PATH": os.environ["PATH"], "SEEN": str(seen)}
    with subprocess.Popen(["bash", tmp_path / "workers.sh"], env=environment, stderr=subprocess.DEVNULL) as job:
        try:
            wait_for(seen.exists)
            (tmp_path / "moved").write_text("tcp/new:2\n")
            (tmp_path / "moved").replace(tmp_path / "endpoint")
            assert job.wait(PATIENCE) == 0
        finally:
            job.kill()
    assert seen.read_text() == "tcp/old:1\ntcp/new:2\n"


@pytest.mark.parametrize("limit", ["1440", "10080", "0"])
def test_a_time_limit_in_minutes(limit: str) -> None:
    assert f"#SBATCH --time={limit}\n" in job_files(replace(OPTIONS, time=limit))["workers.sh"]


CAMPAIGN = Path(__file__).parents[3] / "deploy" / "campaigns" / "test-function.toml"


def test_a_dry_run_writes_and_submits_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("PERFBOUND_SECRET", raising=False)
    folder = tmp_path / "jobs"
    arguments = [str(CAMPAIGN), "--workers", "3", "--folder", str(folder), "--dry-run"]
    found = CliRunner().invoke(cli, ["slurm", *arguments])
    assert says(found.output, f"{folder} submit with: {folder}/submit.sh")
    assert "#SBATCH --array=1-3\n" in (folder / "workers.sh").read_text()
    assert f"secret={tmp_path}/state/perfbound/secret\n" in (folder / "workers.sh").read_text()
    assert (tmp_path / "state" / "perfbound" / "secret").stat().st_mode & 0o077 == 0


def test_a_submission_says_from_when_on_there_is_a_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PERFBOUND_SECRET", "a secret of the test")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "sbatch").write_text("#!/bin/bash\necho 41\n")
    (tmp_path / "bin" / "sbatch").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    run = tmp_path / "my run"
    arguments = [str(CAMPAIGN), "--workers", "3", "--folder", str(tmp_path / "jobs"), "--out", str(run)]
    found = CliRunner().invoke(cli, ["slurm", *arguments])
    assert found.exit_code == 0, found.output
    line = f"once the job orchestrator runs: perfbound status '{run}'; before, there is no campaign"
    assert found.stdout.splitlines()[-1] == line
    status = CliRunner().invoke(cli, ["status", str(run)])
    assert says(str(status.exception), "submitted begun")


def test_on_a_full_disk_the_files_of_jobs_in_the_queue_stay_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PERFBOUND_SECRET", "a secret of the test")
    arguments = ["slurm", str(CAMPAIGN), "--workers", "3", "--folder", str(tmp_path), "--dry-run"]
    assert CliRunner().invoke(cli, arguments).exit_code == 0
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}
    arguments = [*arguments, "--time", "5:00:00"]
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, hard))  # Python ignores the signal that comes with it
    try:
        found = CliRunner().invoke(cli, arguments)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, hard))
    assert isinstance(found.exception, PerfboundError), found.output
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


def test_what_a_user_has_changed_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PERFBOUND_SECRET", "a secret of the test")
    arguments = ["slurm", str(CAMPAIGN), "--workers", "3", "--folder", str(tmp_path), "--dry-run"]
    workers = tmp_path / "workers.sh"

    def written(*more: str) -> tuple[str, dict[str, str]]:
        found = CliRunner().invoke(cli, [*arguments, *more])
        assert found.exit_code == 0, found.output
        return found.stderr, {path.name: path.read_text() for path in tmp_path.glob("*.before*")}

    assert written() == ("", {})
    plain = workers.read_text()
    mine = plain.replace("--requeue", "--requeue\n#SBATCH --qos=high")
    workers.write_text(mine)
    line, kept = written()
    assert says(line, f"^perfbound: {tmp_path}: workers.sh.before own: {tmp_path}/submit.sh")
    assert kept == {"workers.sh.before": mine}
    assert workers.read_text() == plain
    assert written() == ("", {"workers.sh.before": mine})
    _, kept = written("--workers", "4")
    assert kept == {"workers.sh.before": mine, "workers.sh.before-2": plain}
    workers.write_text(mine)
    line, kept = written()
    assert "kept as workers.sh.before;" in line
    assert kept == {"workers.sh.before": mine, "workers.sh.before-2": plain}, "what is kept already is not kept again"


@pytest.mark.parametrize("endpoint", ["tls/login:7447", "quic/login:7447"])
def test_an_encrypted_router_asks_for_certificates(endpoint: str, tmp_path: Path) -> None:
    arguments = [str(CAMPAIGN), "--workers", "3", "--folder", str(tmp_path / "jobs"), "--router", endpoint]
    found = CliRunner().invoke(cli, ["slurm", *arguments])
    assert found.exit_code == 2
    assert found.output.splitlines()[-1].startswith(f"Error: --router {endpoint}: ")
    assert says(found.output, "`perfbound pki issue` --tls FOLDER")
    assert not (tmp_path / "jobs").exists()


def test_a_router_without_encryption_takes_no_certificates(tmp_path: Path) -> None:
    arguments = [str(CAMPAIGN), "--workers", "3", "--router", "tcp/login:7447", "--tls", str(tmp_path)]
    found = CliRunner().invoke(cli, ["slurm", *arguments])
    assert found.exit_code == 2
    assert says(found.output, "--router tcp/login:7447: --tls tls/HOST:PORT")


def test_with_a_router_elsewhere_no_certificate_is_asked_for_it() -> None:
    options = replace(OPTIONS, router="tls/login:7447", tls=Path("/nowhere"))
    assert {path.parent.name for path in missing_files(options)} == {"orchestrator", "worker"}


def test_certificates_that_are_not_there_are_named(tmp_path: Path) -> None:
    arguments = [str(CAMPAIGN), "--workers", "3", "--folder", str(tmp_path), "--tls", str(tmp_path), "--dry-run"]
    found = CliRunner().invoke(cli, ["slurm", *arguments])
    assert str(found.exception).startswith(f"--tls: {tmp_path}/router/ca.pem: no such file")
