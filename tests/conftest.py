"""Shared fixtures of the test suite, and its order, property seeds and expected skips.

``--strict-skips`` (``make test``) fails the run where a test was skipped for a reason that is not in
:data:`EXPECTED_SKIPS`: a package or a tool that went missing must not turn a proof into silence.
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

# One process a core runs the tests; a second BLAS thread in each would only wait actively for its partner: of the
# processor time of the diagnoses that was two fifths. NumPy reads this when it is imported; whoever sets it is obeyed.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import pytest
from property_example_count import scale_example_count

if TYPE_CHECKING:
    from output_damage.damage_case import Job

ROOT = Path(__file__).resolve().parents[1]
T = TypeVar("T")
EXPECTED_SKIPS = (
    r"(is|are) not here",  # the real data beside a development checkout
    r"is absent",
    r"the pages' scripts are not exercised",  # no browser: not in CI, where tests/browser_driver.py fails
    r"could not import 'eaik",  # a third independent solver, with thirty packages behind it: extra `compare`
    r"rs274 \(linuxcnc-uspace\) is not installed",
    r"POSIX signals",
    r"no symbolic links",
)
"""Patterns of reasons for which a test may be skipped; any other is a hole in the environment."""

hypothesis.settings.register_profile(  # the same examples in every run, whatever the machine's load
    "ci", derandomize=True, deadline=None, database=None, print_blob=True
)
hypothesis.settings.register_profile("dev", deadline=None)
hypothesis.settings.register_profile(  # `make nightly`: other examples each time, and many; a failure prints its blob
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
"""No part of `quick`: tests of which one case took LONG seconds of processor time or more when they were recorded
(``--record-slow``), and modules that took LONG_MODULE seconds in all, their fixtures included."""
LONG, LONG_MODULE = 0.15, 10.0
PROOFS = Path(__file__).with_name("long_tests.txt")
"""Proofs by their length: tests of which one case took LONG_TEST seconds or more, without fixtures, when they were
recorded. Others carry the mark themselves."""
LONG_TEST = 5.0
SECONDS = Path(__file__).with_name("module_durations.txt")
"""What each module took of the processor when it was recorded, the longest first, from NOTED seconds on: the order of a
run."""
NOTED = 1.0


def _function(nodeid: str) -> str:
    """Without the parameters: all cases of a test are in one tier."""
    return nodeid.partition("[")[0]


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A running cluster with two workers, as a lab would have one."""
    from distributed import LocalCluster

    pages = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}  # Dask opens its port 8787 without any, too
    with LocalCluster(
        n_workers=2, threads_per_worker=1, scheduler_kwargs=pages, memory_limit=0, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="session", autouse=True)
def _no_wait_for_the_disk() -> Iterator[None]:
    """No test can see whether files would be there after a power failure; a twelfth of a short command is that wait."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture(scope="session")
def shared_result(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], T]], T]:
    """``shared_result(key, make)``: what ``make(folder)`` returned, made once for all tests and processes of a run.

    ``make`` writes into an empty folder of its own and returns something that can be pickled. Nobody writes into that
    folder afterwards: a test that damages something copies it first.
    """
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base) / "shared"

    def get(key: str, make: Callable[[Path], T]) -> T:
        place = shared / hashlib.sha256(key.encode()).hexdigest()[:16]
        place.mkdir(parents=True, exist_ok=True)
        with lock_exclusively(place / "lock"):
            if not (place / "result").exists():
                shutil.rmtree(place / "folder", ignore_errors=True)  # left by a run of ``make`` that failed
                (place / "folder").mkdir()
                found = make(place / "folder")
                (place / "result").write_bytes(pickle.dumps(found))
        return cast("T", pickle.loads((place / "result").read_bytes()))

    return get


@pytest.fixture(scope="session")
def damage_job(shared_result: Callable[[str, Callable[[Path], Job]], Job]) -> Callable[[str], Job]:
    """``damage_job(name)``: a job of the package ``output_damage``, planned once. The test imports the part with it."""
    from output_damage.damage_case import JOBS

    return lambda name: shared_result(f"job of the damages: {name}", JOBS[name])


@pytest.fixture(scope="session")
def shipped_plan(
    shared_result: Callable[[str, Callable[[Path], tuple[int, Path]]], tuple[int, Path]],
) -> Callable[..., Path]:
    """``shipped_plan(cell, toolpath, *options)``: OUT of ``machopt optimize``, made once for all tests and processes.

    ``cell`` and ``toolpath`` are names in cells/ and toolpaths/ or paths. Nobody writes into OUT.
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
    """Of several test processes, one at a time."""
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
    """``make quick`` does not import modules of which it runs no test."""
    if not config.getoption("markexpr").startswith("not slow"):
        return None
    known = SLOW.read_text(encoding="utf-8").split()
    return True if collection_path.relative_to(ROOT).as_posix() in known else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Every second process imports the modules from the last to the first: after a change of all of them, as in a new
    checkout, two processes rewrite the assertions of half of them each and find what the other one stored."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
    if int(worker.removeprefix("gw")) % 2 == 0 or session.config.args != session.config.getini("testpaths"):
        return
    for file in sorted(Path(__file__).parent.glob("test_*.py"), reverse=True):
        if not pytest_ignore_collect(file, session.config):
            with contextlib.suppress(Exception, pytest.skip.Exception):  # the collection tells it
                importlib.import_module(file.stem)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what took long when it was recorded, and put the longest modules first.

    The last module that two processes share out must be a short one, or one of them waits for the other. Durations of
    new modules with slow tests are unknown; these come first.
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
    """User and system time of this process and of those that it started and waited for."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    _begun[0] = processor_seconds()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """What this phase took: of the processor, for a busy machine makes every test long."""
    report = yield
    now = processor_seconds()
    report.user_properties.append((PROCESSOR, now - _begun[0]))
    _begun[0] = now
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _note_skip(report)
    # the properties pile up from phase to phase of a test; the last one is this phase's
    took = [seconds for name, seconds in report.user_properties if name == PROCESSOR][-1]
    assert isinstance(took, float)
    _seconds[report.nodeid.partition("::")[0]] += took
    _longest[_function(report.nodeid)] = max(_longest[_function(report.nodeid)], took)
    if report.when == "call":  # a shared fixture is paid by the first test that needs it, whichever that is
        _longest_calls[_function(report.nodeid)] = max(_longest_calls[_function(report.nodeid)], took)


def _note_skip(report: pytest.TestReport | pytest.CollectReport) -> None:
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        _skips[reason.removeprefix("Skipped: ")] += 1


def unexpected_skips(skips: Counter[str]) -> Counter[str]:
    """Those whose reason no pattern of :data:`EXPECTED_SKIPS` names."""
    return Counter({why: n for why, n in skips.items() if not any(re.search(p, why) for p in EXPECTED_SKIPS)})


def slow_list(known: Iterable[str], seconds: Mapping[str, float], longest: Mapping[str, float]) -> list[str]:
    """The lines of SLOW: what ran by what it took now, the rest as it stands, none that is gone."""
    retained = {n for n in known if n not in seconds and n not in longest and is_there(n)}
    modules = {name for name, took in seconds.items() if took >= LONG_MODULE}
    tests = retained | {n for n, took in longest.items() if took >= LONG}
    return sorted(modules | {n for n in tests if n.partition("::")[0] not in modules})


def list_long_tests(known: Iterable[str], longest: Mapping[str, float]) -> list[str]:
    """Return the lines of PROOFS: what ran by its longest case now, the rest unchanged, none that is gone.

    Args:
        known: lines of the file.
        longest: seconds of the longest case of each test that ran.
    """
    retained = {name for name in known if name not in longest and is_there(name)}
    return sorted(retained | {name for name, seconds in longest.items() if seconds >= LONG_TEST})


def is_there(name: str) -> bool:
    """Whether a module, or a test of one, still has this name."""
    file, _, test = name.partition("::")
    path = ROOT / file
    return path.exists() and (not test or f"def {test}(" in path.read_text(encoding="utf-8"))


def seconds_of(text: str) -> dict[str, float]:
    """Seconds by module, out of SECONDS."""
    return {name: float(took) for took, name in (line.split() for line in text.splitlines())}


def seconds_list(known: Mapping[str, float], seconds: Mapping[str, float]) -> list[str]:
    """The lines of SECONDS: modules that ran by what they took now, others as they stand, none that is gone."""
    every = {n: s for n, s in {**known, **seconds}.items() if n in seconds or (ROOT / n).exists()}
    return [f"{s:6.1f} {n}" for n, s in sorted(every.items(), key=lambda of: (-of[1], of[0])) if s >= NOTED]


def pytest_sessionfinish(session: pytest.Session) -> None:
    if session.config.getoption("--record-slow") and not hasattr(session.config, "workerinput"):
        if "slow" not in session.config.getoption("markexpr"):  # else a module's own seconds are not whole
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
    """Skips that nobody expects, and where the time goes: the budget is a minute for `make quick`, ten for all."""
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
