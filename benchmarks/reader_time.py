"""Time and memory of reading long toolpath files: ``python benchmarks/reader_time.py [LINES [FILE …]]`` (1,000,000,
all).

Each file is made up, read in a process of its own and removed; the CPU time counts start-up too. The aim is less than
20 s and 1 GiB for a million lines, whatever the format.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

MOST_SECONDS, MOST_GIB = 20.0, 1.0  # for a million lines
_READ = """
import resource, sys, time
from machopt.toolpath.toolpath_reader import read_toolpath
options = {"machine": "table-ac"} if "five" in sys.argv[1] else {}
start = time.perf_counter()
toolpath = read_toolpath(sys.argv[1], **options)
took = time.perf_counter() - start
print(len(toolpath), took, time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
"""


def points(n: int) -> Iterator[tuple[float, float, float]]:
    for k in range(n):
        a = 0.01 * k
        yield 100.0 * math.cos(a), 100.0 * math.sin(a), -1e-5 * k


def apt(f: TextIO, n: int) -> None:
    f.write("PARTNO/LONG\nUNITS/MM\nMULTAX\nLOADTL/1\nSPINDL/5000,RPM,CLW\nRAPID\nGOTO/0,0,50\nFEDRAT/3000,MMPM\n")
    for x, y, z in points(n):
        f.write(f"GOTO/{x:.5f},{y:.5f},{z:.5f},{x * 1e-3:.7f},{y * 1e-3:.7f},{0.994987437:.7f}\n")
    f.write("END\nFINI\n")


def clsf_with_arcs(f: TextIO, n: int) -> None:
    """Every tenth move is an arc of its own: chords are the larger part of the work."""
    f.write("TOOL PATH/LONG,TOOL,MILL\nTLDATA/MILL,10,0,75,0,0\nMSYS/0,0,0,1,0,0,0,1,0\nRAPID\nGOTO/0,0,50,0,0,1\n")
    f.write("FEDRAT/MMPM,3000\nGOTO/0,0,0\n")
    for k in range(n // 11):
        z = -1e-4 * k
        f.write(f"CIRCLE/1.0,0.0,{z:.4f},0.0,0.0,1.0,1.0,0.06,0.5,10.0,0.0\nGOTO/2.0,0.0,{z:.4f}\n")
        f.writelines(f"GOTO/{2.0 - 0.25 * step:.4f},-1.0,{z:.4f}\n" for step in range(8))
        f.write(f"GOTO/0.0,0.0,{z:.4f}\n")
    f.write("END-OF-PATH\n")


def gcode(f: TextIO, n: int) -> None:
    f.write("%\nO1\nG21 G90 G17 G54\nT1 M6\nS5000 M3\nG0 X0 Y0 Z50\nG1 Z0 F3000\n")
    for k, (x, y, z) in enumerate(points(n)):
        f.write(f"X{x:.4f} Y{y:.4f} Z{z:.4f}\n" if k % 3 else f"N{k} G1 X{x:.4f} Y{y:.4f} F3000.\n")
    f.write("M30\n%\n")


def five_axes(f: TextIO, n: int) -> None:
    f.write("%\nO1\nG21 G90 G17 G54\nT1 M6\nS5000 M3\nG43.4 H1\nG0 X0 Y0 Z50 A0 C0\nG1 Z0 F3000\n")
    for k, (x, y, z) in enumerate(points(n)):
        f.write(f"X{x:.4f} Y{y:.4f} Z{z:.4f} A{10.0 + 0.05 * x:.3f} C{0.5 * k:.3f}\n")
    f.write("M30\n%\n")


def vectors(f: TextIO, n: int) -> None:
    f.write("G71 G90 G17\nT1 M6\nS5000 M3\nTRAORI\nG0 X0 Y0 Z50\nG1 Z0 F3000\n")
    for k, (x, y, z) in enumerate(points(n)):
        f.write(f"N{k} X{x:.4f} Y{y:.4f} Z{z:.4f} A3={x * 1e-3:.6f} B3={y * 1e-3:.6f} C3=0.994987\n")
    f.write("M30\n")


def heidenhain(f: TextIO, n: int) -> None:
    f.write("0 BEGIN PGM LONG MM\n1 TOOL CALL 1 Z S5000\n2 L X+0 Y+0 Z+50 R0 FMAX M3\n3 L Z+0 F3000\n")
    for k, (x, y, z) in enumerate(points(n)):
        f.write(f"{k + 4} L X{x:+.4f} Y{y:+.4f} Z{z:+.4f}\n")
    f.write(f"{n + 4} END PGM LONG MM\n")


def table(f: TextIO, n: int) -> None:
    f.write("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n")
    for k, (x, y, z) in enumerate(points(n)):
        f.write(f"{x:.5f},{y:.5f},{z:.5f},{x * 1e-3:.7f},{y * 1e-3:.7f},0.9949874,cut,3000,op{k // 50_000}\n")


def krl(f: TextIO, n: int) -> None:
    f.write("&ACCESS RVP\nDEF long( )\n$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}\n$VEL.CP=0.05\n")
    for x, y, z in points(n):
        f.write(f"LIN {{X {x:.4f},Y {y:.4f},Z {z:.4f},A {x:.4f},B 0.0000,C 180.0000}} C_DIS\n")
    f.write("END\n")


def rapid(f: TextIO, n: int) -> None:
    f.write("MODULE m\nPROC main()\n")
    for x, y, z in points(n):
        f.write(f"MoveL [[{x:.4f},{y:.4f},{z:.4f}],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v50,z0,tool0;\n")
    f.write("ENDPROC\nENDMODULE\n")


FILES = {
    "long.apt": apt,
    "arcs.cls": clsf_with_arcs,
    "three.nc": gcode,
    "five.nc": five_axes,
    "vectors.mpf": vectors,
    "long.h": heidenhain,
    "long.csv": table,
    "robot.src": krl,
    "robot.mod": rapid,
}


def main() -> int:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    late = 0
    print(f"{'file':<12}{'lines':>10}{'MB':>7}{'points':>10}{'s':>7}{'CPU s':>7}{'lines/CPU s':>13}{'GiB':>7}")
    with tempfile.TemporaryDirectory() as folder:
        for name, write in FILES.items():
            if sys.argv[2:] and name not in sys.argv[2:]:
                continue
            file = Path(folder) / name
            with file.open("w", encoding="ascii") as f:
                write(f, n)
            with file.open("rb") as f:
                lines = sum(1 for _ in f)
            done = subprocess.run([sys.executable, "-c", _READ, str(file)], capture_output=True, text=True, check=True)
            read, took, cpu, memory = done.stdout.split()
            print(
                f"{name:<12}{lines:>10,}{file.stat().st_size / 1e6:>7.0f}{int(read):>10,}{float(took):>7.1f}"
                f"{float(cpu):>7.1f}{lines / float(cpu):>13,.0f}{float(memory):>7.2f}",
                flush=True,
            )
            late += float(took) > MOST_SECONDS * max(n / 1e6, 0.1) or float(memory) > MOST_GIB * max(n / 1e6, 0.5)
            file.unlink()
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main())
