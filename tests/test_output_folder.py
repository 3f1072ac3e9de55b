"""Output folders: complete or absent, one writer at a time, no lost user files, clear errors."""

from __future__ import annotations

import errno
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.manifest import FolderManifest
from machopt.errors import InputError
from machopt.output import MANIFEST, folder_swap, read_manifest, write_json, write_manifest, write_output_folder
from machopt.output import output_folder as folders
from machopt.output.manifest_file import find_differences

FILES = 12  # written by the process that is killed
KILLS = 100


def write(out: Path, generation: int = 1, files: int = 2) -> None:
    """Write a small output folder: every file contains its generation number."""
    with write_output_folder(out) as folder:
        fill(folder, generation, files)


def fill(folder: Path, generation: int, files: int = 2) -> None:
    write_json(folder / "result.json", {"machopt_result": 1, "generation": generation})
    for n in range(files):
        (folder / f"part{n}.txt").write_text(f"{generation}\n" * 50)
    write_manifest(folder, FolderManifest(command="test", verdict="", exit_code=0, versions={}, inputs=()), {})


def generation(out: Path) -> int:
    return int(json.loads((out / "result.json").read_text())["generation"])


def list_neighbours(out: Path) -> list[str]:
    """Return the names of all other entries in the parent folder."""
    return sorted(p.name for p in out.parent.iterdir() if p != out)


@pytest.fixture(params=[True, False], ids=["exchanged", "renamed twice"])
def _either_way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """File systems with and without an atomic exchange of two folders."""
    if not request.param:
        monkeypatch.setattr(folders, "exchange_folders", lambda a, b: False)


def test_output_folder_appears_as_a_whole(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with write_output_folder(out) as folder:
        write_json(folder / "result.json", {"machopt_result": 1, "a": np.float64(0.1), "b": np.array([1.0, np.nan])})
        assert not out.exists()
    assert json.loads((out / "result.json").read_text()) == {"machopt_result": 1, "a": 0.1, "b": [1.0, None]}
    with write_output_folder(out) as folder:  # our own output is replaced, not merged
        write_json(folder / "result.json", {"machopt_result": 2})
    assert [p.name for p in out.iterdir()] == ["result.json"]
    assert [p.name for p in out.parent.iterdir()] == ["out"]


def test_failure_leaves_the_old_output(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with write_output_folder(out) as folder:
        write_json(folder / "result.json", {"machopt_result": 1})
    with pytest.raises(RuntimeError), write_output_folder(out) as folder:  # noqa: PT012
        (folder / "half.csv").write_text("1")
        raise RuntimeError
    assert [p.name for p in out.iterdir()] == ["result.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_foreign_folder_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "result.json").write_text('{"score": 1}')
    (tmp_path / "file").write_text("x")
    monkeypatch.chdir(tmp_path)
    for name, message in (("photos", "not an earlier machopt output"), ("file", "is a file"), (".", "working")):
        with pytest.raises(InputError, match=message), write_output_folder(tmp_path / name):
            pytest.fail("not reached")
    assert (tmp_path / "photos" / "result.json").exists()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_killed_run_leaves_nothing(tmp_path: Path, number: signal.Signals, code: int) -> None:
    script = (
        "import signal, sys, time\nfrom machopt.output import write_output_folder\n"
        # a shell starts background jobs with SIGINT ignored, and child processes inherit that
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "with write_output_folder(sys.argv[1]) as f:\n (f / 'half').write_text('1')\n"
        " print('in', flush=True)\n"
        # short sleeps: a signal between Python's check and the system call waits until the sleep ends
        " for _ in range(600):\n  time.sleep(0.1)\n"
    )
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    with subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path / "out")],
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as run:
        assert run.stdout is not None
        run.stdout.readline()
        run.send_signal(number)
        assert run.wait(20) in (code, -number)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("_either_way")
def test_earlier_output_is_replaced_as_a_whole(tmp_path: Path) -> None:
    write(tmp_path / "out", 1, files=5)
    write(tmp_path / "out", 2, files=2)
    assert generation(tmp_path / "out") == 2
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"result.json", "part0.txt", "part1.txt", MANIFEST}
    assert list_neighbours(tmp_path / "out") == []


@pytest.mark.usefixtures("_either_way")
def test_all_data_are_on_disk_before_the_swap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    message: list[str] = []
    sync, put = folders.sync_tree, folders._OutputPlace.swap
    monkeypatch.setattr(folders, "sync_tree", lambda f: (message.append("synced"), sync(f)))
    monkeypatch.setattr(folders._OutputPlace, "swap", lambda self, f: (message.append("swapped"), put(self, f)))
    write(tmp_path / "out")
    assert message == ["synced", "swapped"]


def test_every_file_and_folder_is_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    monkeypatch.setattr("machopt.output.folder_swap._sync_file", lambda path: synced.append(path.name))
    with write_output_folder(tmp_path / "out") as folder:
        (folder / "krl").mkdir()
        (folder / "krl" / "a.src").write_text("x")
        fill(folder, 1)
        name = folder.name
    assert set(synced) == {"a.src", "krl", "result.json", "part0.txt", "part1.txt", MANIFEST, name, tmp_path.name}
    assert synced.index("a.src") < synced.index("krl") < synced.index(name) < synced.index(tmp_path.name)


def test_second_run_is_refused_while_the_first_is_running(tmp_path: Path) -> None:
    with write_output_folder(tmp_path / "out") as folder:
        with pytest.raises(InputError, match="another run is writing this folder"):
            write(tmp_path / "out", 2)
        with pytest.raises(InputError, match="another run"):  # with any name of the same folder
            write(tmp_path / "." / "x" / ".." / "out", 2)
        fill(folder, 1)
        write(tmp_path / "other", 3)  # another folder is not locked
    assert generation(tmp_path / "out") == 1
    write(tmp_path / "out", 4)
    assert list_neighbours(tmp_path / "out") == ["other"]


def run_killed_code(tmp_path: Path, code: str) -> None:
    """Run code in a separate process and kill it, without cleanup, when it prints that it is ready."""
    script = f"import sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\nfrom test_output_folder import *\n{code}"
    script += "\nprint('now', flush=True)\ntime.sleep(60)\n"
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    with subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path / "out")], env=env, stdout=subprocess.PIPE
    ) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == b"now\n"
        run.kill()


def test_leftovers_of_a_killed_run_are_removed_by_the_next(tmp_path: Path) -> None:
    write(tmp_path / "out", 1)
    run_killed_code(tmp_path, "held = write_output_folder(sys.argv[1])\nfill(held.__enter__(), 2)")
    left = list_neighbours(tmp_path / "out")
    assert len(left) == 2  # the lock and the half-written folder
    assert generation(tmp_path / "out") == 1
    write(tmp_path / "out", 3)
    assert generation(tmp_path / "out") == 3
    assert list_neighbours(tmp_path / "out") == []


def test_running_output_of_another_process_is_not_touched(tmp_path: Path) -> None:
    with write_output_folder(tmp_path / "a") as folder:
        write(tmp_path / "b")
        write(tmp_path / "aa")
        with pytest.raises(InputError):
            write(tmp_path / "a")
        assert folder.is_dir()
        fill(folder, 1)
    assert list_neighbours(tmp_path / "a") == ["aa", "b"]


def test_run_killed_between_two_renames_restores_the_old_folder(tmp_path: Path) -> None:
    write(tmp_path / "out", 1)
    run_killed_code(
        tmp_path,
        """
folders.exchange_folders = lambda a, b: False
rename = Path.rename
def stopping(self, target):
    rename(self, target)
    if '.old-' in Path(target).name:
        print('now', flush=True)
        time.sleep(60)
Path.rename = stopping
write(Path(sys.argv[1]), 2)""",
    )
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="stop here"), write_output_folder(tmp_path / "out"):  # noqa: PT012
        assert generation(tmp_path / "out") == 1
        raise InputError("stop here")
    assert generation(tmp_path / "out") == 1
    assert list_neighbours(tmp_path / "out") == []


def test_temporary_names_are_unpredictable(tmp_path: Path) -> None:
    names = set()
    for _ in range(5):
        with write_output_folder(tmp_path / "out") as folder:
            names.add(folder.name)
            fill(folder, 1)
    assert len(names) == 5
    assert all(len(name.rpartition("-")[2]) == 16 for name in names)  # 64 bits


def test_user_file_in_an_earlier_output_is_not_lost(tmp_path: Path) -> None:
    write(tmp_path / "out")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds notes\.txt, which machopt did not write"):
        write(tmp_path / "out", 2)
    assert generation(tmp_path / "out") == 1
    (tmp_path / "out" / "notes.txt").unlink()
    (tmp_path / "out" / ".DS_Store").write_text("a file manager's")
    write(tmp_path / "out", 2)


def test_user_file_added_during_the_run_is_not_lost(tmp_path: Path) -> None:
    write(tmp_path / "out")
    with pytest.raises(InputError, match=r"notes\.txt"), write_output_folder(tmp_path / "out") as folder:  # noqa: PT012
        fill(folder, 2)
        (tmp_path / "out" / "notes.txt").write_text("mine")
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"
    assert list_neighbours(tmp_path / "out") == []


def test_output_without_a_manifest_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    write_json(tmp_path / "out" / "result.json", {"machopt_result": 1})
    write(tmp_path / "out", 2)
    assert generation(tmp_path / "out") == 2


def test_link_to_a_folder_remains_and_its_target_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "out").symlink_to("real", target_is_directory=True)
    write(tmp_path / "out", 2)
    assert (tmp_path / "out").is_symlink()
    assert generation(tmp_path / "real") == 2
    with write_output_folder(tmp_path / "real"), pytest.raises(InputError, match="another run"):
        write(tmp_path / "out", 3)


def long_link(tmp_path: Path) -> Path:
    (tmp_path / "round").symlink_to("round")
    return tmp_path / "round"


def below_a_file(tmp_path: Path) -> Path:
    (tmp_path / "file").write_text("x")
    return tmp_path / "file" / "out"


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (lambda t: t / ("n" * 256), "a shorter name would work"),
        (lambda t: t / "/".join(["n" * 250] * 20), "a shorter name would work"),
        (long_link, r"circle|Too many levels"),
        (below_a_file, "something above it is a file"),
        (lambda t: Path("/"), "root of the file system"),
        (lambda t: Path("/proc"), "is a mount point"),
        (lambda t: Path("/proc/no/out"), "cannot be written"),
    ],
)
def test_unwritable_place_is_refused_immediately(place: object, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message), write_output_folder(place(tmp_path)):  # type: ignore[operator]
        pytest.fail("not reached")


def test_longest_file_name_works(tmp_path: Path) -> None:
    for name in ("n" * 255, "ö" * 127):
        write(tmp_path / name)
        write(tmp_path / name, 2)
        assert generation(tmp_path / name) == 2


@pytest.mark.parametrize(
    ("number", "hint"),
    [
        (errno.ENOSPC, "free some space"),
        (errno.EDQUOT, "free some space"),
        (errno.EROFS, "a place you may write to"),
        (errno.EIO, ""),
    ],
)
@pytest.mark.parametrize("named", [True, False])
def test_full_disk_is_one_message(number: int, hint: str, named: bool, tmp_path: Path) -> None:
    write(tmp_path / "out", 1)
    message = rf"{os.strerror(number)}.*{hint}.*What was there is unchanged"
    with pytest.raises(InputError, match=message), write_output_folder(tmp_path / "out") as folder:
        raise OSError(number, os.strerror(number), str(folder / "x") if named else None)
    assert generation(tmp_path / "out") == 1
    assert list_neighbours(tmp_path / "out") == []


def test_full_disk_while_syncing_is_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "out", 1)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        write(tmp_path / "out", 2)
    assert generation(tmp_path / "out") == 1


def test_read_error_is_not_reported_as_a_full_disk(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), write_output_folder(tmp_path / "out"):
        (tmp_path / "mesh.stl").read_bytes()


def test_file_size_limit_is_one_message(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(InputError, match="ulimit -f"), write_output_folder(tmp_path / "out") as folder:
            (folder / "large").write_bytes(bytes(10_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


def test_missing_write_permission_is_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "mkdir", refused)  # simulated, because root may write everywhere
    with pytest.raises(InputError, match="Permission denied; name a folder in a place you may write to"):
        write(tmp_path / "new" / "out")


def test_folders_of_a_failed_run_are_removed(tmp_path: Path) -> None:
    with pytest.raises(InputError), write_output_folder(tmp_path / "a" / "b" / "out"):
        raise InputError("no")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.proof
@pytest.mark.usefixtures("_either_way")
def test_hundred_kills_leave_the_old_or_the_new_output(tmp_path: Path) -> None:
    """A child process writes generation after generation as fast as possible and is killed at a random moment."""
    out, rng, last, missing = tmp_path / "out", random.Random(20), 2, 0
    write(out, 1, FILES)
    begun = time.monotonic()
    write(out, 2, FILES)
    once = time.monotonic() - begun
    for kill in range(4 * KILLS):
        if kill >= KILLS and last > KILLS // 4:
            break  # on a loaded machine the child writes less before it is killed
        child = os.fork()
        if child == 0:
            for number in range(last + 1, last + 1_000_000):
                write(out, number, FILES)
        time.sleep(rng.uniform(0.0, 3.0 * once))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        if not out.exists():  # only without an atomic exchange of folders, until the next start
            missing += 1
            with pytest.raises(InputError, match="look"), write_output_folder(out):
                raise InputError("look")
        found = generation(out)
        assert found >= last
        manifest, sealed = read_manifest(out)
        assert sealed
        assert find_differences(out, manifest) == ()
        assert {p.read_text().split()[0] for p in out.glob("part*.txt")} == {str(found)}
        last = found
    assert last > KILLS // 4  # many generations were written
    assert not missing or folders.exchange_folders is not folder_swap.exchange_folders
    write(out, last + 1)
    assert list_neighbours(out) == []
