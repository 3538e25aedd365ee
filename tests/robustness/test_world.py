"""Faults of the world: no space, no place, no reader, no locale, killed. Nothing half-written, and
the same command goes on; worker processes leave nothing."""

from __future__ import annotations

import hashlib
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from hiltestbed.compiled.kernel_cache import VARIABLE, settle
from hiltestbed.config.gallery import shipped
from hiltestbed.process.workers import Workers
from hiltestbed.run_folder.store import write_run
from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import run
from tests.scripts import CLI, program
from tests.slow import SLOW, slow

BUMPER = shipped("scenarios") / "02-bumper.yaml"
LANGUAGES = {
    "ascii": {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
    "unknown": {"LANG": "xx_XX"},
}


def short(folder: Path, *more: str) -> list[str]:
    return ["run", str(BUMPER), "--set", "duration=0.2", "--no-rerun", "--out", str(folder), *more]


def _small_files(size: int) -> Callable[[], None]:
    def before() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return before


@pytest.mark.parametrize("size", [slow(20_000), 1_000_000])
def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, size: int) -> None:
    """The trace does not fit; and, of a run with a recording, the recording alone."""
    order = short(tmp_path / "r", "--set", "duration=0.4")
    order.remove("--no-rerun")
    done = program(*CLI, *order, preexec_fn=_small_files(size))
    assert (done.returncode, "Traceback" in done.stderr) == (1, False)
    assert "File too large" in done.stderr
    assert list(tmp_path.iterdir()) == []


# each compiles the kernels: nowhere to keep them
@SLOW
@pytest.mark.parametrize("language", LANGUAGES)
def test_no_home_no_locale_and_forty_columns(tmp_path: Path, language: str) -> None:
    names = {"PATH", "PYTHONPATH", VARIABLE} & set(os.environ)
    env = {name: os.environ[name] for name in names} | {"COLUMNS": "40", "TERM": "dumb"}
    env |= LANGUAGES[language]
    scenario = BUMPER.read_text().replace("name: ", "name: ß→µ ")
    (tmp_path / "s.yaml").write_text(scenario, encoding="utf-8")
    order = ["run", str(tmp_path / "s.yaml"), *short(tmp_path / "r")[2:]]
    files = str(tmp_path / "r" / "scenario.yaml"), str(tmp_path / "none.yaml")
    for status, arguments in ((0, order), (2, ["check", *files])):
        done = program(*CLI, *arguments, env=env)
        assert (done.returncode, "Traceback" in done.stderr) == (status, False), done.stderr
        assert done.stdout


NOISY = {"duration": 0.2, "sensor.noise": 0.5, "seed": 11}


@pytest.mark.parametrize("kernels", ["as they are", pytest.param("compiled anew", marks=SLOW)])
def test_same_seed_same_bytes(tmp_path: Path, kernels: str) -> None:
    """In another process, folder and working directory, with other numbers of threads."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    env = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "PYTHONHASHSEED": "7"}
    env["PYTHONPATH"] = os.pathsep.join([str(Path.cwd()), os.environ.get("PYTHONPATH", "")])
    if kernels == "compiled anew":
        env[VARIABLE] = str(tmp_path / "kernels")
    sets = [word for key, value in NOISY.items() for word in ("--set", f"{key}={value}")]
    order = ["run", str(BUMPER), *sets, "--no-rerun", "--out", str(elsewhere / "r")]
    program(*CLI, *order, env=env, cwd=elsewhere, timeout=590, check=True)
    here = write_run(run(load_scenario(BUMPER, NOISY)), tmp_path / "here", rerun=False)
    assert _sha(elsewhere / "r" / "trace.parquet") == _sha(here / "trace.parquet")


def _sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_kernels_have_a_place_where_package_and_home_are_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for environment in ({}, {"HOME": "/nowhere"}, {VARIABLE: "/dev/null/x"}):
        settle(Path("/usr/lib/hiltestbed"), environment, lambda folder: False)
        assert Path(environment[VARIABLE]).is_dir()
    left_alone: dict[str, str] = {"HOME": "/home/x"}
    settle(Path("/usr/lib/hiltestbed"), left_alone, lambda folder: "home" in str(folder))
    assert VARIABLE not in left_alone
    hostile = Path(tmp_path) / f"hiltestbed-kernels-{os.getuid()}"
    hostile.chmod(0o777)
    environment = {}
    settle(Path("/usr/lib/hiltestbed"), environment, lambda folder: False)
    assert environment[VARIABLE] != str(hostile)


SHARED = Path("/dev/shm")


def semaphores() -> set[str]:
    """Named ones; the shared memory beside them may be of any other process."""
    return {name for name in os.listdir(SHARED) if name.startswith("sem.")}


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail() -> None:
    raise ValueError("as it is")


def refuse_to_travel() -> object:
    return lambda: None


@pytest.mark.skipif(sys.platform != "linux", reason="looks at the kernel's tables")
def test_workers_answer_and_leave_nothing() -> None:
    before = semaphores()
    pool = Workers(2)
    try:
        one, two = pool.submit(divmod, 17, 5), pool.submit(fail)
        assert one.result() == (3, 2)
        with pytest.raises(ValueError, match="as it is"):
            two.result()
        with pytest.raises((AttributeError, TypeError)):
            pool.submit(refuse_to_travel).result()
        assert semaphores() <= before  # whoever is killed now
        with pytest.raises(BrokenProcessPool):
            pool.submit(die).result()
        busy = pool.submit(time.sleep, 600.0)
    finally:
        begin = time.monotonic()
        pool.shutdown(cancel_futures=True)
    # it was given to a worker, or not yet
    assert busy.cancelled() or isinstance(busy.exception(), BrokenProcessPool)
    assert time.monotonic() - begin < 60.0
    assert not any(child.is_alive() for child in pool._children)


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP", "SIGQUIT"])
def test_what_a_terminal_sends_to_all_is_for_the_parent(name: str) -> None:
    pool = Workers(1)
    try:
        number = pool.submit(os.getpid).result()
        os.kill(number, getattr(signal, name))
        assert pool.submit(os.getpid).result() == number
    finally:
        pool.shutdown()
