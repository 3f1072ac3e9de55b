"""Shared fixtures of the test suite, order of the tests, property seeds and expected skips.

``--strict-skips`` (``make test``) fails the run if a test was skipped for a reason that is not in
:data:`EXPECTED_SKIPS`, so that a missing package or tool is noticed.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import pickle
import re
import shutil
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

# The tests run in one process per core. A second BLAS thread in each process only waits actively; it took two fifths of
# the processor time of the diagnoses. NumPy reads this variable at import; a value set by the user has priority.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import pytest
from property_example_count import scale_example_count

if TYPE_CHECKING:
    from output_damage.damage_case import Job

ROOT = Path(__file__).resolve().parents[1]
T = TypeVar("T")
EXPECTED_SKIPS = (
    r"(is|are) not here",  # real data that are not in a development checkout
    r"is absent",
    r"the pages' scripts are not exercised",  # no browser; in CI tests/browser_driver.py fails instead
    r"could not import 'eaik",  # a third independent solver with thirty dependencies: extra `compare`
    r"rs274 \(linuxcnc-uspace\) is not installed",
    r"POSIX signals",
    r"no symbolic links",
)
"""Patterns of permitted skip reasons; any other skip means that something is missing in the environment."""

hypothesis.settings.register_profile(  # the same examples in every run, independent of the load
    "ci", derandomize=True, deadline=None, database=None, print_blob=True
)
hypothesis.settings.register_profile("dev", deadline=None)
hypothesis.settings.register_profile(  # `make nightly`: new and many examples each time; a failure prints its blob
    "nightly", deadline=None, max_examples=scale_example_count(100), database=None, print_blob=True
)
PROFILE = os.environ.get("HYPOTHESIS_PROFILE") or ("ci" if os.environ.get("CI") else "dev")
hypothesis.settings.load_profile(PROFILE)

_skips: Counter[str] = Counter()
_seconds: defaultdict[str, float] = defaultdict(float)
_longest: defaultdict[str, float] = defaultdict(float)
_longest_calls: defaultdict[str, float] = defaultdict(float)
_begun = [0.0]
PROCESSOR = "processor_s"
SLOW = Path(__file__).with_name("slow_tests.txt")
"""Tests excluded from `quick`: tests with one case of LONG seconds of processor time or more when recorded
(``--record-slow``), and modules with LONG_MODULE seconds in total, including fixtures."""
LONG, LONG_MODULE = 0.15, 10.0
PROOFS = Path(__file__).with_name("long_tests.txt")
"""Proof tests by duration: tests with one case of LONG_TEST seconds or more, without fixtures, when recorded. Other
proof tests carry the mark in their module."""
LONG_TEST = 5.0
SECONDS = Path(__file__).with_name("module_durations.txt")
"""Recorded processor time of each module from NOTED seconds on, longest first; it determines the order of a run."""
NOTED = 1.0


def _function(nodeid: str) -> str:
    """Return the test without its parameters: all cases of a test have the same mark."""
    return nodeid.partition("[")[0]


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Start a Dask cluster with two workers."""
    from distributed import LocalCluster

    # without these options Dask opens port 8787 even without a dashboard
    pages = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(
        n_workers=2, threads_per_worker=1, scheduler_kwargs=pages, memory_limit=0, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="session", autouse=True)
def _no_wait_for_the_disk() -> Iterator[None]:
    """Disable fsync: no test checks the state after a power failure, and fsync takes a twelfth of the time of a
    short command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture(scope="session")
def shared_result(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], T]], T]:
    """``shared_result(key, make)``: return the result of ``make(folder)``, computed once for all tests and processes of
    a run.

    ``make`` writes into its own empty folder and returns a picklable object. No test writes into that folder
    afterwards: a test that damages files copies it first.
    """
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base) / "shared"

    def get(key: str, make: Callable[[Path], T]) -> T:
        place = shared / hashlib.sha256(key.encode()).hexdigest()[:16]
        place.mkdir(parents=True, exist_ok=True)
        with lock_exclusively(place / "lock"):
            if not (place / "result").exists():
                shutil.rmtree(place / "folder", ignore_errors=True)  # remainder of a failed call of ``make``
                (place / "folder").mkdir()
                found = make(place / "folder")
                (place / "result").write_bytes(pickle.dumps(found))
        return cast("T", pickle.loads((place / "result").read_bytes()))

    return get


@pytest.fixture(scope="session")
def damage_job(shared_result: Callable[[str, Callable[[Path], Job]], Job]) -> Callable[[str], Job]:
    """``damage_job(name)``: a job of the package ``output_damage``, planned once. The test imports the module that
    defines it."""
    from output_damage.damage_case import JOBS

    return lambda name: shared_result(f"job of the damages: {name}", JOBS[name])


@pytest.fixture(scope="session")
def shipped_plan(
    shared_result: Callable[[str, Callable[[Path], tuple[int, Path]]], tuple[int, Path]],
) -> Callable[..., Path]:
    """``shipped_plan(cell, toolpath, *options)``: output folder of ``machopt optimize``, computed once for all tests
    and processes.

    ``cell`` and ``toolpath`` are names in cells/ and toolpaths/, or paths. No test writes into the folder.
    """

    def plan(cell: Path | str, toolpath: Path | str, *options: str) -> Path:
        from machopt.cli import main

        words = [str(ROOT / "cells" / cell), str(ROOT / "toolpaths" / toolpath), *options]

        def make(folder: Path) -> tuple[int, Path]:
            out = folder / "out"
            return main(["optimize", *words[:2], "-o", str(out), "--quiet", *options]), out

        code, out = shared_result("\0".join(words), make)
        assert code == 0, f"machopt optimize {' '.join(words)} ended with {code}"
        return out

    return plan


@contextlib.contextmanager
def lock_exclusively(lock: Path) -> Iterator[None]:
    """Allow only one test process at a time to run the block."""
    import fcntl

    with lock.open("a") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--record-slow",
        action="store_true",
        help=f"write tests/{SLOW.name}, {PROOFS.name} and {SECONDS.name} anew for the modules of this run",
    )
    parser.addoption("--strict-skips", action="store_true", help="fail where a test is skipped for no expected reason")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not import modules of which ``make quick`` runs no test."""
    if not config.getoption("markexpr").startswith("not slow"):
        return None
    known = SLOW.read_text(encoding="utf-8").split()
    return True if collection_path.relative_to(ROOT).as_posix() in known else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Import the modules in reverse order in every second process: in a new checkout, two processes then rewrite the
    assertions of half of the modules each and use the files that the other one stored."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
    if int(worker.removeprefix("gw")) % 2 == 0 or session.config.args != session.config.getini("testpaths"):
        return
    for file in sorted(Path(__file__).parent.glob("test_*.py"), reverse=True):
        if not pytest_ignore_collect(file, session.config):
            with contextlib.suppress(Exception, pytest.skip.Exception):  # reported later by the collection
                importlib.import_module(file.stem)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests with a long recorded duration, and run the longest modules first.

    The last module shared by two processes must be short, otherwise one process waits for the other. New modules with
    slow tests have no recorded duration and come first.
    """
    known, proofs = (set(names.read_text(encoding="utf-8").split()) for names in (SLOW, PROOFS))
    for item in items:
        if known & {_function(item.nodeid), item.nodeid.partition("::")[0]}:
            item.add_marker(pytest.mark.slow)
        if _function(item.nodeid) in proofs:
            item.add_marker(pytest.mark.proof)
    slow = Counter(i.path for i in items if i.get_closest_marker("slow") or i.get_closest_marker("proof"))
    took = seconds_of(SECONDS.read_text(encoding="utf-8"))
    unknown = {i.path: 0.0 if slow[i.path] == 0 else float("inf") for i in items}
    items.sort(key=lambda item: (-took.get(item.nodeid.partition("::")[0], unknown[item.path]), -slow[item.path]))


def processor_seconds() -> float:
    """Return user and system time of this process and of the child processes that it waited for."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    _begun[0] = processor_seconds()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Record the processor time of each phase; on a busy machine the wall time of every test is long."""
    report = yield
    now = processor_seconds()
    report.user_properties.append((PROCESSOR, now - _begun[0]))
    _begun[0] = now
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _note_skip(report)
    # the properties accumulate over the phases of a test; the last one belongs to this phase
    took = [seconds for name, seconds in report.user_properties if name == PROCESSOR][-1]
    assert isinstance(took, float)
    _seconds[report.nodeid.partition("::")[0]] += took
    _longest[_function(report.nodeid)] = max(_longest[_function(report.nodeid)], took)
    if report.when == "call":  # the time of a shared fixture is counted for the first test that needs it
        _longest_calls[_function(report.nodeid)] = max(_longest_calls[_function(report.nodeid)], took)


def _note_skip(report: pytest.TestReport | pytest.CollectReport) -> None:
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        _skips[reason.removeprefix("Skipped: ")] += 1


def unexpected_skips(skips: Counter[str]) -> Counter[str]:
    """Return the skips whose reason matches no pattern of :data:`EXPECTED_SKIPS`."""
    return Counter({why: n for why, n in skips.items() if not any(re.search(p, why) for p in EXPECTED_SKIPS)})


def slow_list(known: Iterable[str], seconds: Mapping[str, float], longest: Mapping[str, float]) -> list[str]:
    """Return the lines of SLOW: new durations for tests that ran, other lines unchanged, without tests that no
    longer exist."""
    retained = {n for n in known if n not in seconds and n not in longest and is_there(n)}
    modules = {name for name, took in seconds.items() if took >= LONG_MODULE}
    tests = retained | {n for n, took in longest.items() if took >= LONG}
    return sorted(modules | {n for n in tests if n.partition("::")[0] not in modules})


def list_long_tests(known: Iterable[str], longest: Mapping[str, float]) -> list[str]:
    """Return the lines of PROOFS: new durations for tests that ran, other lines unchanged, without tests that no longer
    exist.

    Args:
        known: lines of the file.
        longest: seconds of the longest case of each test that ran.
    """
    retained = {name for name in known if name not in longest and is_there(name)}
    return sorted(retained | {name for name, seconds in longest.items() if seconds >= LONG_TEST})


def is_there(name: str) -> bool:
    """Return whether a module, or a test in it, still exists with this name."""
    file, _, test = name.partition("::")
    path = ROOT / file
    return path.exists() and (not test or f"def {test}(" in path.read_text(encoding="utf-8"))


def seconds_of(text: str) -> dict[str, float]:
    """Return seconds by module from the text of SECONDS."""
    return {name: float(took) for took, name in (line.split() for line in text.splitlines())}


def seconds_list(known: Mapping[str, float], seconds: Mapping[str, float]) -> list[str]:
    """Return the lines of SECONDS: new times for modules that ran, other lines unchanged, without modules that no
    longer exist."""
    every = {n: s for n, s in {**known, **seconds}.items() if n in seconds or (ROOT / n).exists()}
    return [f"{s:6.1f} {n}" for n, s in sorted(every.items(), key=lambda of: (-of[1], of[0])) if s >= NOTED]


def pytest_sessionfinish(session: pytest.Session) -> None:
    if session.config.getoption("--record-slow") and not hasattr(session.config, "workerinput"):
        if "slow" not in session.config.getoption("markexpr"):  # without slow tests the time of a module is incomplete
            known = seconds_of(SECONDS.read_text(encoding="utf-8"))
            SECONDS.write_text("\n".join(seconds_list(known, _seconds)) + "\n", encoding="utf-8")
        lines = slow_list(SLOW.read_text(encoding="utf-8").split(), _seconds, _longest)
        SLOW.write_text("\n".join(lines) + "\n", encoding="utf-8")
        lines = list_long_tests(PROOFS.read_text(encoding="utf-8").split(), _longest_calls)
        PROOFS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    strict = session.config.getoption("--strict-skips") and not hasattr(session.config, "workerinput")
    if strict and unexpected_skips(_skips) and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print unexpected skips and the slowest modules; the time limit is one minute for `make quick` and ten minutes
    for all tests."""
    for why, n in sorted(unexpected_skips(_skips).items()):
        terminalreporter.write_line(f"UNEXPECTED SKIP ×{n}: {why}", red=True)
    expected = _skips - unexpected_skips(_skips)
    if expected:
        words = "; ".join(f"{n} × {why}" for why, n in sorted(expected.items()))
        terminalreporter.write_line(f"expected skips: {words}")
    total = sum(_seconds.values())
    if total > 60.0:
        terminalreporter.section(f"slowest modules, of {total:.0f} s of processor time")
        for module, seconds in sorted(_seconds.items(), key=lambda item: -item[1])[:40]:
            terminalreporter.line(f"{seconds:7.1f} s  {module}")
