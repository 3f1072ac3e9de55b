"""Random programs in the words that LinuxCNC's interpreter and machopt both claim to read."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

HEAD = "G21 G90 G17 G94 G98 G91.1 G40 G49 G80"


class Writer:
    """One program in the making; it keeps the few modes that valid blocks depend on."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.lines: list[str] = []
        self.subs: list[str] = []
        self.label = 100
        self.plane = 17
        self.inch = False
        self.broken = False  # a loop was left by break: LinuxCNC 2.9 then carries out the next do loop only once

    def some(self, low: float = -20.0, high: float = 20.0) -> float:
        return round(float(self.rng.uniform(low, high)), int(self.rng.integers(0, 4)))

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def number(self, value: float) -> str:
        """A number as people write them."""
        text = f"{value:.4f}".rstrip("0")
        form = int(self.rng.integers(0, 6))
        if form == 0 and text.endswith("."):
            text = text[:-1]
        elif form == 1 and text.startswith("0."):
            text = text[1:] if text != "0." else "0"
        elif form == 2 and value > 0:
            text = "+" + text
        elif form == 3:
            text = self.expression(value)
        return text

    def expression(self, value: float) -> str:
        """Something that has this value."""
        other = round(float(self.rng.uniform(1, 9)), 2)
        forms: list[str] = [
            f"[{value - other:.4f} + {other}]",
            f"[{value + other:.4f} - {other}]",
            f"[{value * other:.6f} / {other}]",
            f"[[{value:.4f}]]",
            f"-[{-value:.4f}]",
            f"[{value:.4f} * COS[0]]",
            f"[{value:.4f} + SIN[180] * 0]",
            f"[{value:.4f} ** 1]" if value > 0 else f"[0 - {-value:.4f}]",
            f"[{value:.4f} + [3 EQ 4]]",
            f"[{value:.4f} + [2 GT 1] - 1]",
            f"[{value - 1:.4f} + FIX[1.7]]",
            f"[{value - 2:.4f} + FUP[1.2]]",
            f"[{value - 3:.4f} + ROUND[2.5]]",
            f"[{value - 1:.4f} + [7 MOD 3]]",
            f"[{value - 45:.4f} + ATAN[1]/[1]]",
            f"[{value - 4:.4f} + SQRT[16]]",
            f"[{value - 5:.4f} + ABS[-5]]",
        ]
        return str(self.rng.choice(np.array(forms)))

    def add(self, text: str) -> None:
        words = text.split(" ")
        plain = all((w[:1].isalpha() and w[:1] not in "oO") or w[:1] in "@^" for w in words) and "[" not in text
        if plain and self.chance(0.3):  # the order of words in a block means nothing
            text = " ".join(str(w) for w in self.rng.permutation(np.array(words)))
        form = int(self.rng.integers(0, 12))
        o_word = text[0] in "oO"  # LinuxCNC wants nothing before it
        if form == 0:
            text = text.lower()
        elif o_word and form in (1, 5):
            pass
        elif form == 1:
            text = f"N{len(self.lines) * 10} {text}"
        elif form == 2:
            text += " (note; with a sign)"
        elif form == 3:
            text += " ; note (open"
        elif form == 4:
            text = text.replace(" ", "")
        elif form == 5:
            text = "(before) " + text
        self.lines.append(text)

    def words(self, letters: str, low: float = -20.0, high: float = 20.0) -> str:
        given = [c for c in letters if self.chance(0.6)] or [letters[0]]
        return " ".join(f"{c}{self.number(self.some(low, high))}" for c in given)

    # ---- blocks

    def straight(self) -> None:
        self.add(f"{self.rng.choice(['G1', 'G01', 'G1', 'G0'])} {self.words('XYZ')}")

    def feed(self) -> None:
        self.add(f"F{self.rng.integers(100, 900) / (25.4 if self.inch else 1):.1f}")

    def incremental(self) -> None:
        self.add(f"G91 G1 {self.words('XYZ', -5, 5)}")
        self.add(f"{self.words('XYZ', -5, 5)}")
        self.add(f"G90 G0 {self.words('XYZ')}")

    def axes(self) -> tuple[str, str, str, str, str]:
        return {17: ("X", "Y", "Z", "I", "J"), 18: ("Z", "X", "Y", "K", "I"), 19: ("Y", "Z", "X", "J", "K")}[self.plane]

    def arc(self) -> None:
        """By its centre, from a known place, a part of a turn or several."""
        a, b, n, i, j = self.axes()
        x, y = self.some(), self.some()
        radius, start, sweep = abs(self.some(1, 15)) + 0.5, self.some(0, 360), self.some(5, 355)
        word = str(self.rng.choice(["G2", "G3"]))
        sign = 1.0 if word == "G3" else -1.0
        cx, cy = x - radius * np.cos(np.radians(start)), y - radius * np.sin(np.radians(start))
        ex = cx + radius * np.cos(np.radians(start + sign * sweep))
        ey = cy + radius * np.sin(np.radians(start + sign * sweep))
        self.add(f"G1 {a}{x:.6f} {b}{y:.6f}")
        helix = f" {n}{self.some():.3f}" if self.chance(0.4) else ""
        turns = f" P{self.rng.integers(1, 4)}" if self.chance(0.3) else ""
        form = int(self.rng.integers(0, 4))
        if form == 0:
            self.add(f"G90.1 {word} {a}{ex:.6f} {b}{ey:.6f}{helix} {i}{cx:.6f} {j}{cy:.6f}{turns}")
            self.add("G91.1")
        elif form == 1 and 10.0 < sweep < 170.0:
            self.add(f"{word} {a}{ex:.6f} {b}{ey:.6f}{helix} R{radius:.6f}")
        elif form == 2:
            self.add(f"{word} {i}{cx - x:.6f} {j}{cy - y:.6f}{helix}{turns}")
        else:
            self.add(f"{word} {a}{ex:.6f} {b}{ey:.6f}{helix} {i}{cx - x:.6f} {j}{cy - y:.6f}{turns}")
        if self.chance(0.3):
            self.add(f"G91 {word} {a}{ex - x:.6f} {b}{ey - y:.6f} {i}{cx - x + 0:.6f} {j}{cy - y:.6f}")
            self.add("G90")

    def change_plane(self) -> None:
        self.plane = int(self.rng.choice([17, 18, 19]))
        self.add(f"G{self.plane}")

    def polar(self) -> None:
        if self.plane != 17:
            self.add("G17")
            self.plane = 17
        self.add(f"G1 @{self.number(abs(self.some(1, 20)) + 1)} ^{self.number(self.some(-180, 180))}")
        self.add(f"^{self.some(-90, 90)}" if self.chance(0.5) else f"@{abs(self.some(1, 20)) + 1}")
        if self.chance(0.4):
            self.add(f"G91 @{abs(self.some(1, 3)):.3f} ^{self.some(-30, 30)}")
            self.add("G90")
        if self.chance(0.3):
            self.add("G0 Z20")
            self.add(f"G91 G98 G81 {self.rng.choice(['@2', '^40', '@1.5 ^-35'])} R-8 Z-6 L{self.rng.integers(1, 6)}")
            self.add("G80 G90")
            self.straight()

    def parameters(self) -> None:
        v = self.some()
        name = str(self.rng.choice(["#1", "#30", "#31", "#100", "#<place>", "#<_place>", "#01"]))
        self.add(f"{name}={self.expression(v)}")
        self.add(f"G1 X{name} Y-{name} Z[{name}/2]")
        self.add("#2=3 #3=[1+1]")
        self.add(f"#[2+#3]={v:.3f}")
        self.add("G1 X#4 Y##2")
        self.add(f"G1 XSIN[{self.some(0, 90)}] YABS[{v:.3f}] Z-SQRT[{abs(v):.3f}]")
        if self.chance(0.5):
            self.add("G1 X[#5420+1] Y[#<_y>-2] Z[#5422]")

    def branch(self) -> None:
        self.label += 1
        k, a, b = self.label, self.some(), self.some()
        word = str(self.rng.choice(["LT", "GT", "LE", "GE", "EQ", "NE"]))
        logic = str(self.rng.choice(["AND", "OR", "XOR"]))
        self.add(f"o{k} if [[{a} {word} {b}] {logic} [{b} GT 0]]")
        self.straight()
        self.add(f"o{k:03d} elseif [{a} LT 0]")
        self.straight()
        self.add(f"o{k} else")
        self.straight()
        self.add(f"O{k} endif")

    def loop(self) -> None:
        self.label += 1
        k, times = self.label, int(self.rng.integers(1, 4))
        form = int(self.rng.integers(0, 4))
        if form == 1 and self.broken:
            form = 2
        if form == 0:
            self.add(f"o{k} repeat [{times}]")
            self.add(f"G91 G1 X{self.some(-2, 2)} Y1")
            self.add("G90")
            self.add(f"o{k} endrepeat")
            return
        self.add("#<i>=0")
        self.add(f"o{k} do" if form == 1 else f"o{k} while [#<i> LT {times}]")
        self.add(f"G1 X[#<i>*2] Y{self.number(self.some())}")
        self.add("#<i>=[#<i>+1]")
        if form == 3:
            self.add(f"o{k + 500} if [#<i> GT 1]")
            word = str(self.rng.choice(["break", "continue"]))
            self.broken = self.broken or word == "break"
            self.add(f"o{k} {word}")
            self.add(f"o{k + 500} endif")
            self.add(f"Z{self.number(self.some())}")
        self.add(f"o{k} while [#<i> LT {times}]" if form == 1 else f"o{k} endwhile")

    def subroutine(self) -> None:
        self.label += 1
        k = self.label
        name = f"<s{k}>" if self.chance(0.3) else str(k)
        modes = "M73\nG91\n" if self.chance(0.3) else ""
        early = (
            f"o{k + 700} if [#1 GT 10]\nG1 Z#1\no{name} return [#1*2]\no{k + 700} endif\n" if self.chance(0.4) else ""
        )
        self.subs.append(
            f"o{name} sub\n{modes}{early}#31=[#31+1]\n#5=[#1+#2]\nG1 X#1 Y#2\nG1 X#5 Y#3\n"
            f"o{name} endsub{' [#5+1]' if self.chance(0.5) else ''}\n"
        )
        for _ in range(int(self.rng.integers(1, 3))):
            self.add(f"#5={self.some():.2f}")
            self.add(f"o{name} call [{self.some()}] [{self.some()}]{f' [{self.some()}]' if self.chance(0.5) else ''}")
            self.add("G1 X#5 Z[#31/10]")
            if self.chance(0.5):
                self.add("G1 Y#<_value>")

    def frames(self) -> None:
        form = int(self.rng.integers(0, 6))
        if form == 0:
            self.add(str(self.rng.choice(["G54", "G55", "G56"])))
        elif form == 1:
            self.add(f"G52 {self.words('XYZ', -5, 5)}")
            self.straight()
            self.add("G52 X0 Y0 Z0")
        elif form == 2:
            self.add(f"G92 {self.words('XYZ', -5, 5)}")
            self.straight()
            self.add("G92.2")
            if self.chance(0.5):
                self.add(f"G1 {self.words('XYZ')}")
                self.add("G92.3")
                self.straight()
            self.add("G92.1")
        elif form == 3:
            self.add(f"G10 L2 P{self.rng.integers(1, 4)} {self.words('XYZ')}")
        elif form == 4 and self.plane == 17:
            self.add(f"G10 L2 P{self.rng.integers(1, 4)} R{self.some(-90, 90)}")
            self.straight()
            self.arc()
            self.straight()
            for p in (1, 2, 3):
                self.lines.append(f"G10 L2 P{p} R0")
        else:
            self.add(f"G52 {self.words('XYZ', -5, 5)}")
            self.straight()
            self.add(f"G92 {self.words('XYZ', -5, 5)}")
            self.straight()
            self.add("G92.1")
        self.straight()

    def cycle(self) -> None:
        a, b, n, _, _ = self.axes()
        code = int(self.rng.choice([73, 81, 82, 83, 85, 86, 89]))
        self.add(f"G0 {n}{self.some(20, 30)}")
        back = str(self.rng.choice(["G98", "G99"])) if code != 89 else "G99"
        top, bottom = self.some(5, 10), self.some(-10, 4)
        peck = f" Q{self.some(1, 6) + 0.5137:.4f}" if code in (73, 83) else ""
        wait = " P0.5" if code in (82, 86, 89) else ""
        spindle = "S500 M3\n" if code == 86 else ""
        if spindle:
            self.lines.append("S500 M3")
        self.add(
            f"{back} G{code} {a}{self.number(self.some())} {b}{self.number(self.some())} {n}{bottom} R{top}{peck}{wait}"
        )
        for _ in range(int(self.rng.integers(0, 3))):
            self.add(
                f"{a}{self.number(self.some())}"
                if self.chance(0.5)
                else f"{b}{self.number(self.some())} {n}{bottom - 1}"
            )
        self.add("G80")
        if self.chance(0.4) and code != 89:
            step = f"{a}{self.some(1, 4)} {b}{self.some(1, 4)} {n}-4 R-3"
            self.add(f"G98 G91 G{code} {step}{peck}{wait} L{self.rng.integers(1, 4)}")
            self.add("G80 G90")
        self.add("G98")
        self.straight()

    def units(self) -> None:
        self.inch = not self.inch
        self.add("G20" if self.inch else "G21")
        self.feed()
        self.straight()

    def modes(self) -> None:
        self.add("M70")
        self.add(f"G91 G1 X{self.some(-3, 3)}")
        self.add("G18" if self.chance(0.5) else "G99")
        self.add("M72")
        self.add(f"G1 {self.words('XYZ')}")

    def quiet(self) -> None:
        """Words that move nothing."""
        words = [
            "M3 S1000",
            "M5",
            "M7",
            "M8",
            "M9",
            "G64",
            "G64 P0.01",
            "G61",
            "G4 P0.5",
            "M0",
            "G28.1",
            "G30.1",
            "G40",
            "M48",
        ]
        self.add(str(self.rng.choice(np.array(words))))

    def inverse_time(self) -> None:
        self.add(f"G93 G1 {self.words('XYZ')} F{self.rng.integers(1, 9)}")
        self.add(f"G94 F{self.rng.integers(100, 900)}")

    def nested(self) -> None:
        """Subroutines that call each other, recursion, returns, names of their own and shared ones.

        No return stands in a loop: LinuxCNC 2.9 then skips that loop in the next call.
        """
        self.label += 1
        k = self.label
        self.subs.append(
            f"o<deep{k}> sub\n#<own>=[#1*2]\n#<_shared>=[#<_shared>+1]\no{k + 200} if [#1 GT 1]\n"
            f"o<deep{k}> call [#1-1] [#2+1]\no{k + 200} endif\nG1 X#<own> Y#2\no<deep{k}> endsub\n"
            f"o{k} sub\no{k + 300} repeat [3]\n#3=[#3+1]\nG1 Z#3\no{k + 300} endrepeat\n"
            f"o{k + 400} if [#3 GT #1]\no{k} return [#3]\no{k + 400} endif\no<deep{k}> call [2] [#1]\no{k} endsub\n"
        )
        self.lines.append("#<_shared>=0")
        self.lines.append(f"o<deep{k}> call [{self.rng.integers(1, 4)}] [{self.some()}]")
        self.lines.append(f"o{k} call [{self.rng.integers(0, 5)}]")
        self.lines.append("G1 X#<_value> Y#<_shared> Z[EXISTS[#<own>]]")
        self.lines.append(f"#7={k}")
        self.lines.append(f"o[#7] call [{self.rng.integers(0, 5)}]")

    def turned_frames(self) -> None:
        """G52 and G92 in a turned work offset."""
        if self.plane != 17:
            self.add("G17")
            self.plane = 17
        self.add(f"G10 L2 P{self.rng.integers(1, 4)} R{self.some(-180, 180)}")
        self.straight()
        self.add(f"{self.rng.choice(['G52', 'G92'])} {self.words('XYZ', -5, 5)}")
        self.straight()
        self.arc()
        self.add(str(self.rng.choice(["G54", "G55", "G56"])))
        self.straight()
        self.add("G92.1")
        self.polar()
        self.cycle()
        for p in (1, 2, 3):
            self.lines.append(f"G10 L2 P{p} R0")
        self.straight()

    def cycles_in_a_row(self) -> None:
        """Cycles that follow each other without G80, with words that stay and heights that change."""
        a, b, n, _, _ = self.axes()
        self.add(f"G0 {n}30")
        self.add(f"G99 G81 {a}{self.some()} {b}{self.some()} {n}{self.some(-9, 1)} R{self.some(4, 9)}")
        for _ in range(int(self.rng.integers(1, 5))):
            code = str(self.rng.choice(["G82 P0.2", "G83 Q3.0137", "G81", "G85", "G98", "G99", ""]))
            code += (
                f" R{self.some(4, 9)} {n}{self.some(-9, 1)}" if code not in ("G98", "G99") else ""
            )  # with each new cycle
            self.add(f"{code.strip()} {a}{self.number(self.some())} {b}{self.some()}")
        self.add(str(self.rng.choice(["G80", f"G0 {a}1", f"G1 {b}2"])))
        self.add("G98")
        self.straight()

    def tap(self) -> None:
        self.lines.append("S500 M3")
        self.add(f"G33.1 {self.words('XYZ')} K{self.number(0.5 if not self.inch else 0.02)}")
        self.straight()

    def text(self) -> str:
        """The whole program."""
        kinds: tuple[Callable[[], None], ...] = (
            *(self.straight, self.straight, self.incremental, self.arc, self.arc, self.change_plane, self.polar),
            *(self.parameters, self.branch, self.loop, self.subroutine, self.nested, self.frames, self.frames),
            *(self.turned_frames, self.cycle, self.cycle, self.cycles_in_a_row, self.units, self.tap, self.modes),
            *(self.quiet, self.inverse_time),
        )
        head = [HEAD, *(f"G10 L2 P{p} X{self.some()} Y{self.some()} Z{self.some()} R0" for p in (1, 2, 3)), "G54"]
        for _ in range(int(self.rng.integers(3, 12))):
            kinds[int(self.rng.integers(0, len(kinds)))]()
        self.lines.append(f"G90 G1 X{self.some()} Y{self.some()}")
        start = [f"G0 X{self.some()} Y{self.some()} Z{self.some()}", "F300", "#31=0"]
        end = str(self.rng.choice(["M2", "M30", "%"]))
        behind = {"%": ["G1 X999"], "M2": ["G1 X#99", "G20"]}.get(end, []) if self.chance(0.5) else []
        first = ["%"] if end == "%" else []
        return "\n".join([*first, *head, *self.subs, *start, *self.lines, end, *behind]) + "\n"


def program(seed: int) -> str:
    """The random program of a seed."""
    return Writer(seed).text()
