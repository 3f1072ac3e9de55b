"""A folder of another version is reported as such when it fails."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from machopt.verification.folder.version_mismatch import describe_version_mismatch
from machopt.version import __version__


def test_other_version_is_named(tmp_path: Path) -> None:
    (output,) = describe_version_mismatch(tmp_path, SimpleNamespace(versions={"machopt": "0.0.9"}))
    assert output.startswith(f"the folder was written by machopt 0.0.9, this is {__version__}: ")


def test_newer_keys_are_named(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}")
    (output,) = describe_version_mismatch(tmp_path, SimpleNamespace(versions={"machopt": __version__}))
    assert "before result.json had machopt_result" in output


def test_damaged_file_has_no_other_version(tmp_path: Path) -> None:
    assert describe_version_mismatch(tmp_path, None) == ()
    (tmp_path / "result.json").write_text('{"machopt_result": "x"}')
    assert describe_version_mismatch(tmp_path, None) == ()
