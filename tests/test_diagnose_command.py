"""``machopt diagnose``: files, determinism, messages, user effects, killed runs."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_in_memory import diagnose_in_memory
from simulated_hidden_effects import (
    ARCMIN,
    CELLS,
    HiddenEffects,
    arm,
    build_rough_backlash,
    load_tests,
    plan_load_tests,
    solve_equilibrium,
)

from machopt.cell.kinematics_file import load_kinematics
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cli import main
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.recording import load_recording, write_recording
from machopt.report.template_rendering import bind_units

CELL = CELLS / "kr240_drilling"
VERDICTS = {"consistent", "explained", "partly_explained", "unexplained"}
SMALL = {"poses": 12, "sessions": 2, "loads": 3, "directions": 2}

LAW = '''"""Joint 3 softens as joint 1 turns away from its middle: a bundle of cables that pulls."""
import numpy as np
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Quantity


def hypotheses(readings):
    tau, q = readings.load_torque[:, 2], readings.state.q[:, 0]

    def columns(shape):
        return readings.lift_joint_twist(2, tau * np.abs(q))

    def size(x, shape):
        return {"softening": Quantity(1e6 * float(x[0]), "1/(MN·m)")}

    yield EffectHypothesis("cable_bundle", "joint:3", "softer to either side", "phi = c tau + a tau |q1|", columns,
                     size, note="away from the middle of joint 1", family="joint")
'''


def write_simulated_recording(
    folder: Path, truth=None, *, cell: Path = CELL, force: float = 1500.0, **design
) -> Recording:
    """Write a recording of a simulated arm."""
    rng = np.random.default_rng(8)
    a = arm(cell.name)
    k = a.nominal * rng.uniform(0.8, 1.25, 6)
    plan = plan_load_tests(a, rng, **(SMALL | {"force": force} | design))
    recording = load_tests(a, HiddenEffects(k) if truth is None else truth(k), plan, rng)
    write_recording(folder, recording)
    return recording


def soft_link(k: np.ndarray) -> HiddenEffects:
    return HiddenEffects(k, hinges={3: np.diag([1.0, 0.8, 1.2]) * 0.7 / k[2]})


def run(out: Path, recording: Path, *options: str, cell: Path = CELL, code: int = 0) -> dict:
    assert main(["diagnose", str(cell), str(recording), "-o", str(out), "--quiet", *options]) == code
    return json.loads((out / "diagnosis.json").read_text(), parse_constant=_refuse_constant) if code == 0 else {}


def _refuse_constant(word: str) -> None:
    raise AssertionError(f"{word} is not JSON")


@dataclass(frozen=True)
class Diagnosed:
    """A recording of an arm with a compliant link, and the output of `diagnose --json --seed 3` for it."""

    recording: Recording
    folder: Path  # of the recording
    out: Path
    printed: str


@pytest.fixture(scope="module")
def link(tmp_path_factory: pytest.TempPathFactory) -> Diagnosed:
    """Run the diagnosis once for all tests that read it; a test that changes a file works on a copy."""
    folder, message = tmp_path_factory.mktemp("link"), io.StringIO()
    recording = write_simulated_recording(folder / "rec", soft_link, poses=16)
    with contextlib.redirect_stdout(message):
        run(folder / "out", folder / "rec", "--json", "--seed", "3")
    return Diagnosed(recording, folder / "rec", folder / "out", message.getvalue())


def test_written_files_agree_with_the_contract(link: Diagnosed) -> None:
    recording, out = link.recording, link.out
    result = json.loads((out / "diagnosis.json").read_text(), parse_constant=_refuse_constant)
    assert json.loads(link.printed) == result
    assert result["machopt_diagnosis"] == 1
    assert result["verdict"] == "explained"
    assert (result["channel"], result["rmse_unit"]) == ("deflection", "mm")
    first, last = result["baseline"], result["final"]
    assert first["heldout_rmse"] > last["heldout_rmse"] > 0.8 * first["noise_floor"]
    assert 0.6 <= last["explained_share"] <= 1.0
    found = result["findings"][0]
    assert (found["effect"], found["location"]) == ("link_compliance", "link:3")
    assert found["one_of"][0] == ["link_compliance", "link:3"]
    assert found["heldout_rmse_after"] < found["heldout_rmse_before"]
    assert 0 <= found["p_value"] < 0.01
    for p in found["parameters"].values():
        assert p["ci95"][0] <= p["ci90"][0] <= p["value"] <= p["ci90"][1] <= p["ci95"][1]
        assert p["unit"]
    assert result["mismatch"][0]["axis"] == "link:3"
    assert {(x["effect"], x["location"]) for x in result["detection_limits"]} >= {("joint_backlash", "joint:1")}
    assert "link compliance of link 3" in result["sentence"]
    rows = (out / "residuals.csv").read_text().splitlines()
    assert len([x for x in rows if not x.startswith("#")]) == len(recording) + 1
    page = (out / "report.html").read_text()
    words = re.sub(r"<(script|style).*?</\1>", "", page, flags=re.DOTALL)
    assert not re.search(r"\b(NaN|nan|undefined|inf|None)\b(?! needed)", words)
    assert bind_units(result["sentence"])[:40] in words


def test_same_seed_gives_the_same_bytes(link: Diagnosed, tmp_path: Path) -> None:
    run(tmp_path / "again", link.folder, "--seed", "3")
    outs = (link.out, tmp_path / "again")
    files = [{str(p.relative_to(o)): p.read_bytes() for p in sorted(o.rglob("*")) if p.is_file()} for o in outs]
    assert files[0].keys() == files[1].keys()
    for name in files[0]:
        assert files[0][name] == files[1][name], name


def test_extended_stiffness_is_a_valid_cell_and_explains_the_recording(link: Diagnosed, tmp_path: Path) -> None:
    """The recording, diagnosed again with the written stiffness.yaml in the cell, has no finding except K_C."""
    found = load_stiffness(link.out / "stiffness.yaml")
    assert ("link_compliance", "link:3") in {(t.effect, t.location) for t in found.terms}
    shutil.copytree(CELL, tmp_path / "cell")
    shutil.copy(link.out / "stiffness.yaml", tmp_path / "cell" / "stiffness.yaml")
    again = run(tmp_path / "again", link.folder, cell=tmp_path / "cell")
    assert not [f for f in again["findings"] if f["effect"] != "geometric_stiffness"]
    assert again["final"]["heldout_rmse"] < 1.2 * again["baseline"]["noise_floor"]


def test_zero_offset_is_written_to_kinematics_yaml(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(5)
    a = arm(CELL.name)
    zero = np.zeros(6)
    zero[2] = 3e-4
    plan = plan_load_tests(a, rng, poses=50, sessions=2, loads=1, directions=1, force=1e-6)
    plan = replace(plan, loaded=~plan.loaded)
    p, _, _, _ = solve_equilibrium(a, HiddenEffects(a.nominal * 1.1, zero=zero), plan)
    keep = plan.loaded
    N = int(keep.sum())
    write_recording(
        tmp_path / "rec",
        Recording(
            kind="absolute",
            source="made up",
            q=plan.q[keep],
            pose=plan.pose[keep],
            cycle=plan.cycle[keep],
            session=plan.session[keep],
            line=np.arange(2, N + 2),
            position=p[keep] + 20e-6 * rng.standard_normal((N, 3)),
            time=plan.time[keep],
            registration="fit",
            stated_labels=frozenset({"pose", "cycle", "session"}),
        ),
    )
    result = run(tmp_path / "out", tmp_path / "rec")
    assert [(f["effect"], f["location"]) for f in result["findings"]] == [("joint_zero_offset", "joint:3")]
    same = [u["location"] for u in result["not_testable"] if u["reason"].endswith("it is a zero offset")]
    assert "joint:3" in same  # weight loads the joint to one side in all these poses, so backlash equals an offset
    assert ["joint_backlash", "joint:3"] in result["findings"][0]["one_of"]
    size = next(iter(result["findings"][0]["parameters"].values()))
    assert size["value"] == pytest.approx(np.degrees(3e-4), rel=0.15)
    written = load_kinematics(tmp_path / "out" / "kinematics.yaml")
    assert written is not None
    run(tmp_path / "none", _write_first_rows(tmp_path, load_recording(tmp_path / "rec"), 1), code=2)
    assert "found 1 reading; ten poses" in capsys.readouterr().err


def test_user_defined_effect_is_named_where_true_and_nowhere_else(tmp_path: Path) -> None:
    law = tmp_path / "bundle.py"
    law.write_text(LAW)

    def pulled(k: np.ndarray) -> HiddenEffects:
        def twist(tau: np.ndarray, q: np.ndarray, t: np.ndarray) -> np.ndarray:
            return 0.9 / k[2] * tau * np.abs(observed)

        rng = np.random.default_rng(8)
        rng.uniform(0.8, 1.25, 6)
        observed = plan_load_tests(arm(CELL.name), rng, **(SMALL | {"poses": 16, "force": 1500.0})).q[:, 0]
        return HiddenEffects(k, {2: twist})

    write_simulated_recording(tmp_path / "rec", pulled, poses=16)
    result = run(tmp_path / "out", tmp_path / "rec", "--effects", str(law))
    assert (result["findings"][0]["effect"], result["findings"][0]["location"]) == ("cable_bundle", "joint:3")
    # no model file can contain this effect, and the error is computed from the model files
    assert result["verdict"] == "partly_explained"
    assert result["final"]["heldout_rmse"] == pytest.approx(result["baseline"]["heldout_rmse"], rel=0.05)
    write_simulated_recording(tmp_path / "null")
    result = run(tmp_path / "none", tmp_path / "null", "--effects", str(law))
    assert "cable_bundle" not in {f["effect"] for f in result["findings"]}


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("def hypotheses(:\n", "SyntaxError"),
        ("x = 1\n", "no function hypotheses(readings)"),
        ("def hypotheses(r):\n    return 1 / 0\n", "ZeroDivisionError"),
        ("def hypotheses(r):\n    return None\n", "TypeError"),
        ("def hypotheses(r):\n    return [1]\n", "gave int"),
        ("{}['a']\n", "KeyError"),
        (LAW.replace("tau * np.abs(q))", "tau[:3])"), "does not run"),
        (LAW.replace('{"softening": Quantity(1e6 * float(x[0]), "1/(MN·m)")}', "{}"), "quantities"),
    ],
)
def test_broken_user_effect_is_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], code: str, said: str
) -> None:
    write_simulated_recording(tmp_path / "rec", poses=6, loads=2)
    (tmp_path / "law.py").write_text(code)
    run(tmp_path / "out", tmp_path / "rec", "--effects", str(tmp_path / "law.py"), code=2)
    error = capsys.readouterr().err
    assert said in error
    assert "law.py" in error
    assert not (tmp_path / "out").exists()


BROKEN = [
    ("data.csv", lambda t: t.replace("\n", "\n", 1)[: len(t) // 2], "expected"),
    ("data.csv", lambda t: t.split("\n")[0] + "\n", "no rows"),
    ("data.csv", lambda t: "", "no rows"),
    ("data.csv", lambda t: t.replace("dz_mm", "dzz_mm"), "unknown column 'dzz_mm'"),
    ("data.csv", lambda t: re.sub(r",[^,]*\n", ",nan\n", t.replace("\n", "#", 1)).replace("#", "\n", 1), "finite"),
    ("data.csv", lambda t: re.sub(r",[^,]*$", ",abc", t.rstrip("\n")) + "\n", "expected a number"),
    ("recording.yaml", lambda t: t.replace("deflection\n", "absolute\n", 1), "x_mm"),
    ("recording.yaml", lambda t: t.replace("deflection\n", "bending\n", 1), "'bending'"),
    ("recording.yaml", lambda t: t + "foo: 1\n", "unknown key 'foo'"),
]


@pytest.mark.parametrize(("name", "change", "said"), BROKEN)
def test_broken_recording_is_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, change, said: str
) -> None:
    write_simulated_recording(tmp_path / "rec", poses=4, loads=2)
    file = tmp_path / "rec" / name
    file.write_text(change(file.read_text()))
    run(tmp_path / "out", tmp_path / "rec", code=2)
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == [tmp_path / "rec"]  # no output and no incomplete output


def _write_recording_folder(tmp_path: Path, recording: Recording, **changes) -> Path:
    write_recording(tmp_path / "rec", replace(recording, **changes))
    return tmp_path / "rec"


def test_uninformative_recordings_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    r = write_simulated_recording(tmp_path / "rec", poses=6, loads=2)
    assert r.wrench is not None
    assert r.displacement is not None
    for changes, output in (
        ({"wrench": 0 * r.wrench}, "load is zero"),
        ({"displacement": 0 * r.displacement}, "displacement is zero"),
    ):
        run(tmp_path / "out", _write_recording_folder(tmp_path, r, **changes), code=2)
        assert output in capsys.readouterr().err
    for count in (1, 3):
        run(tmp_path / "out", _write_first_rows(tmp_path, r, count), code=2)
        assert "cannot test a model" in capsys.readouterr().err


def _write_first_rows(folder: Path, r: Recording, count: int) -> Path:
    parts = {k: v[:count] for k, v in vars(r).items() if isinstance(v, np.ndarray) and len(v) == len(r)}
    return _write_recording_folder(folder, r, **parts)


@pytest.mark.parametrize("poses", [2, 3, 4])
def test_few_poses_give_an_answer_without_a_name(tmp_path: Path, poses: int) -> None:
    write_simulated_recording(tmp_path / "rec", poses=poses)
    result = run(tmp_path / "out", tmp_path / "rec")
    assert {f["effect"] for f in result["findings"]} <= {"geometric_stiffness"}
    assert result["verdict"] in ("insufficient", "explained")  # explained by K_C, which exists in every arm
    if poses < 4:
        assert any("pose" in w for w in result["warnings"])


@pytest.mark.slow
@pytest.mark.parametrize("cell", ["nothing", "no stiffness", "no masses"])
def test_cell_without_stiffness_or_masses_is_diagnosed(link: Diagnosed, tmp_path: Path, cell: str) -> None:
    shutil.copytree(CELL, tmp_path / "cell")
    yaml, urdf = tmp_path / "cell" / "cell.yaml", tmp_path / "cell" / "robot.urdf"
    if cell != "no masses":
        yaml.write_text(yaml.read_text().replace("stiffness: stiffness.yaml\n", ""))
    if cell != "no stiffness":
        urdf.write_text(re.sub(r"<inertial>.*?</inertial>", "", urdf.read_text(), flags=re.DOTALL))
    result = diagnose_in_memory(tmp_path / "cell", link.recording, tmp_path / "rec").result.to_json_types()
    assert ("link_compliance", "link:3") in {(f["effect"], f["location"]) for f in result["findings"]}


def test_gross_errors_and_duplicates_are_listed_by_row(tmp_path: Path) -> None:
    r = write_simulated_recording(tmp_path / "rec", poses=16)
    assert r.displacement is not None
    d = r.displacement.copy()
    big = [int(n) for n in np.argsort(-np.abs(d).max(axis=1))[:60]][::15]
    for n in big:
        d[n, int(np.argmax(np.abs(d[n])))] *= 10.0
    copy = next(n for n in range(20, len(r)) if n not in big and n - 1 not in big and r.pose[n] == r.pose[n - 1])
    d[copy] = d[copy - 1]
    result = run(tmp_path / "out", _write_recording_folder(tmp_path, r, displacement=d))
    found = next(f for f in result["findings"] if f["effect"] == "outliers")
    rows = {int(n) for n in found["location"].removeprefix("rows:").split(",")}
    assert {n + 1 for n in (*big, copy)} <= rows
    assert len(rows) <= len(big) + 1 + 0.03 * len(r)  # one reading in a hundred is a simulated tracker outlier
    assert not {f["effect"] for f in result["findings"]} & {"joint_hysteresis", "link_compliance", "joint_backlash"}


def test_killed_run_leaves_nothing(tmp_path: Path) -> None:
    write_simulated_recording(tmp_path / "rec", poses=24, loads=4)
    out = tmp_path / "result" / "out"
    out.parent.mkdir()
    code = "import sys; from machopt.cli import main; sys.exit(main())"
    child = subprocess.Popen(
        [sys.executable, "-c", code, "diagnose", str(CELL), str(tmp_path / "rec"), "-o", str(out)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    assert child.stderr is not None
    for line in child.stderr:
        if "search" in line:
            break
    child.send_signal(signal.SIGTERM)
    child.wait(timeout=20)
    child.stderr.close()
    assert child.returncode != 0
    assert not out.exists()


@pytest.mark.slow
def test_two_effects_in_a_thousand_readings_are_both_named(tmp_path: Path) -> None:
    def both(k: np.ndarray) -> HiddenEffects:
        return HiddenEffects(k, {0: build_rough_backlash(0.4 * ARCMIN, 60.0)}, hinges={2: np.eye(3) * 2e-7})

    r = write_simulated_recording(tmp_path / "rec", both, poses=36, loads=4)
    assert len(r) > 1000
    result = diagnose_in_memory(CELL, r, tmp_path / "again").result.to_json_types()
    named = {f["effect"]: f["location"] for f in result["findings"]}
    share = next(f["parameters"]["share"] for f in result["findings"] if f["effect"] == "geometric_stiffness")
    assert share["ci95"][0] > 0.0  # K_C exists in every arm and is detectable in addition to the other two effects
    assert {place for effect, place in named.items() if effect != "geometric_stiffness"} == {"joint:1", "link:2"}


def test_user_effect_in_the_docs_runs(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[1] / "docs" / "diagnose.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(import numpy as np\nfrom machopt\.measurement.*?)```", page, re.S)
    assert code is not None
    law = tmp_path / "mylaw.py"
    law.write_text(code.group(1), encoding="utf-8")
    write_simulated_recording(tmp_path / "rec")
    run(tmp_path / "out", tmp_path / "rec", "--effects", str(law))
    output = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert output["findings"] == []
    tried = {(x["effect"], x["location"]) for x in [*output["detection_limits"], *output["not_testable"]]}
    assert ("loose_mount", "tool") in tried


@pytest.mark.parametrize(
    ("option", "words"),
    [(("--channel", "tip"), "channels are of a motion"), (("--toolpath", "nowhere.csv"), "there is no such file")],
)
def test_inconsistent_options_are_refused_before_the_search(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: tuple[str, str], words: str
) -> None:
    write_simulated_recording(tmp_path / "rec")
    code = main(["diagnose", str(CELL), str(tmp_path / "rec"), "-o", str(tmp_path / "out"), *option, "--quiet"])
    assert code == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
