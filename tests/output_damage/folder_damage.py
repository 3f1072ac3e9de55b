"""Damages of the output folder: missing, added, truncated and changed files; wrong manifest or result."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from machopt.output.file_hashes import compute_sha256
from machopt.output.manifest_file import compute_seal
from output_damage.damage_case import Damage, Job, build_json_change, build_text_change, edit_json, find_single_file

POINTS, MOTION = "points.csv can be read", "trajectory.csv can be read"
LISTED, MANIFEST, INPUTS = "files as listed", "manifest.json", "made from these inputs"


def change_file(file: str, act: Callable[[Path], object]) -> Callable[[Job], None]:
    """Return a damage that applies a function to one file of the folder."""

    def apply(job: Job) -> None:
        act(find_single_file(job.out, file))

    return apply


def in_cell(file: str, old: str, new: str) -> Callable[[Job], None]:
    """Return a damage that changes a file of the cell with which the folder is verified."""

    def apply(job: Job) -> None:
        path = job.cell / file
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")

    return apply


def in_manifest(change: Callable[[dict[str, Any]], None]) -> Callable[[Job], None]:
    return build_json_change("manifest.json", change)


def in_result(change: Callable[[dict[str, Any]], None]) -> Callable[[Job], None]:
    return build_json_change("result.json", change)


def roles(manifest: dict[str, Any], named: dict[str, str]) -> None:
    for name, role in named.items():
        manifest["files"][name]["role"] = role


def scale_value(value: dict[str, Any], key: str, factor: float) -> None:
    value[key] *= factor


def cut(file: Path, share: float) -> None:
    """Truncate a file to a share of its length."""
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])


def append_data(file: Path, data: bytes) -> None:
    with file.open("ab") as stream:
        stream.write(data)


def flip_bit(file: Path, where: int | None = None) -> None:
    """Flip one bit of a byte, by default in the middle."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2 if where is None else where] ^= 1
    file.write_bytes(data)


def replace_by_external_link(file: Path) -> None:
    """Replace a file by a link to the same content outside the folder."""
    target = file.parent.parent / f"{file.name}.away"
    shutil.move(file, target)
    os.symlink(target, file)


def prepend_comment(file: Path) -> None:
    file.write_bytes(b"# lengths are in inch\n" + file.read_bytes())


def as_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


FILES = [
    Damage("points.csv removed", "1 file", change_file("points.csv", Path.unlink), POINTS),
    Damage("trajectory.csv removed", "1 file", change_file("trajectory.csv", Path.unlink), MOTION),
    Damage("result.json removed", "1 file", change_file("result.json", Path.unlink), "result.json"),
    Damage("report.html removed", "1 file", change_file("report.html", Path.unlink), "result.json outputs"),
    Damage("the program removed", "1 of 2 files", change_file("*.src", Path.unlink), "result.json programs"),
    Damage(
        "the program's data file removed", "1 of 2 files", change_file("*.dat", Path.unlink), "result.json programs"
    ),
    Damage(
        "a stray file",
        "1 byte",
        lambda job: bool((job.out / "notes.txt").write_text("x")) and None,
        LISTED,
        reseal=False,
    ),
    Damage(
        "a second program",
        "1 file",
        lambda job: bool(shutil.copy(find_single_file(job.out, "*.src"), job.out / "b.src")) and None,
        LISTED,
        reseal=False,
    ),
    Damage(
        "a stray file, listed", "1 file", lambda job: bool((job.out / "notes.txt").write_text("x")) and None, LISTED
    ),
    Damage("a stray empty folder", "1 folder", lambda job: (job.out / "more").mkdir(), LISTED, reseal=False),
    Damage(
        "the program renamed",
        "1 file",
        change_file("*.src", lambda f: f.rename(f.with_name("other.src"))),
        "result.json programs",
    ),
    Damage(
        "trajectory.csv renamed",
        "1 file",
        change_file("trajectory.csv", lambda f: f.rename(f.with_name("t.csv"))),
        MOTION,
    ),
    Damage("the program cut in half", "50 %", change_file("*.src", lambda f: cut(f, 0.5)), "result.json programs"),
    Damage("trajectory.csv cut", "last 5 %", change_file("trajectory.csv", lambda f: cut(f, 0.95)), MOTION),
    Damage("points.csv cut to its header", "all rows", change_file("points.csv", lambda f: cut(f, 0.05)), POINTS),
    Damage("trajectory.csv emptied", "all", change_file("trajectory.csv", lambda f: cut(f, 0.0)), MOTION),
    Damage("result.json cut", "50 %", change_file("result.json", lambda f: cut(f, 0.5)), "result.json"),
    Damage("result.json is a list", "all", change_file("result.json", lambda f: f.write_text("[]")), "result.json"),
    Damage("one bit of trajectory.csv", "1 bit", change_file("trajectory.csv", flip_bit), LISTED, by_hash_alone=True),
    Damage("one bit of the report", "1 bit", change_file("report.html", flip_bit), LISTED, by_hash_alone=True),
    Damage(
        "lines appended to the program",
        "1 line",
        change_file("*.src", lambda f: append_data(f, b"; more\n")),
        "result.json programs",
    ),
    Damage(
        "bytes appended to points.csv", "1 row", change_file("points.csv", lambda f: append_data(f, b"99,x\n")), POINTS
    ),
    Damage(
        "points.csv by a link", "0 bytes", change_file("points.csv", replace_by_external_link), LISTED, reseal=False
    ),
    Damage("points.csv a folder", "1 file", change_file("points.csv", as_folder), LISTED, reseal=False),
    Damage(
        "the report says otherwise",
        "1 word",
        build_text_change("report.html", "VERIFIED", "GOOD"),
        LISTED,
        by_hash_alone=True,
    ),
]

MANIFESTS = [
    Damage(f"manifest: {name}", how_much, apply, MANIFEST, reseal=False, as_is=MANIFEST)
    for name, how_much, apply in (
        ("removed", "1 file", change_file("manifest.json", Path.unlink)),
        ("cut", "half of it", change_file("manifest.json", lambda f: cut(f, 0.5))),
        ("emptied", "all", change_file("manifest.json", lambda f: cut(f, 0.0))),
        ("no JSON", "all", change_file("manifest.json", lambda f: f.write_text("files:\n  points.csv: ok\n"))),
        ("no UTF-8", "1 byte", change_file("manifest.json", lambda f: append_data(f, b"\xff"))),
        (
            "written by hand",
            "all",
            change_file("manifest.json", lambda f: f.write_text('{"files": {"points.csv": "ok"}}')),
        ),
        ("nested too deeply", "all", change_file("manifest.json", lambda f: f.write_text("[" * 100_000))),
        ("a key twice", "1 key", build_text_change("manifest.json", '"exit_code"', '"exit_code": 0,\n "exit_code"')),
        ("of the next format", "1 number", in_manifest(lambda m: m.update(machopt_manifest=2))),
        ("an unknown key", "1 key", in_manifest(lambda m: m.update(approved="yes"))),
        ("a key missing", "1 key", in_manifest(lambda m: m.pop("unchecked") and None)),
        ("a hash that is none", "1 word", in_manifest(lambda m: m["files"]["points.csv"].update(sha256="trust me"))),
        ("a size below zero", "1 number", in_manifest(lambda m: m["files"]["points.csv"].update(size=-1))),
        (
            "a file outside the folder",
            "1 entry",
            in_manifest(lambda m: m["files"].update({"../x": dict(m["files"]["points.csv"])})),
        ),
        ("collision switched off", "1 word", in_manifest(lambda m: m["options"].update(collision=False))),
        ("another version", "1 word", in_manifest(lambda m: m["versions"].update(machopt="9.9"))),
        ("a check more", "1 entry", in_manifest(lambda m: m["checked"].append({"what": "all", "how": "well"}))),
        ("a program's name", "1 word", in_manifest(lambda m: m["programs"][0].update(post="rapid"))),
    )
]

# resealed: the hashes of the manifest are updated, its other entries are wrong
FORGED_MANIFESTS = [
    Damage(f"manifest, resealed: {name}", how_much, in_manifest(change), caught_by, as_is=MANIFEST)
    for name, how_much, change, caught_by in (
        ("verdict", "1 word", lambda m: m.update(verdict="done, all checked"), "result.json verdict"),
        ("exit code", "0 → 4", lambda m: m.update(exit_code=4), "result.json verdict"),
        ("collision switched off", "1 word", lambda m: m["options"].update(collision=False), "result.json options"),
        (
            "a pair that does not touch by construction",
            "1 pair",
            lambda m: m.update(touching_pairs=[{"a": "link_2_0", "b": "tool", "reason": "built so"}]),
            "pairs that touch by construction",
        ),
        (
            "a pair that is none of the arm",
            "1 pair",
            lambda m: m.update(touching_pairs=[{"a": "cutter", "b": "workpiece", "reason": "built so"}]),
            "pairs that touch by construction",
        ),
        ("path tolerance", "0.015 → 5 mm", lambda m: m["options"].update(path_tolerance_mm=5.0), "result.json options"),
        ("an option that is none", "1 key", lambda m: m["options"].update(colision=False), "options"),
        ("a reading option", "tool axis +z", lambda m: m["reading"].update(tool_axis="+z"), "result.json options"),
        ("a reading option that is none", "1 key", lambda m: m["reading"].update(units="inch"), "reading options"),
        ("no programs", "1 of 1", lambda m: m.update(programs=[]), "result.json programs"),
        ("program tolerance", "0.05 → 5 mm", lambda m: m.update(program_tolerance_mm=5.0), "result.json programs"),
        ("stiffness hash", "1 digit", lambda m: m["inputs"]["stiffness.yaml"].update(sha256="0" * 64), INPUTS),
        ("an input left out", "1 of 14", lambda m: m["inputs"].pop("robot.urdf") and None, INPUTS),
        ("what was not checked", "1 entry", lambda m: m.update(unchecked=["weather"]), "result.json verdict"),
        ("how finely it was checked", "1 word", lambda m: m["checked"][0].update(how="well"), "result.json verdict"),
        (
            "a check more",
            "1 entry",
            lambda m: m["checked"].append({"what": "all", "how": "well"}),
            "result.json verdict",
        ),
        ("a claim called recomputed", "1 key", lambda m: m["not_recomputed"].pop() and None, "result.json verdict"),
        ("a warning left out", "all", lambda m: m.update(warnings=["none"]), "result.json programs"),
        ("roles swapped", "2 words", lambda m: roles(m, {"points.csv": "report", "report.html": "points"}), LISTED),
        ("another command", "1 word", lambda m: m.update(command="map"), MANIFEST),
        ("version", "1 word", lambda m: m["versions"].update(machopt="9.9"), "result.json verdict"),
    )
]


def with_program(name: str, post: str, *, role: str = "program", own: bool = True) -> Callable[[Job], None]:
    """Return a damage that adds a foreign file listed as a program in the manifest, of its own post or of the
    folder's post."""

    def apply(job: Job) -> None:
        file = job.out / name
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(b"\xd0\xcf\x11\xe0")
        with edit_json(job.out / "manifest.json") as m:
            m["files"][name] = {"role": role, "sha256": compute_sha256(file), "size": file.stat().st_size}
            if own:
                m["programs"].append({"post": post, "files": [name]})
            m["files"] = dict(sorted(m["files"].items()))
            m["seal"] = compute_seal(m)

    return apply


GIVEN_ROLES = [
    Damage(f"a role for an unknown file: {name} as {role} of {post or 'none'}", "1 file", change, LISTED, reseal=False)
    for name, post, role, change in (
        (name, post, role, with_program(name, post, role=role, own=bool(post)))
        for name, post, role in (
            ("Thumbs.db", "krl", "program"),
            ("Thumbs.db", "explorer", "program"),
            ("Thumbs.db", "Thumbs.db", "program"),
            (".DS_Store", "rapid", "program"),
            ("desktop.ini", "csv", "program"),
            ("krl/Thumbs.db", "krl", "program"),
            ("setup.exe", "krl", "program"),
            ("notes", "fanuc", "program"),
            ("a.src", "kuka", "program"),
            ("a.mod", "krl", "program"),
            ("notes.txt", "", "program"),
            ("notes.txt", "", "report"),
            ("notes.toml", "notes.toml", "other"),
        )
    )
]

FRONT_PLAN = {
    "plan": "requested",
    "changed": "",
    "mean_index": 1.0,
    "worst_index": 1.0,
    "cycle_time_s": 1.0,
    "joint_travel_deg": 1.0,
    "clearance_mm": 1.0,
    "objective": 1.0,
    "dominated": False,
}
TOOL = {"tool": "1", "first_point": 0, "last_point": 1, "operations": [], "mean_index": None, "worst_index": None}


def interval(result: dict[str, Any], ci90: list[float]) -> None:
    gain = result["objective"]["gain"][0]
    assert gain["std_percent"] is None
    gain["ci90"] = ci90


def lower_bound(result: dict[str, Any], factor: float) -> None:
    search = result["objective"]["search"]
    search["lower_bound"] *= factor
    search["gap_percent"] = 100.0 * (1.0 - search["lower_bound"] / search["sequence"])


def lower_information(result: dict[str, Any]) -> None:
    one = next(i for i in result["verification"]["information"] if i["value"])
    one["value"] *= 0.5


COMMENTS = [
    Damage(f"a comment on units in {name}", "1 line", change_file(name, prepend_comment), "result.json outputs")
    for name in ("points.csv", "trajectory.csv")
]

RESULTS = [
    Damage(f"result: {name}", how_much, in_result(change), caught_by)
    for name, how_much, change, caught_by in (
        ("verdict", "1 word", lambda r: r.update(verdict="infeasible"), "result.json verdict"),
        ("exit code", "0 → 3", lambda r: r.update(exit_code=3), "result.json verdict"),
        ("version", "1 word", lambda r: r.update(version="9.9"), "result.json verdict"),
        (
            "worst point's deflection",
            "−10 %",
            lambda r: scale_value(r["worst_point"], "deflection_mm", 0.9),
            "result.json worst point",
        ),
        (
            "worst point's stiffness",
            "+0.01 %",
            lambda r: scale_value(r["worst_point"], "k_axial_N_mm", 1.0001),
            "result.json worst point",
        ),
        (
            "worst point's number",
            "another point",
            lambda r: r["worst_point"].update(point=3),
            "result.json worst point",
        ),
        (
            "worst point's joint",
            "0.001°",
            lambda r: r["worst_point"]["q_deg"].__setitem__(1, 12.345),
            "result.json worst point",
        ),
        ("cycle time", "−1 ms", lambda r: r.update(cycle_time_s=r["cycle_time_s"] - 1e-3), "result.json times"),
        ("feed held", "+10 %", lambda r: r.update(feed_held_share=r["feed_held_share"] + 0.1), "result.json feed"),
        ("a feed dip left out", "the last", lambda r: r["feed_dips"].pop() and None, "result.json feed"),
        ("a feed dip made up", "1 figure", lambda r: r["feed_dips"][1].update(lowest_ratio=1.2), "result.json feed"),
        (
            "a lost feed called a stop",
            "1 dip",
            lambda r: r["feed_stops"].append(r["feed_dips"].pop(0)),
            "result.json feed",
        ),
        (
            "a reversal made up",
            "1 word",
            lambda r: r["feed_stops"].append(r["feed_dips"].pop(0) | {"where": "reversal"}),
            "result.json feed",
        ),
        ("a blocker made up", "1 sentence", lambda r: r["production_blockers"].append("none"), "result.json verdict"),
        ("a stage's time", "below zero", lambda r: r["timings_s"].update(verify=-1.0), "result.json times"),
        ("cutting points", "−1", lambda r: r["toolpath"].update(cutting_points=5), "result.json toolpath"),
        ("operations", "1 name", lambda r: r["toolpath"].update(operations=["other"]), "result.json toolpath"),
        (
            "a word not understood left out",
            "all words",
            lambda r: r["toolpath"].update(ignored=[{"word": "G95", "count": 1, "first_line": 1, "understood": True}]),
            "result.json toolpath",
        ),
        (
            "an infeasible point made up",
            "1 point",
            lambda r: r["infeasible_points"].append({"point": 2, "reason": "why not"}),
            "result.json infeasible",
        ),
        (
            "objective's mean",
            "−1 %",
            lambda r: scale_value(r["objective"]["chosen"], "mean", 0.99),
            "result.json objective",
        ),
        (
            "objective's total",
            "−1 %",
            lambda r: scale_value(r["objective"]["chosen"], "total", 0.99),
            "result.json objective",
        ),
        (
            "the grid optimum's mean",
            "+1 %",
            lambda r: scale_value(r["objective"]["grid"], "mean", 1.01),
            "result.json objective",
        ),
        ("the scale of the index", "÷ 2", lambda r: scale_value(r, "index_scale", 0.5), "result.json objective"),
        ("gain", "+1 %", lambda r: r["objective"]["gain"][1].update(mean_percent=99.0), "result.json objective"),
        ("index", "1 word", lambda r: r.update(index="jiao2022"), "result.json options"),
        ("an option", "1 word", lambda r: r["options"].update(clearance_mm=50.0), "result.json options"),
        (
            "an input's hash",
            "1 digit",
            lambda r: r["inputs"].update({"stiffness.yaml": "0" * 64}),
            "result.json inputs",
        ),
        ("the cell's name", "1 word", lambda r: r.update(cell="other"), "result.json inputs"),
        (
            "a check left out",
            "1 of 18",
            lambda r: r["verification"]["checks"].pop() and None,
            "result.json verification",
        ),
        (
            "a check's limit",
            "0.02 → 2 mm",
            lambda r: r["verification"]["checks"][1].update(limit=2.0),
            "result.json verification",
        ),
        (
            "a check's value",
            "made up",
            lambda r: r["verification"]["checks"][1].update(value=0.01),
            "result.json verification",
        ),
        ("verification failed", "1 word", lambda r: r["verification"].update(passed=False), "result.json verification"),
        (
            "a program withheld",
            "1 word",
            lambda r: r["programs"][0].update(withheld="no reason"),
            "result.json programs",
        ),
        ("a program's name", "1 word", lambda r: r["programs"][0].update(post="rapid"), "result.json programs"),
        ("what was not checked", "1 entry", lambda r: r["unchecked"].append("weather"), "result.json verdict"),
        (
            "a compensation made up",
            "1 figure",
            lambda r: r.update(compensation={"max_mm": 0.1}),
            "result.json compensation",
        ),
        ("of another shape", "1 key", lambda r: r.update(objective=[1, 2]), "result.json objective"),
        ("a key more", "1 key", lambda r: r.update(approved_by="the master"), "result.json verdict"),
        ("notes", "1 sentence", lambda r: r["notes"].append("all is well"), "result.json warnings"),
        (
            "what a program takes for granted",
            "1 sentence",
            lambda r: r["programs"][0]["assumed"].append("nothing"),
            "result.json programs",
        ),
        (
            "what came back of a program",
            "− 1 move",
            lambda r: r["programs"][0]["checked"].update(moves=3),
            "result.json programs",
        ),
        (
            "the share of points that a yardstick can drive",
            "110 %",
            lambda r: r["objective"]["jiao2022"].update(feasible_share=1.1),
            "result.json objective",
        ),
        (
            "the bound of the search",
            "above its best",
            lambda r: scale_value(r["objective"]["search"], "lower_bound", 2.0),
            "result.json objective",
        ),
        (
            "the feed a program holds",
            "120 %",
            lambda r: r["programs"][0]["feed_model"].update(mean_percent=120.0),
            "result.json programs",
        ),
        ("a front made up", "1 plan", lambda r: r.update(front=[FRONT_PLAN]), "result.json front"),
        ("tools made up", "1 tool", lambda r: r.update(tools=[TOOL]), "result.json tools"),
        ("an interval made up", "1 interval", lambda r: interval(r, [0.0, 99.0]), "result.json objective"),
        (
            "chosen from another",
            "1 word",
            lambda r: r.update(chosen_from="cam default"),
            "result.json options",
        ),
        (
            "the bound with its gap, the curve's figure left",
            "−1 %",
            lambda r: lower_bound(r, 0.99),
            "result.json objective",
        ),
        ("the information", "1 figure", lower_information, "result.json verification"),
        ("a key missing", "1 key", lambda r: r.pop("programs") and None, "result.json programs"),
    )
]

OTHERS = [
    Damage(
        "another stiffness",
        "joint 2, −20 %",
        in_cell("stiffness.yaml", "e6", "0e6"),
        INPUTS,
        as_is=INPUTS,
        reseal=False,
    ),
    Damage(
        "another cell",
        "1 mm in the tool",
        in_cell("cell.yaml", "mass_kg: ", "mass_kg: 1"),
        INPUTS,
        as_is=INPUTS,
        reseal=False,
    ),
    Damage(
        "another mesh",
        "1 bit of its title",
        lambda job: flip_bit(job.cell / "meshes/link1.stl", 20),
        INPUTS,
        as_is=INPUTS,
        reseal=False,
    ),
    Damage(
        "another toolpath",
        "1 feed",
        lambda job: bool(job.toolpath.write_text(job.toolpath.read_text().replace("1500", "1400", 1))) and None,
        INPUTS,
        as_is=INPUTS,
        reseal=False,
    ),
    Damage(
        "another toolpath by one comment",
        "1 line",
        lambda job: append_data(job.toolpath, b"# seen\n"),
        INPUTS,
        as_is=INPUTS,
        reseal=False,
    ),
]


def other_options(**options: object) -> Callable[[Job], None]:
    """Return a damage that changes options in manifest and result in the same way: only the tables show it."""

    def apply(job: Job) -> None:
        for file in ("manifest.json", "result.json"):
            build_json_change(file, lambda told: told["options"].update(options))(job)

    return apply


FORGED_OPTIONS = [
    Damage(f"options, in both: {name}", how_much, other_options(**options), caught_by, as_is=MANIFEST)
    for name, how_much, options, caught_by in (
        ("rotation range", "the other half", {"rotation_range_deg": [-60.0, -20.0]}, "requested: rotation_range_deg"),
        ("clearance", "2 → 300 mm", {"clearance_mm": 300.0}, "requested: clearance_mm"),
        ("joint margin", "0.5 → 40 deg", {"limit_margin_deg": 40.0}, "requested: limit_margin_deg"),
        ("a fixed rotation", "made up", {"fixed": [{"point": 4, "gamma_deg": -100.0}]}, "requested: fixed rotations"),
        ("collisions", "switched off", {"collision": False}, "result.json verdict"),
    )
]

DAMAGES = [*FILES, *GIVEN_ROLES, *COMMENTS, *MANIFESTS, *FORGED_OPTIONS, *FORGED_MANIFESTS, *RESULTS, *OTHERS]
