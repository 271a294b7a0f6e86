"""What the launchers hand on to srun, sbatch, qsub and mpirun; programs that note their arguments stand for these."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ("awk", "bash", "cat", "dirname", "grep", "mktemp", "rm", "sed", "tr")
LAUNCHERS = ("local", "hostfile", "slurm", "pbs")
ARGUMENTS = ("render", "a scene.yaml", "-D", "volumes.0.opacity=[[0, 0], [1, 1]]", "-o", "it's.png")


class Desk:
    """A checkout whose launch/setup has nothing to do, on a machine whose programs write down how they were called."""

    def __init__(self, folder: Path) -> None:
        self.checkout, self.bin, self.logs = folder / "check out", folder / "bin", folder / "logs"
        shutil.copytree(ROOT / "launch", self.checkout / "launch")
        for path in (self.bin, self.logs, self.checkout / ".venv" / "bin"):
            path.mkdir(parents=True)
        for tool in TOOLS:
            found = shutil.which(tool)
            assert found, tool
            (self.bin / tool).symlink_to(found)
        self.write(self.checkout / "launch" / "setup", "exit 0")
        self.clusterviz = self.checkout / ".venv" / "bin" / "clusterviz"
        self.recorder(self.clusterviz)
        self.mpi("wheel")

    def mpi(self, kind: str) -> None:
        (self.checkout / ".venv" / "mpi").write_text(kind + "\n")

    def write(self, path: Path, text: str) -> None:
        path.write_text(f"#!{shutil.which('bash')}\n{text}\n")
        path.chmod(0o755)

    def recorder(self, path: Path, first: str = "") -> None:
        """A program that does something first, then writes its arguments to logs/NAME, ended by zeros."""
        self.write(path, f"{first}\nprintf '%s\\0' \"$@\" >{shlex.quote(str(self.logs / path.name))}")

    def program(self, name: str, first: str = "") -> None:
        self.recorder(self.bin / name, first)

    def called(self, name: str) -> list[str] | None:
        """The arguments of a program's last call; None where it was not called."""
        log = self.logs / name
        return log.read_text().split("\0")[:-1] if log.exists() else None

    def run(self, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
        variables = {"PATH": str(self.bin), "HOME": str(self.logs), **environment}
        script, *arguments = command
        where = script if os.path.isabs(script) else str(self.checkout / "launch" / script)
        return subprocess.run(
            [where, *arguments], env=variables, cwd=self.logs, capture_output=True, text=True, timeout=60
        )


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def srun_that_lists(*plugins: str) -> str:
    """srun --mpi=list, as Slurm 23 prints it."""
    lines = "\\n\\t".join(["MPI plugin types are...", *plugins])
    return f"""if [ "$*" = --mpi=list ]; then printf '{lines}\\n'; exit; fi"""


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_a_launcher_is_a_story_of_eighty_lines(launcher: str) -> None:
    text = (ROOT / "launch" / launcher).read_text()
    assert len(text.splitlines()) <= 80
    assert "set -euo pipefail\n" in text
    assert os.access(ROOT / "launch" / launcher, os.X_OK)


def test_slurm_submits_what_the_job_then_runs(desk: Desk) -> None:
    desk.program("sbatch")
    desk.program("srun", srun_that_lists("none", "pmi2", "pmix"))
    ended = desk.run("slurm", "-N", "2", "--ntasks-per-node=4", "--", *ARGUMENTS)
    assert (ended.returncode, ended.stderr) == (0, "")
    sent = desk.called("sbatch")
    assert sent is not None
    assert sent[:4] == ["--job-name=clusterviz-render", "-N", "2", "--ntasks-per-node=4"]
    assert desk.called("srun") is None
    wrapped = sent[4].removeprefix("--wrap=")
    ended = desk.run("/bin/sh", "-c", wrapped, SLURM_JOB_ID="7")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert desk.called("srun") == ["--mpi=pmi2", "--kill-on-bad-exit=1", str(desk.clusterviz), *ARGUMENTS]


@pytest.mark.parametrize(
    ("mpi", "plugins", "chosen"),
    [
        ("site", ("none", "pmi2", "pmix", "pmix_v4"), "pmix"),
        ("site", ("none", "pmi2"), "pmi2"),
        ("wheel", ("pmix", "pmi2"), "pmi2"),
        ("site", ("pmix_v4", "cray_shasta"), None),
        ("wheel", ("pmix",), None),
    ],
)
def test_slurm_takes_a_plugin_that_both_sides_speak(
    mpi: str, plugins: tuple[str, ...], chosen: str | None, desk: Desk
) -> None:
    desk.mpi(mpi)
    desk.program("srun", srun_that_lists(*plugins))
    ended = desk.run("slurm", "doctor", SLURM_JOB_ID="7")
    called = desk.called("srun")
    assert ended.returncode == (0 if chosen else 1)
    assert (called[0] if called else None) == (f"--mpi={chosen}" if chosen else None)
    assert ("srun knows none of" in ended.stderr) == (chosen is None)


def test_slurm_takes_the_plugin_that_is_named(desk: Desk) -> None:
    desk.program("srun", srun_that_lists("cray_shasta"))
    ended = desk.run("slurm", "doctor", SLURM_JOB_ID="7", CLUSTERVIZ_SRUN_MPI="cray_shasta")
    assert (ended.returncode, (desk.called("srun") or [""])[0]) == (0, "--mpi=cray_shasta")


def test_slurm_shows_each_rank_all_gpus_and_hands_on_its_cores(desk: Desk) -> None:
    desk.program("srun", srun_that_lists("pmi2"))
    desk.run("slurm", "doctor", SLURM_JOB_ID="7", SLURM_GPUS_ON_NODE="4", SLURM_CPUS_PER_TASK="8")
    options = ["--mpi=pmi2", "--kill-on-bad-exit=1", "--gpu-bind=none", "--cpus-per-task=8"]
    assert desk.called("srun") == [*options, str(desk.clusterviz), "doctor"]


@pytest.mark.parametrize("command", ["scale", "verify", "tradeoff", "profile"])
@pytest.mark.parametrize(("launcher", "job"), [("slurm", "SLURM_JOB_ID"), ("pbs", "PBS_JOBID")])
def test_commands_that_start_mpirun_run_once(launcher: str, job: str, command: str, desk: Desk) -> None:
    desk.program("srun", srun_that_lists("pmi2"))
    desk.program("mpirun")
    ended = desk.run(launcher, command, "scene.yaml", **{job: "7"})
    assert (ended.returncode, ended.stderr) == (0, "")
    assert desk.called("clusterviz") == [command, "scene.yaml"]
    assert desk.called("srun") is desk.called("mpirun") is None


@pytest.mark.parametrize(
    ("plugins", "told"),
    [(("pmi2",), "srun --mpi=pmi2 --kill-on-bad-exit=1 --gpu-bind=none --cpus-per-task=8"), (("pmix",), "")],
)
def test_commands_that_start_ranks_are_told_how_under_slurm(plugins: tuple[str, ...], told: str, desk: Desk) -> None:
    """By srun with the options that `render` gets; by mpirun where srun does not speak the MPI's language."""
    desk.program("srun", srun_that_lists(*plugins))
    desk.recorder(desk.clusterviz, f'printf %s "${{CLUSTERVIZ_LAUNCHER:-}}" >{shlex.quote(str(desk.logs / "told"))}')
    ended = desk.run("slurm", "scale", "s.yaml", SLURM_JOB_ID="7", SLURM_GPUS_ON_NODE="4", SLURM_CPUS_PER_TASK="8")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert (desk.logs / "told").read_text() == told
    assert desk.called("clusterviz") == ["scale", "s.yaml"]


def test_pbs_submits_what_the_job_then_runs(desk: Desk) -> None:
    script, nodes = desk.logs / "script", desk.logs / "nodes"
    desk.program("qsub", f"cat >{shlex.quote(str(script))}")
    desk.program("mpirun", 'if [ "$1" = -f ]; then cat "$2"; fi')
    ended = desk.run("pbs", "-l", "select=2:mpiprocs=2", "--", *ARGUMENTS)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert desk.called("qsub") == ["-N", "clusterviz-render", "-l", "select=2:mpiprocs=2"]
    nodes.write_text("n1\nn1\nn2\nn2\n")
    ended = desk.run("/bin/sh", str(script), PBS_JOBID="7", PBS_NODEFILE=str(nodes))
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "n1:2\nn2:2\n", "")
    assert (desk.called("mpirun") or [])[2:] == ["-n", "4", str(desk.clusterviz), *ARGUMENTS]


@pytest.mark.parametrize("text", ["# two\nn1:2 \n\nn2:1\n", "n1 slots=2 # fast\nn2\n", "n1\nn2\nn1\n"])
@pytest.mark.parametrize(
    ("version", "written", "options"),
    [
        ("HYDRA build details", "n1:2\nn2:1\n", ["-f", "FILE", "-n", "3"]),
        ("mpirun (Open MPI) 4.1.4", "n1 slots=2\nn2 slots=1\n", ["--hostfile", "FILE", "-n", "3", "--bind-to", "none"]),
    ],
)
def test_host_files_are_rewritten_for_the_mpirun(
    text: str, version: str, written: str, options: list[str], desk: Desk
) -> None:
    hosts = desk.logs / "hosts.txt"
    hosts.write_text(text)
    desk.program("mpirun", f'if [ "$1" = --version ]; then echo "{version}"; exit; fi; cat "$2"')
    ended = desk.run("hostfile", str(hosts), *ARGUMENTS)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, written, "")
    called = desk.called("mpirun") or []
    assert [called[0], "FILE", *called[2:]] == [*options, str(desk.clusterviz), *ARGUMENTS]
    assert not Path(called[1]).exists()


def test_open_mpi_is_told_which_variables_go_along(desk: Desk) -> None:
    (desk.logs / "hosts.txt").write_text("n1:2\n")
    desk.program("mpirun", 'if [ "$1" = --version ]; then echo "mpirun (Open MPI) 5.0.3"; exit; fi')
    desk.run("hostfile", "hosts.txt", "doctor", CLUSTERVIZ_EGL_DEVICE="1")
    called = desk.called("mpirun") or []
    assert called[called.index("-x") : -2] == ["-x", "CLUSTERVIZ_EGL_DEVICE"]


def test_more_ranks_than_slots_take_turns_and_a_failure_is_handed_on(desk: Desk) -> None:
    (desk.logs / "hosts.txt").write_text("n1:2\n")
    desk.program("mpirun", 'if [ "$1" = -f ]; then exit 3; fi')
    ended = desk.run("hostfile", "hosts.txt", "-n", "5", "doctor")
    assert (ended.returncode, "5 ranks in 2 slots: they take turns" in ended.stderr) == (3, True)


@pytest.mark.parametrize(("cores", "said"), [("2", "4 ranks on 2 cores: they take turns"), ("4", "")])
def test_local_says_where_ranks_outnumber_cores(cores: str, said: str, desk: Desk) -> None:
    desk.write(desk.bin / "nproc", f"echo {cores}")
    desk.program("mpirun")
    ended = desk.run("local", "4", *ARGUMENTS)
    assert (ended.returncode, desk.called("mpirun")) == (0, ["-n", "4", "clusterviz", *ARGUMENTS])
    assert said in ended.stderr
    assert bool(said) == bool(ended.stderr)


@pytest.mark.parametrize(
    ("command", "environment", "status", "said"),
    [
        *((launcher, "", 2, f"usage: launch/{launcher}") for launcher in LAUNCHERS),
        ("slurm -N 2 -- doctor", "SLURM_JOB_ID", 2, "is running"),
        ("pbs -N 2 -- doctor", "PBS_JOBID", 2, "is running"),
        ("slurm doctor", "", 1, "there is no sbatch here"),
        ("pbs doctor", "", 1, "there is no qsub here"),
        ("pbs doctor", "PBS_JOBID", 1, "PBS_NODEFILE names no file"),
        ("hostfile nowhere.txt doctor", "", 2, "cannot read the host file nowhere.txt"),
        ("hostfile empty.txt doctor", "", 2, "names no host"),
        ("hostfile none.txt doctor", "", 2, "no number of slots"),
        ("hostfile many.txt doctor", "", 2, "no number of slots"),
        # What starts mpirun is not started by it.
        ("local 2 scale scene.yaml", "", 2, "run  clusterviz scale scene.yaml"),
        ("hostfile hosts.txt scale scene.yaml", "", 2, "run  clusterviz scale scene.yaml"),
    ],
)
def test_what_cannot_be_started_is_said(command: str, environment: str, status: int, said: str, desk: Desk) -> None:
    for name, text in {"empty": "", "none": "n1:0\n", "many": "n1 slots=many\n", "hosts": "n1:2\n"}.items():
        (desk.logs / f"{name}.txt").write_text(text)
    desk.program("mpirun")
    ended = desk.run(*command.split(), **({environment: "7"} if environment else {}))
    assert (ended.returncode, said in ended.stderr, desk.called("mpirun")) == (status, True, None), ended.stderr
