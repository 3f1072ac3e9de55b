"""Robot programs: KRL, RAPID, FANUC LS, URScript, Yaskawa JBI, by regular expressions over their move statements."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from second_cam_reader.sampled_path import NotReadError, Path3, Vector, circle_through, rot

NUM = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?"
Frame = tuple[Vector, Vector]  # place mm, rotation


def axis_of(r: Vector) -> list[float]:
    """From tip to shank: minus z of the tool frame."""
    return [float(v) for v in -r[:, 2]]


def move(p: Path3, f: Frame, rapid: bool, feed: float, line: int) -> None:
    p.line_to(f[0], rapid=rapid, feed=feed, line=line, axis=axis_of(f[1]))


def arc(p: Path3, via: Frame, end: Frame, feed: float, line: int) -> None:
    if p.at is None:
        raise NotReadError(f"line {line}: an arc without a known start")
    centre, normal = circle_through(p.at, via[0], end[0])
    p.arc_to(end[0], centre, normal.tolist(), feed=feed, line=line, axis=axis_of(end[1]))


# -- KUKA ---------------------------------------------------------------------------------------------------------
def krl_frame(text: str, before: Frame | None) -> Frame | None:
    """A frame aggregate; what it leaves out stays as before."""
    v = {a: float(b) for a, b in re.findall(rf"\b([XYZABC])\s+({NUM})", text)}
    if not v or re.search(r"\bA1\s", text):
        return None
    p = np.array([v.get(k, before[0][i] if before else math.nan) for i, k in enumerate("XYZ")])
    if not {"A", "B", "C"} & set(v):
        return p, before[1] if before else np.eye(3)
    return p, rot("Z", v.get("A", 0)) @ rot("Y", v.get("B", 0)) @ rot("X", v.get("C", 0))


def krl(text: str, data: str = "") -> Path3:
    """LIN, PTP, CIRC (and the spline words SLIN, SPTP, SCIRC) to literal frames and to frames of the data list."""
    p = Path3("krl")
    named = {
        m[1].upper(): m[2]
        for m in re.finditer(
            r"^\s*(?:DECL\s+)?(?:GLOBAL\s+)?(?:(?:E6POS|POS|FRAME)\s+)?([\w$]+(?:\[\s*\d+\s*\])?)\s*=\s*(\{[^}]*\})",
            data + "\n" + text,
            re.M | re.I,
        )
    }
    named = {re.sub(r"\s", "", k): v.upper() for k, v in named.items()}
    feed, last, axes = math.nan, None, 0
    for number, raw in unrolled(text):
        s = raw.split(";")[0].strip().upper()
        if m := re.match(rf"\$VEL\.CP\s*=\s*({NUM})", s):
            feed = float(m[1]) * 60e3
        if not (m := re.match(r"(S?LIN|S?PTP|S?CIRC)(_REL)?\s+(.*)", s)):
            continue
        kind, rest = m[1].lstrip("S"), re.sub(r"\bC_\w+", "", m[3])
        if m[2]:
            raise NotReadError(f"line {number}: a relative move")
        targets = re.findall(r"\{[^}]*\}|[A-Z_$][\w$]*(?:\[\s*\d+\s*\])?", rest)
        frames = []
        for t in targets[: 2 if kind == "CIRC" else 1]:
            found = t if t.startswith("{") else named.get(re.sub(r"\s", "", t))
            if found is None:
                raise NotReadError(f"line {number}: {t} is declared nowhere")
            frames.append(krl_frame(found, last))
        if any(f is None for f in frames):
            axes += 1
            continue
        if kind == "CIRC":
            arc(p, frames[0], frames[1], feed, number)  # type: ignore[arg-type]
        else:
            move(p, frames[0], kind == "PTP", feed, number)  # type: ignore[arg-type]
        last = frames[-1]
    if not p.moves:
        raise NotReadError(f"no move to a place ({axes} joint moves)")
    return p


def unrolled(text: str) -> list[tuple[int, str]]:
    """Lines with `FOR i = a TO b` loops written out (one level, literal bounds)."""
    out: list[tuple[int, str]] = []
    loop: list[tuple[int, str]] | None = None
    var, low, high = "", 0, 0
    for number, raw in enumerate(text.splitlines(), 1):
        if m := re.match(r"\s*FOR\s+(\w+)\s*=\s*(\d+)\s+TO\s+(\d+)\s*$", raw, re.I):
            var, low, high, loop = m[1], int(m[2]), int(m[3]), []
        elif re.match(r"\s*(FOR|WHILE|IF|LOOP|REPEAT|SWITCH)\b", raw, re.I):
            raise NotReadError(f"line {number}: program flow")
        elif re.match(r"\s*ENDFOR", raw, re.I) and loop is not None:
            for i in range(low, high + 1):
                out += [(n, re.sub(rf"\[\s*{var}\s*\]", f"[{i}]", s, flags=re.I)) for n, s in loop]
            loop = None
        else:
            (out if loop is None else loop).append((number, raw))
    return out


# -- ABB ----------------------------------------------------------------------------------------------------------
def quaternion(q: Sequence[float]) -> Vector:
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rapid(text: str) -> Path3:
    """MoveL, MoveJ, MoveC to literal and declared targets, with Offs and RelTool."""
    p = Path3("rapid")
    clean = re.sub(r"!.*", "", text)
    if m := re.search(r"^\s*(FOR|WHILE)\b", clean, re.M):
        raise NotReadError(f"program flow: {m[1]}")
    targets = {m[1]: m[2] for m in re.finditer(r"robtarget\s+(\w+)\s*:=\s*(\[\[.*?\]\s*\])\s*;", clean, re.S)}
    speeds = {m[1]: float(m[2]) for m in re.finditer(rf"speeddata\s+(\w+)\s*:=\s*\[\s*({NUM})", clean)}

    def pose(t: str, line: int) -> Frame:
        t = t.strip()
        if m := re.match(r"(Offs|RelTool)\s*\((.*)\)$", t, re.S):
            inner, *d = split(m[2])
            f, d3 = pose(inner, line), np.array([float(v) for v in d[:3]])
            return (f[0] + (d3 if m[1] == "Offs" else f[1] @ d3), f[1])
        t = targets.get(t, t)
        v = [float(n) for n in re.findall(NUM, t)]
        if not t.startswith("[") or len(v) < 7:
            raise NotReadError(f"line {line}: target {t[:20]} is not declared here")
        return np.array(v[:3]), quaternion(v[3:7])

    for m in re.finditer(r"\b(MoveL|MoveJ|MoveC|MoveAbsJ)\s+([^;]*);", clean):
        line = clean[: m.start()].count("\n") + 1
        args = split(re.sub(r"\\ID:=\d+", "", m[2]))
        if m[1] == "MoveAbsJ":
            p.note("joint moves are left out")
            continue
        n = 2 if m[1] == "MoveC" else 1
        speed = args[n].strip()
        sp = float(speed[1:]) if re.fullmatch(r"v\d+", speed) else speeds.get(speed, math.nan)
        frames = [pose(a, line) for a in args[:n]]
        if n == 2:
            arc(p, frames[0], frames[1], sp * 60, line)
        else:
            move(p, frames[0], m[1] == "MoveJ", sp * 60, line)
    if not p.moves:
        raise NotReadError("no move to a place")
    return p


def split(text: str) -> list[str]:
    """At commas outside of brackets."""
    out, depth, start = [], 0, 0
    for k, c in enumerate(text):
        depth += (c in "[(") - (c in "])")
        if c == "," and depth == 0:
            out.append(text[start:k])
            start = k + 1
    return [*out, text[start:]]


# -- FANUC --------------------------------------------------------------------------------------------------------
FANUC_SPEED = {"mm/sec": 60.0, "cm/min": 10.0, "mm/min": 1.0, "inch/min": 25.4, "m/sec": 60e3}


def fanuc(text: str) -> Path3:
    """J, L, C moves to the positions of the /POS section."""
    p = Path3("fanuc")
    body, _, pos = text.partition("/POS")
    places: dict[int, Frame] = {}
    for m in re.finditer(r"P\[(\d+)[^\]]*\]\s*\{(.*?)\};", pos, re.S):
        v = {a: float(b) for a, b in re.findall(rf"\b([XYZWPR])\s*=\s*({NUM})", m[2].partition("GP2")[0])}
        if len(v) == 6:
            r = rot("Z", v["R"]) @ rot("Y", v["P"]) @ rot("X", v["W"])
            places[int(m[1])] = np.array([v[k] for k in "XYZ"]), r
    via: Frame | None = None
    body = re.sub(
        r"(C\s+P\[\d+\])[ \t]*\n\s*:", r"\1 ;\n :", body
    )  # the second point of a C stands on a line of its own
    for number, raw in enumerate(body.splitlines(), 1):
        m = re.match(r"\s*\d*\s*:\s*([JLC])?\s*P\[(\d+)[^\]]*\]\s*(.*?);", raw)
        if not m:
            continue
        if int(m[2]) not in places:
            raise NotReadError(f"line {number}: P[{m[2]}] has no place")
        if re.search(r"\bINC\b|Offset", m[3], re.I):
            raise NotReadError(f"line {number}: {m[3].strip()[-24:]}")
        f = places[int(m[2])]
        s = re.search(r"([\d.]+)\s*(mm/sec|cm/min|mm/min|inch/min|m/sec)", m[3])
        feed = float(s[1]) * FANUC_SPEED[s[2]] if s else math.nan
        if m[1] == "C":
            via = f
        elif m[1] is None and via is not None:
            arc(p, via, f, feed, number)
            via = None
        else:
            move(p, f, m[1] == "J", feed, number)
    if not p.moves:
        raise NotReadError("no move to a place")
    return p


# -- UR -----------------------------------------------------------------------------------------------------------
def urscript(text: str) -> Path3:
    """movel, movec, movep and movej to literal poses, with the functions called from the last line written out."""
    p = Path3("urscript")
    lines = [ln.split("#")[0] for ln in text.splitlines()]
    numbers = {m[1]: float(m[2]) for ln in lines if (m := re.match(rf"\s*(?:global\s+)?(\w+)\s*=\s*({NUM})\s*$", ln))}
    poses = {m[1]: m[2] for ln in lines if (m := re.match(r"\s*(?:global\s+)?(\w+)\s*=\s*(p\[.*\])\s*$", ln))}

    def pose(t: str) -> Frame | None:
        t = poses.get(t.strip(), t.strip())
        if not t.startswith("p["):
            return None
        v = [float(n) for n in re.findall(NUM, t, re.I)]
        w = np.array(v[3:6])
        angle = float(np.linalg.norm(w))
        k = w / angle if angle > 0 else w
        cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
        return np.array(v[:3]) * 1e3, np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross

    def value(t: str) -> float:
        t = t.rsplit("=", maxsplit=1)[-1].strip()
        return numbers[t] if t in numbers else float(t)

    for number, s in enumerate(lines, 1):
        m = re.search(r"\b(movel|movej|movec|movep)\s*\((.*)\)", s)
        if not m:
            continue
        args = split(m[2])
        n = 2 if m[1] == "movec" else 1
        frames = [pose(a) for a in args[:n]]
        if any(f is None for f in frames):
            if m[1] != "movej":
                raise NotReadError(f"line {number}: {s.strip()[:40]}")
            p.note("joint moves are left out")
            continue
        speed = value(args[n + 1]) * 60e3 if len(args) > n + 1 and m[1] != "movej" else math.nan
        if n == 2:
            arc(p, frames[0], frames[1], speed, number)  # type: ignore[arg-type]
        else:
            move(p, frames[0], m[1] == "movej", speed, number)  # type: ignore[arg-type]
    if not p.moves:
        raise NotReadError("no move to a place")
    return p


# -- Yaskawa ------------------------------------------------------------------------------------------------------
def jbi(text: str) -> Path3:
    """MOVL, MOVC and MOVJ to Cartesian positions; positions in pulses are left out."""
    p = Path3("jbi")
    places: dict[str, Frame] = {}
    kind = ""
    arcs: list[Frame] = []
    for number, s in enumerate(text.splitlines(), 1):
        if m := re.match(r"///POSTYPE\s+(\w+)", s):
            kind = m[1]
        elif (m := re.match(r"([CP]\d+)=(.*)", s)) and kind not in ("PULSE", "ANGLE"):
            v = [float(t) for t in m[2].split(",")]
            places[m[1]] = np.array(v[:3]), rot("Z", v[5]) @ rot("Y", v[4]) @ rot("X", v[3])
        elif m := re.match(r"\s*(MOVL|MOVJ|MOVC)\s+([CP]\d+)\s*(.*)", s):
            if m[2] not in places:
                p.note("moves to pulses are left out")
                continue
            sp = re.search(rf"\bV=({NUM})", m[3])
            feed = float(sp[1]) * 60 if sp else math.nan
            if m[1] == "MOVC":
                arcs.append(places[m[2]])
                if len(arcs) == 3:
                    arc(p, arcs[1], arcs[2], feed, number)
                    arcs = [arcs[2]]
                continue
            arcs = []
            move(p, places[m[2]], m[1] == "MOVJ", feed, number)
    if not p.moves:
        raise NotReadError("no move to a place")
    return p
