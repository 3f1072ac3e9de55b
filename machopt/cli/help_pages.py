"""Two help pages a command: ``--help`` shows the main options and an example, ``--help-advanced`` the rest."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any, NoReturn

from machopt.cli.argument_errors import CommandParser
from machopt.cli.progress_display import parse_natural_number, parse_positive_integer

OptionGroup = tuple[str, tuple[str, ...]]  # title, names of options

READING: OptionGroup = (
    "what the toolpath file does not contain",
    (
        "--unit",
        "--machine",
        "--feed",
        "--tool-axis",
        "--offset",
        "--decimals",
        "--cycle-order",
        "--accept-unknown",
        "--kind",
        "--max-extent",
        "--strict",
    ),
)
OUTPUT: OptionGroup = ("output", ("--out", "--force", "--tables", "--json", "--quiet"))
PLANNING: OptionGroup = ("planning options", ("--plan", "--set"))
ADVANCED: tuple[OptionGroup, ...] = (
    READING,
    PLANNING,
    ("robot files", ("--package", "--xacro-arg", "--base-link", "--flange-link", "--allow-external")),
    ("output", (*OUTPUT[1], "--debug")),
)
"""Groups of the second page; an option in none of them stays in the group of its command."""


@dataclass(frozen=True)
class HelpPage:
    """The first page of a command."""

    groups: tuple[OptionGroup, ...]
    example: str


PAGES: dict[str, HelpPage] = {
    "optimize": HelpPage(
        (
            ("the toolpath file", ("--unit", "--feed", "--machine", "--offset")),
            (
                "the plan",
                (
                    "--set",
                    "--plan",
                    "--process",
                    "--objective",
                    "--method",
                    "--index",
                    "--compensate",
                    "--allow-gaps",
                ),
            ),
            ("robot program", ("--post", "--program-tolerance-mm")),
            ("output", ("--out", "--force", "--front", "--json", "--quiet")),
        ),
        "machopt optimize cells/kr500_milling toolpaths/cylinder_head_face.cls -o out/cylinder_head",
    ),
    "inspect": HelpPage(
        (
            ("the toolpath file", ("--unit", "--feed", "--machine", "--offset", "--decimals", "--kind", "--strict")),
            ("robot and cell", ("--cell", "--package")),
            ("output", ("--html", "--force", "--json", "--quiet")),
        ),
        "machopt inspect toolpaths/cylinder_head_face.cls --html path.html",
    ),
    "verify": HelpPage(
        (
            ("the options that the plan was made with", ("--unit", "--feed", "--machine", "--offset", *PLANNING[1])),
            ("cell", ("--effects", "--allow-external")),
            ("output", ("--json", "--quiet")),
        ),
        "machopt verify cells/kr500_milling toolpaths/cylinder_head_face.cls out/cylinder_head",
    ),
    "identify": HelpPage(
        (
            ("the model", ("--model", "--fit", "--geometric", "--level")),
            ("the recording", ("--dry-run", "--accept", "--keep-outliers")),
            OUTPUT,
        ),
        "machopt identify cells/cutting_cobot cells/cutting_cobot/recordings/tian2025_table2 -o out/identified",
    ),
    "process": HelpPage(
        (
            ("the coefficients", ("--material", "--level", "--keep-outliers")),
            OUTPUT,
        ),
        "machopt process cells/kr500_milling recordings/slots -o out/al7075 --material al7075",
    ),
    "diagnose": HelpPage(
        (
            ("the diagnosis", ("--dry-run", "--channel", "--max-findings", "--effects", "--accept", "--seed")),
            ("effect on a job", ("--toolpath", "--set")),
            OUTPUT,
        ),
        "machopt diagnose cells/cutting_cobot recordings/day1 recordings/day2 -o out/diagnosed",
    ),
    "plan-poses": HelpPage(
        (
            ("how much to measure", ("--poses", "--loads", "--cycles", "--target-percent")),
            ("loads", ("--weights-kg", "--pull-N", "--anchors")),
            ("the job that the robot is measured for", ("--toolpath", "--force-N")),
            ("instrument", ("--sensor", "--tracker", "--displacement-mm")),
            ("what to fit", ("--fit", "--discriminate")),
            ("output", ("--out", "--force", "--json", "--quiet")),
        ),
        "machopt plan-poses cells/kr500_milling -o out/poses --weights-kg 50,100",
    ),
    "map": HelpPage(
        (
            ("where", ("--slice", "--at", "--volume", "--joints", "--line", "--range", "--step", "--frame")),
            ("posture", ("--tool-axis", "--gamma", "--fixed-rotation", "--collision")),
            ("load", ("--load-N",)),
            ("output", ("--out", "--force", "--json", "--quiet")),
        ),
        "machopt map cells/kr500_milling -o out/map --slice xz --load-N 0,0,100",
    ),
    "place": HelpPage(
        (
            ("where the workpiece or the robot may be", ("--x-mm", "--y-mm", "--z-mm", "--turn-deg", "--move")),
            ("how long to search", ("--places", "--plans", "--best", "--minutes", "--jobs")),
            ("the plans", ("--set", "--post")),
            ("output", ("--out", "--force", "--json", "--quiet")),
        ),
        "machopt place cells/kr500_milling toolpaths/cylinder_head_face.cls -o out/placed --x-mm -200 200",
    ),
    "batch": HelpPage(
        (
            ("jobs", ("--cell", "--set", "--plan", "--post")),
            ("how to run", ("--jobs", "--scheduler", "--time-limit-s", "--memory-limit-mib", "--keep-failed")),
            ("output", ("--out", "--force", "--compare", "--tables", "--json", "--quiet")),
        ),
        "machopt batch 'parts/*.nc' --cell cells/kr500_milling -o out/parts --jobs 4",
    ),
    "init": HelpPage(
        (
            ("tool", ("--tool-length-mm", "--tool-angle-deg", "--tool-mass-kg", "--tool-mesh", "--cutter-diameter-mm")),
            ("workpiece", ("--toolpath", "--workpiece-mm", "--workpiece-mesh")),
            ("robot", ("--package", "--xacro-arg", "--stiffness", "--post")),
            ("output", ("--out", "--name", "--ask", "--json", "--quiet")),
        ),
        "machopt init robot.urdf -o cells/mine --tool-length-mm 180 --toolpath part.cls",
    ),
    "validate": HelpPage(
        (
            ("cell", ("--effects", "--allow-external")),
            ("output", ("--picture", "--force", "--json", "--quiet")),
        ),
        "machopt validate cells/kr500_milling --picture cell.svg",
    ),
    "view": HelpPage(
        (
            ("the toolpath file", ("--unit", "--feed", "--machine", "--offset")),
            ("the plan", ("--set", "--plan", "--as-it-is")),
            ("the page", ("--port", "--open", "--save", "--force")),
            ("output", ("--quiet",)),
        ),
        "machopt view out/cylinder_head --open",
    ),
}


class ArrangedParser(CommandParser):
    """Parser of a command whose help has two pages."""

    page: HelpPage | None = None

    def format_help(self) -> str:
        """Return the first page; a command without one shows every option."""
        if self.page is None:
            return super().format_help()
        shown, hidden = self._split_options(self.page)
        formatter = self._get_formatter()
        words = [_format_usage(a) for a in self._actions if not a.option_strings or a.required]
        formatter.add_text(f"usage: {self.prog} {' '.join(words)} [options]")
        formatter.add_text(self.description)
        self._add_section(formatter, "arguments", self._list_arguments())
        for title, actions in shown:
            self._add_section(formatter, title, actions)
        self._add_section(formatter, "help", [a for a in self._actions if "--help" in a.option_strings])
        text = formatter.format_help()
        count = sum(len(actions) for _, actions in hidden)
        more = f"{self.prog} --help-advanced: {count} more options\n" if count else ""
        return f"{text}\nexample:\n  {self.page.example}\n\n{more}"

    def format_advanced_help(self) -> str:
        """Return the page with the options that the first page leaves out."""
        formatter = self._get_formatter()
        formatter.add_text(f"options of {self.prog} besides those of {self.prog} --help")
        for title, actions in self._split_options(self.page)[1] if self.page else ():
            self._add_section(formatter, title, actions)
        return formatter.format_help()

    def _list_arguments(self) -> list[argparse.Action]:
        return [a for a in self._actions if not a.option_strings]

    def _split_options(self, page: HelpPage) -> tuple[list[_Section], list[_Section]]:
        """Return the options of the first and of the second page, group by group."""
        left = {
            name: action
            for action in self._actions
            if action.option_strings and action.help != argparse.SUPPRESS and "-h" not in action.option_strings
            for name in [action.option_strings[-1]]
            if name != "--help-advanced"
        }
        shown = _take_groups(page.groups, left)
        hidden: list[_Section] = []
        for group in self._action_groups:
            own = [left[n] for n in left if left[n] in group._group_actions and not _is_shared(n)]
            if own:
                hidden.append(("other options" if group.title == "options" else str(group.title), own))
        for _, actions in hidden:
            for action in actions:
                del left[action.option_strings[-1]]
        return shown, hidden + _take_groups(ADVANCED, left)

    def _add_section(self, formatter: argparse.HelpFormatter, title: str, actions: list[argparse.Action]) -> None:
        formatter.start_section(title)
        formatter.add_arguments(actions)
        formatter.end_section()


_UNITS = {"-mm": "MM", "-deg": "DEG", "-percent": "PERCENT", "-N": "NEWTON", "-ms": "MS", "-kg": "KG"}
_Section = tuple[str, list[argparse.Action]]


class _AdvancedHelpAction(argparse.Action):
    """Print the second page and exit, as ``--help`` does with the first."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        assert isinstance(parser, ArrangedParser)
        print(parser.format_advanced_help(), end="")
        parser.exit()


def arrange_help(name: str, parser: argparse.ArgumentParser) -> None:
    """Give a command its two help pages.

    Args:
        name: Name of the command; one that :data:`PAGES` does not name keeps the page of argparse.
        parser: Parser of the command.
    """
    if name not in PAGES or not isinstance(parser, ArrangedParser):
        return
    parser.page = PAGES[name]
    for action in parser._actions:
        if action.option_strings and action.nargs is None and action.metavar is None and action.choices is None:
            action.metavar = _choose_metavar(action)
    parser.add_argument("--help-advanced", action=_AdvancedHelpAction, nargs=0, help="show the other options and exit")


def _is_shared(name: str) -> bool:
    return any(name in names for _, names in ADVANCED)


def _take_groups(groups: tuple[OptionGroup, ...], left: dict[str, argparse.Action]) -> list[_Section]:
    """Remove the options of the groups from those that are left; a group without any is left out."""
    taken = [(title, [left.pop(name) for name in names if name in left]) for title, names in groups]
    return [(title, actions) for title, actions in taken if actions]


def _format_usage(action: argparse.Action) -> str:
    name = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
    name = f"{name} …" if action.nargs == "+" else name
    return f"{action.option_strings[0]} {name}" if action.option_strings else name


def _choose_metavar(action: argparse.Action) -> str | None:
    """Return the unit of an option without a name for its value, else N for a number."""
    name = action.option_strings[-1]
    unit = next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)
    return unit or ("N" if action.type in (int, float, parse_natural_number, parse_positive_integer) else None)
